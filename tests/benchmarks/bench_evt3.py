"""Speed of reading EVT3, beside the PyPI decoder ``evt3`` in the same run: CPU seconds on one core.

Three recordings of 4 million events each, as an IMX636 sends them: sparse (single events, TIME_HIGH dominates),
flicker (about 1.8 bytes an event, as in the published comparisons) and dense (vectors nearly full). The first
call of each function is not counted (it compiles). Numbers are the median of some rounds; on a busy machine
compare ratios, not absolute speeds.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.camera.evt3 import Evt3Decoder, count_events
from drivers.camera.raw_file import RawFile
from simulators.pixels.evt3_writer import Evt3Writer

EVENTS = 4_000_000
ROUNDS = 5
HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% end\n"
SCENES = {"sparse": (0.0008, 1.0), "flicker": (0.12, 16.0), "dense": (0.6, 60.0)}
"""Share of a row's pixels that fire in one read, and events a microsecond."""


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


def cpu_s(work: Callable[[], object]) -> float:
    """Median CPU time of the work."""
    work()
    times = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return statistics.median(times)


def works(path: Path) -> dict[str, Callable[[], object]]:
    """What is measured."""
    recording = RawFile.open(path)
    words = np.fromfile(path, "<u2", offset=recording.raw_header.size_bytes)
    image = np.zeros((2, 720, 1280), np.uint16)
    events, _ = recording.read()

    def decode() -> None:
        for _ in Evt3Decoder(1280, 720).decode(words):
            pass

    found: dict[str, Callable[[], object]] = {
        "words in memory -> events, in chunks": decode,
        "words in memory -> ON/OFF counts": lambda: Evt3Decoder(1280, 720).count(words, image),
        "events in memory -> ON/OFF counts": lambda: count_events(events, image),
        "words in memory -> tally only": lambda: Evt3Decoder(1280, 720).tally(words),
        "file -> events, in chunks": lambda: [len(c.t) for c in recording.chunks()],
        "file -> all events": recording.read,
    }
    try:
        import evt3
    except ImportError:
        print("evt3 is not installed: no peer to compare with")
        return found
    found["evt3: file -> all events"] = lambda: evt3.decode_file_with_triggers(str(path))
    found["evt3: file -> events, in batches"] = lambda: [len(b) for b in evt3.decode_file_batches(str(path))]
    return found


def main() -> None:
    """Print a table a scene."""
    with tempfile.TemporaryDirectory() as folder:
        for name, (density, rate) in SCENES.items():
            path = Path(folder) / f"{name}.raw"
            write_scene(path, density, rate)
            scan = RawFile.open(path).scan()
            print(
                f"\n{name}: {scan.events / 1e6:.1f} M events in {scan.duration_s:.2f} s, "
                f"{scan.bytes / scan.events:.2f} bytes an event"
            )
            for work, call in works(path).items():
                print(f"  {work:40s} {scan.events / cpu_s(call) / 1e6:7.0f} Mev per CPU s")


if __name__ == "__main__":
    main()
