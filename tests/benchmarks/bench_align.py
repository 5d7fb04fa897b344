"""Measure the align page on the simulated bench: time to the live image, pictures and stars a second, delays, hosts.

    python tests/benchmarks/bench_align.py [--seconds N] [--stops N] [--station NAME]

Server, simulated bench and a headless Chromium share this computer. ``stop`` is the time from the press of the STOP
button in the page to the stop command on the simulated controller's serial line, while the stage turns and pictures
come. The CPU time of each process tells what two free cores would reach on a busy computer.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from playwright.sync_api import sync_playwright

from bench.align.page_requests import PageFiles
from bench.align.serve import align_app
from bench.align.session import Session
from bench.stations.devices import Devices
from bench.stations.station import load_station
from bench.web.server import PageServer

CHROMIUM = os.environ.get("STARBENCH_CHROMIUM", "/usr/bin/chromium")
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
TICKS = os.sysconf("SC_CLK_TCK")


class Wire:
    """Notes when a stop was sent to a port."""

    def __init__(self) -> None:
        self.stops_s: list[float] = []

    def record(self, _t_s: float, _port: str, direction: str, data: bytes) -> None:
        """Note one piece of data."""
        if direction == ">" and b"stop" in data:
            self.stops_s.append(time.time())


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def wait(page: Any, script: str, timeout_s: float = 60.0) -> None:
    """Wait until a script of the page is true."""
    end_s = time.monotonic() + timeout_s
    while not page.evaluate(script):
        if time.monotonic() > end_s:
            sys.exit(f"It did not happen in time: {script}")
        time.sleep(0.01)


def percentiles(values: list[float]) -> str:
    """Return median, 95th percentile and largest value, as text."""
    p50, p95 = np.percentile(values, [50, 95])
    return f"p50 {p50:.1f} ms, p95 {p95:.1f} ms, largest {max(values):.1f} ms ({len(values)})"


def measure_stops(page: Any, session: Session, wire: Wire, count: int) -> list[float]:
    """Press STOP in the page while the stage turns; return the delays to the wire, ms."""
    page.select_option("#step", "5")
    page.evaluate("addEventListener('pointerdown', () => { window.pressed = Date.now(); }, true)")
    delays = []
    for number in range(count):
        wait(page, "!document.querySelector('[data-axis=pan] .plus').disabled")
        page.click("[data-axis=pan] " + (".plus" if number % 2 == 0 else ".minus"))
        end_s = time.monotonic() + 5
        while not session.bench.stage.moving and time.monotonic() < end_s:
            time.sleep(0.002)
        before = len(wire.stops_s)
        page.click("#stop")
        while len(wire.stops_s) == before and time.monotonic() < end_s:
            time.sleep(0.002)
        if len(wire.stops_s) > before:
            delays.append(1e3 * wire.stops_s[before] - page.evaluate("window.pressed"))
        while session.bench.stage.moving:
            time.sleep(0.01)
    return delays


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="how long to count pictures")
    parser.add_argument("--stops", type=int, default=40, help="how often to stop")
    parser.add_argument("--station", default="simulated")
    given = parser.parse_args()
    wire = Wire()

    def opener(station: Any, seed: int, clock: Any) -> Devices:
        return Devices(station, seed=seed, clock=clock, wire_log=wire)

    located = load_station(given.station)
    session = Session(located, opener=opener)
    began_s = time.monotonic()
    failure = session.open()
    if failure is not None:
        sys.exit(failure.message)
    print(f"devices open after {time.monotonic() - began_s:.2f} s; load {os.getloadavg()[0]:.1f}")
    session.wait_for_devices()
    session.home()
    while session.bench.stage.moving:
        time.sleep(0.05)
    session.light(on=True)
    while session.picture().number < 5:
        time.sleep(0.05)
    server = PageServer(align_app(session, PageFiles(located.file)))
    ready = threading.Event()
    thread = threading.Thread(target=server.serve, args=(ready.set,), daemon=True)
    thread.start()
    ready.wait()
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            hosts: set[str] = set()
            page.on("request", lambda r: hosts.add(r.url.removeprefix("blob:").split("/")[2]))
            page.goto(server.url)
            wait(page, "window.alignStats && alignStats.images > 0")
            print(f"page open to live image: {page.evaluate('alignStats.firstImageMs'):.0f} ms")
            count(session, page, given.seconds)
            print(f"push of a picture: {percentiles(page.evaluate('alignStats.latenciesMs')[1:])}")
            print(f"stop, page to wire: {percentiles(measure_stops(page, session, wire, given.stops))}")
            print(f"hosts asked: {sorted(hosts)}; the page's own: {server.url.split('/')[2]}")
            browser.close()
    finally:
        server.stop()
        thread.join()
        for one in session.close():
            print(f"{one.device}: {one.text}")


def descendants(pid: int) -> dict[int, str]:
    """Return the processes that a process has started, and what they are."""
    found: dict[int, str] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_text().split("\0")
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):  # it has ended meanwhile
            continue
        if parent == pid:
            text = " ".join(words)
            what = next((n for n in ("simulators.bench", "align.meter", "chromium") if n in text), "other")
            found |= {int(folder.name): what} | {
                child: what if what == "chromium" else name
                for child, name in descendants(int(folder.name)).items()
            }
    return found


def count(session: Session, page: Any, seconds: float) -> None:
    """Count pictures, and the CPU time that they cost."""
    pids = {os.getpid(): "this process"} | descendants(os.getpid())
    before = {pid: cpu_s(pid) for pid in pids}
    first, shown, began_s = session.picture().number, page.evaluate("alignStats.images"), time.monotonic()
    time.sleep(seconds)
    lasted_s = time.monotonic() - began_s
    made = session.picture().number - first
    seen = page.evaluate("alignStats.images") - shown
    print(f"pictures: {made / lasted_s:.2f} a second made, {seen / lasted_s:.2f} a second on the page")
    print(f"stars searched: {session.bench.loop.stars_per_s():.2f} a second; load {os.getloadavg()[0]:.1f}")
    used: dict[str, float] = {}
    for pid, name in pids.items():
        if Path(f"/proc/{pid}").exists():
            used[name] = used.get(name, 0.0) + cpu_s(pid) - before[pid]
    for name, spent_s in used.items():
        print(
            f"CPU of {name}: {1e3 * spent_s / max(1, made):.0f} ms a picture, {100 * spent_s / lasted_s:.0f} % of a core"
        )
    picture = session.picture()
    print(f"last slice: recorded in {picture.record_ms:.0f} ms, measured in {picture.measure_ms:.0f} ms")


if __name__ == "__main__":
    main()
