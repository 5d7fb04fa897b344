"""Measure the panel: time to a live page, delay of a push, cost of 20 pages, long journals, gaps after a kill.

    python tests/benchmarks/bench_panel.py [--lines N] [--poses N] [--pages N]

The panel is a process of its own, as an operator starts it; a headless Chromium shows its pages. ``push`` is the time
from the end of the write of a journal's line to the moment at which the page's script has drawn it. Both use the clock
of this computer. CPU times tell what the panel would take of a computer that is otherwise free.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

import numpy as np
from journals import MadeRun
from playwright.sync_api import sync_playwright

from bench.panel.run_model import RunModel
from bench.records.storage import lock_folder

CHROMIUM = os.environ.get("STARBENCH_CHROMIUM", "/usr/bin/chromium")
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
TICKS = os.sysconf("SC_CLK_TCK")
PAUSE_S = 0.12
# Notes when each line of the log is drawn.
OBSERVE = """() => {
  window.drawn = {};
  const note = () => { for (const one of document.querySelectorAll('#log li')) window.drawn[one.dataset.line] ??= Date.now(); };
  new MutationObserver(note).observe(document.getElementById('log'), {childList: true});
  note();
}"""


@contextmanager
def panel(folder: Path, port: int = 0) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Start the panel as a process; yield it and its address."""
    words = [
        sys.executable,
        "-m",
        "bench",
        "panel",
        str(folder),
        "--no-browser",
        "--no-token",
        "--port",
        str(port),
    ]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def wait(holds: Any, timeout_s: float = 120.0) -> None:
    """Wait until something is true."""
    end_s = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > end_s:
            sys.exit("It did not happen in time.")
        time.sleep(0.005)


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def percentiles(values: list[float]) -> str:
    """Return median, 95th percentile and largest value, as text."""
    p50, p95 = np.percentile(values, [50, 95])
    return f"p50 {p50:.1f} ms, p95 {p95:.1f} ms, largest {max(values):.1f} ms ({len(values)})"


def push(run: MadeRun, pages: list[Any], count: int) -> list[float]:
    """Write lines and return how long each took to be drawn in each page, ms."""
    for page in pages:
        page.evaluate(OBSERVE)
    model = RunModel(run.folder)
    while model.refresh():
        pass
    begin, written_ms = model.lines, {}
    for number in range(1, count + 1):
        run.write("deviation", what=f"line {number}")
        written_ms[begin + number] = 1000.0 * time.time()
        time.sleep(PAUSE_S)
    last = begin + count
    delays = []
    for page in pages:
        wait(lambda page=page: page.evaluate(f"'{last}' in window.drawn"))
        drawn = page.evaluate("window.drawn")
        delays += [drawn[str(line)] - written for line, written in written_ms.items()]
    return delays


def log_lines(page: Any) -> list[int]:
    """Return the numbers of the lines that a page shows."""
    return [int(n) for n in page.eval_on_selector_all("#log li", "all => all.map(one => one.dataset.line)")]


def open_page(context: Any, address: str, hosts: set[str]) -> tuple[Any, float]:
    """Open a run's page; return it and the time until it is live, s."""
    page = context.new_page()
    page.on("request", lambda request: hosts.add(request.url.split("/")[2]))
    begin_s = time.monotonic()
    page.goto(address)
    wait(lambda: page.query_selector("#log li") is not None)
    return page, time.monotonic() - begin_s


def measure(arguments: argparse.Namespace, root: Path, chromium: Any) -> None:
    """Measure everything and print it."""
    run = MadeRun(root / "run").begin()
    run.record(1)
    lock = lock_folder(run.folder)
    hosts: set[str] = set()
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    begin_s = time.monotonic()
    with panel(root) as (process, url):
        print(f"panel started in {time.monotonic() - begin_s:.2f} s")
        page, first_s = open_page(context, f"{url}run/run", hosts)
        again_s = []
        for _ in range(5):
            other, live_s = open_page(context, f"{url}run/run", hosts)
            again_s.append(live_s)
            other.close()
        print(f"open to live: first {first_s:.2f} s, then {np.median(again_s):.2f} s (median of 5)")
        before_s, begin_s = cpu_s(process.pid), time.monotonic()
        time.sleep(5.0)
        print(
            f"panel with one page, nothing new: {100 * (cpu_s(process.pid) - before_s) / 5.0:.1f} % of one core"
        )
        print(f"push to one page: {percentiles(push(run, [page], arguments.lines))}")
        pages = [page] + [open_page(context, f"{url}run/run", hosts)[0] for _ in range(arguments.pages - 1)]
        before_s, begin_s = cpu_s(process.pid), time.monotonic()
        delays = push(run, pages, arguments.lines)
        share = 100 * (cpu_s(process.pid) - before_s) / (time.monotonic() - begin_s)
        print(f"push to {len(pages)} pages: {percentiles(delays)}; panel {share:.1f} % of one core")
        for one in pages[1:]:
            one.close()
        port = int(url.rsplit(":", 1)[1].strip("/"))
        process.send_signal(signal.SIGKILL)
        process.wait()
        for number in range(20):
            run.write("deviation", what=f"while the panel was dead {number}")
    with panel(root, port):
        begin_s = time.monotonic()
        model = RunModel(run.folder)
        while model.refresh():
            pass
        wait(lambda: log_lines(page) and log_lines(page)[-1] == model.log[-1][0])
        shown = log_lines(page)
        missing = {line for line, *_ in model.log} - set(shown)
        print(
            f"after kill -9 of the panel: {len(missing)} lines missing, {len(shown) - len(set(shown))} twice, live again"
            f" {time.monotonic() - begin_s:.2f} s after its start"
        )
    os.close(lock)
    print(f"hosts asked: {sorted(hosts)}")
    context.close()


def measure_long(poses: int, root: Path, chromium: Any) -> None:
    """Measure a journal of very many poses."""
    run = MadeRun(root / "long", poses).begin().record_all()
    lock = lock_folder(run.folder)
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    with panel(root) as (process, url):
        begin_s = time.monotonic()
        page = context.new_page()
        page.goto(f"{url}run/long")
        wait(lambda: f"{poses} of {poses}" in page.inner_text("#figures").replace("\n", " "))
        megabytes = run.path.stat().st_size / 1e6
        print(
            f"{poses} poses, {megabytes:.0f} MB: complete in the page after {time.monotonic() - begin_s:.1f} s"
        )
        rss = next(
            line for line in Path(f"/proc/{process.pid}/status").read_text().splitlines() if "VmHWM" in line
        )
        print(f"memory of the panel: {int(rss.split()[1]) / 1024:.0f} MiB")
        before_s = cpu_s(process.pid)
        delays = push(run, [page], 50)
        print(
            f"push: {percentiles(delays)}; {1000 * (cpu_s(process.pid) - before_s) / 50:.1f} ms of CPU a line"
        )
    os.close(lock)
    context.close()


def main() -> None:
    """Measure, and print one line for each number."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lines", type=int, default=150, help="lines to push")
    parser.add_argument("--pages", type=int, default=20, help="pages open at once")
    parser.add_argument("--poses", type=int, default=10_000, help="poses of the long journal; 0 for none")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        measure(arguments, Path(folder) / "short", chromium)
        if arguments.poses:
            measure_long(arguments.poses, Path(folder) / "long", chromium)
        chromium.close()


if __name__ == "__main__":
    main()
