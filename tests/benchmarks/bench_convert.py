"""Speed of `convert`: CPU seconds and real seconds.

    python tests/benchmarks/bench_convert.py [--repeated FILE] [--events 20] [--rounds 3] [--write]

Three recordings as an IMX636 sends them, of so many million events each: sparse (single events, TIME_HIGH dominates), flicker (about 1.8
bytes an event) and dense (vectors nearly full); and a recording of a real camera, repeated to a gigabyte with the clock
going on. A process of its own converts each once without a clock and then some times with it. The memory is the
largest of the process.
"""

from __future__ import annotations

import json
import resource
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import measured
import numpy as np

from drivers.camera.formats.event_conversion import convert
from drivers.camera.raw_file import RawFile
from simulators.pixels.evt3_writer import Evt3Writer

KINDS = {"hdf5": "plain HDF5", "metavision": "Metavision's HDF5", "parquet": "Parquet"}


LARGE_BYTES = 1_000_000_000
_TIME_HIGH = 0x8
"""Type of the words of EVT3 with the upper 12 of 24 bits of the clock."""

HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% end\n"
SCENES = {"sparse": (0.0008, 1.0), "flicker": (0.12, 16.0), "dense": (0.6, 60.0)}
"""Share of a row's pixels that fire in one read, and events a microsecond."""


class Conversion(NamedTuple):
    """What a conversion took, and what it made."""

    cpu_s: float
    real_s: float
    events: int
    bytes: int
    memory_mb: float


def write_scene(path: Path, events: int, density: float, rate_mev_s: float) -> None:
    """Write a recording of rows read one after the other, each with randomly placed events."""
    rng = np.random.default_rng(7)
    rows_at_once = 2000
    writer = Evt3Writer()
    begin, written = 0.0, 0
    with path.open("wb") as file:
        file.write(HEADER)
        while written < events:
            fired = rng.random((rows_at_once, 1280)) < density
            read, x = np.nonzero(fired)
            gap_us = max(1280 * density, 1.0) / rate_mev_s
            t = np.floor(begin + read * gap_us).astype(np.int64)
            begin += rows_at_once * gap_us
            y, p = (read * 7 % 720).astype(np.uint16), (read // 360 % 2).astype(np.uint8)
            words = writer.write(t, x.astype(np.uint16), y, p, until_us=int(np.floor(begin)))
            file.write(words.tobytes())
            written += len(t)


def write_repeated(path: Path, source: Path) -> None:
    """Write a recording of EVT3 again and again, up to a gigabyte; the clock goes on by whole steps of its upper part."""
    header_bytes = RawFile.open(source).raw_header.size_bytes
    words = np.fromfile(source, "<u2", offset=header_bytes)
    places = np.flatnonzero(words >> 12 == _TIME_HIGH)
    upper = words[places].astype(np.int64) % 4096
    steps = (int(upper[-1]) - int(upper[0])) % 4096 + 1
    with path.open("wb") as file:
        file.write(source.read_bytes()[:header_bytes])
        for number in range(-(-LARGE_BYTES // words.nbytes)):
            words[places] = _TIME_HIGH << 12 | (upper + number * steps) % 4096
            file.write(words.tobytes())


def convert_again(source: Path, kind: str, rounds: int) -> list[Conversion]:
    """Convert a file once without a clock, which warms up, and then so many rounds with one."""
    conversions = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds + 1):
            target = Path(folder) / f"{number}"
            cpu_s, real_s = time.process_time(), time.perf_counter()
            summary = convert(source, target, kind)
            took = time.process_time() - cpu_s, time.perf_counter() - real_s
            memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            if number:
                conversions.append(Conversion(*took, summary.events, target.stat().st_size, memory_mb))
            target.unlink()
    return conversions


def convert_all(source: Path, rounds: int) -> dict[str, list[Conversion]]:
    """Convert a file to each kind in a process of its own."""
    text = measured.in_checkout(measured.ROOT, "--one", str(source.resolve()), "--rounds", str(rounds))
    return {
        kind: [Conversion(*fields) for fields in conversions]
        for kind, conversions in json.loads(text).items()
    }


def main() -> None:
    """Print a table: a row for each recording and format."""
    parser = measured.options(__doc__)
    parser.add_argument("--repeated", type=Path, help="a RAW file of a real camera, repeated to a gigabyte")
    parser.add_argument("--events", type=float, default=20.0, help="millions of each drawn recording")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--one", type=Path, help="convert this file only (for this program's own use)")
    options = parser.parse_args()
    if options.one:
        print(json.dumps({kind: convert_again(options.one, kind, options.rounds) for kind in KINDS}))
        return
    print(
        "| recording, format | Mev per CPU s, 95 % | Mev/s real, 95 % |"
        " bytes an event | memory |\n| --- | ---: | ---: | ---: | ---: |"
    )
    with tempfile.TemporaryDirectory() as folder:
        paths = {}
        for name, scene in SCENES.items():
            paths[name] = Path(folder) / f"{name}.raw"
            write_scene(paths[name], int(1e6 * options.events), *scene)
        if options.repeated:
            name = f"{options.repeated.stem}, 1 GB"
            paths[name] = Path(folder) / "repeated.raw"
            write_repeated(paths[name], options.repeated)
        for name, path in paths.items():
            for kind, conversions in convert_all(path, options.rounds).items():
                show(f"{name}, {KINDS[kind]}", conversions)


def show(what: str, conversions: list[Conversion]) -> None:
    """Print the row of a recording and a format."""
    million = conversions[0].events / 1e6
    cpu = measured.spread(conversion.cpu_s for conversion in conversions).rates(million)
    real = measured.spread(conversion.real_s for conversion in conversions).rates(million)
    bytes_each = conversions[0].bytes / conversions[0].events
    memory_mb = max(conversion.memory_mb for conversion in conversions)
    print(f"| {what} | {cpu} | {real} | {bytes_each:.2f} | {memory_mb:.0f} MB |", flush=True)


if __name__ == "__main__":
    measured.run(main, "costs", "Converting a recording")
