"""Speed of reading EVT3, beside the PyPI decoder ``evt3`` in the same run: CPU seconds on one core.

Three recordings of 4 million events each, as an IMX636 sends them: sparse (single events, TIME_HIGH dominates),
flicker (about 1.8 bytes an event, as in the published comparisons) and dense (vectors nearly full); and any recording
of a real camera. Works are interleaved round by round, the first round is not counted (it compiles), and each number is
the median round and the 95th percentile: on a busy machine compare ratios, not absolute speeds.

    python tests/benchmarks/bench_evt3.py [--recording FILE]... [--old FOLDER]

``--old`` names a checkout of an earlier version, which is measured in the same minutes by a process of its own.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import measured
import numpy as np

from drivers.camera.evt3 import Evt3Decoder
from drivers.camera.raw_file import RawFile
from simulators.pixels.evt3_writer import Evt3Writer

EVENTS = 4_000_000
ROUNDS = 5
HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% end\n"
SCENES = {"sparse": (0.0008, 1.0), "flicker": (0.12, 16.0), "dense": (0.6, 60.0)}
"""Share of a row's pixels that fire in one read, and events a microsecond."""
PEERS = {
    "file -> events, in chunks": "evt3: file -> events, in batches",
    "file -> all events": "evt3: file -> all events",
}


def write_scene(path: Path, density: float, rate_mev_s: float) -> None:
    """Write a recording of rows read one after the other, each with randomly placed events."""
    rng = np.random.default_rng(7)
    rows_at_once = 2000
    writer = Evt3Writer()
    begin, written = 0.0, 0
    with path.open("wb") as file:
        file.write(HEADER)
        while written < EVENTS:
            fired = rng.random((rows_at_once, 1280)) < density
            read, x = np.nonzero(fired)
            gap_us = max(1280 * density, 1.0) / rate_mev_s
            t = np.floor(begin + read * gap_us).astype(np.int64)
            begin += rows_at_once * gap_us
            y, p = (read * 7 % 720).astype(np.uint16), (read // 360 % 2).astype(np.uint8)
            words = writer.write(t, x.astype(np.uint16), y, p, until_us=int(np.floor(begin)))
            file.write(words.tobytes())
            written += len(t)


def times_of(works: dict[str, Callable[[], object]]) -> dict[str, measured.Spread]:
    """CPU time of each work in some rounds of all."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for k in range(ROUNDS + 1):
        for name, work in works.items():
            begin = time.process_time()
            work()
            if k:
                times[name].append(time.process_time() - begin)
    return {name: measured.spread(cpu_s) for name, cpu_s in times.items()}


def works(path: Path) -> dict[str, Callable[[], object]]:
    """What is measured."""
    recording = RawFile.open(path)
    words = np.fromfile(path, "<u2", offset=recording.raw_header.size_bytes)
    image = np.zeros((2, 720, 1280), np.uint16)

    def decode() -> None:
        for _ in Evt3Decoder(1280, 720).decode([words]):
            pass

    calls: dict[str, Callable[[], object]] = {
        "words in memory -> events, in chunks": decode,
        "words in memory -> ON/OFF counts": lambda: Evt3Decoder(1280, 720).count(words, image),
        "words in memory -> tally only": lambda: Evt3Decoder(1280, 720).tally(words),
        "file -> events, in chunks": lambda: [len(c.t) for c in recording.chunks()],
        "file -> all events": recording.read,
    }
    try:
        import evt3
    except ImportError:
        print("evt3 is not installed: no peer to compare with")
        return calls
    calls["evt3: file -> all events"] = lambda: evt3.decode_file_with_triggers(str(path))
    calls["evt3: file -> events, in batches"] = lambda: [len(b) for b in evt3.decode_file_batches(str(path))]
    return calls


def main() -> None:
    """Print a table a scene."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--old", type=Path, help="checkout of an earlier version")
    parser.add_argument(
        "--recording", type=Path, action="append", default=[], help="a RAW file of a real camera"
    )
    options = parser.parse_args()
    if options.old:
        words = [word for path in options.recording for word in ("--recording", str(path.resolve()))]
        for name, folder in (("OLD", options.old), ("NEW", measured.ROOT)):
            print(f"\n===== {name}\n{measured.in_checkout(folder, *words)}", flush=True)
        return
    with tempfile.TemporaryDirectory() as folder:
        paths = {path.name: path for path in options.recording}
        for name, scene in SCENES.items():
            paths[name] = Path(folder) / f"{name}.raw"
            write_scene(paths[name], *scene)
        for name, path in paths.items():
            show(name, path)


def show(name: str, path: Path) -> None:
    """Print the table of a recording."""
    scan = RawFile.open(path).scan()
    print(
        f"\n{name}: {scan.events / 1e6:.2f} M events in {scan.duration_s:.2f} s, "
        f"{scan.bytes / scan.events:.2f} bytes an event"
    )
    times = times_of(works(path))
    for work, took in times.items():
        print(f"  {work:40s} Mev per CPU s, median and 95 %: {took.rates(scan.events / 1e6)}")
    for ours, theirs in PEERS.items():
        if theirs in times:
            print(
                f"  {ours}: {times[theirs].median_s / times[ours].median_s:.2f} times {theirs.partition(':')[0]}"
            )


if __name__ == "__main__":
    main()
