"""Speed of `convert`, beside an earlier version in the same minutes: CPU seconds and real seconds.

    python tests/benchmarks/bench_convert.py [--recording FILE]... [--repeated FILE] [--events 20] [--rounds 3]
        [--old FOLDER] [--write]

The recordings are those of `bench_evt3.py`, with more events (millions), and any recordings of a real camera; one of
them is repeated to a gigabyte, with the clock going on. The versions
take turns, each in processes of its own, which convert once without a clock and then some times with it. The memory is the
largest of a process. An earlier version that cannot write a format has no numbers there.
"""

from __future__ import annotations

import json
import resource
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import bench_evt3
import measured
import numpy as np

from drivers.camera.raw_file import RawFile

KINDS = {"hdf5": "plain HDF5", "metavision": "Metavision's HDF5", "parquet": "Parquet"}


TURNS = 2
"""Number of processes for each version and recording."""


LARGE_BYTES = 1_000_000_000
_TIME_HIGH = 0x8
"""Type of the words of EVT3 with the upper 12 of 24 bits of the clock."""


class Conversion(NamedTuple):
    """What a conversion took, and what it made."""

    cpu_s: float
    real_s: float
    events: int
    bytes: int
    memory_mb: float


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
    from drivers.camera.formats.event_conversion import convert

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
    """Convert a file to each kind that this version can write."""
    from drivers.camera.formats.event_conversion import KINDS as CAN_BE_WRITTEN

    return {kind: convert_again(source, kind, rounds) for kind in KINDS if kind in CAN_BE_WRITTEN}


def in_version(folder: Path, source: Path, rounds: int) -> dict[str, list[Conversion]]:
    """Let the packages of a checkout convert a file."""
    text = measured.in_checkout(folder, "--one", str(source.resolve()), "--rounds", str(rounds))
    return {
        kind: [Conversion(*fields) for fields in conversions]
        for kind, conversions in json.loads(text).items()
    }


def main() -> None:
    """Print a table: a row for each recording, format and version."""
    parser = measured.options(__doc__)
    parser.add_argument("--recording", type=Path, action="append", default=[])
    parser.add_argument("--repeated", type=Path, help="a RAW file of a real camera, repeated to a gigabyte")
    parser.add_argument(
        "--events", type=float, default=20.0, help="millions of each drawn recording; 0: none"
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--old", type=Path, help="checkout of an earlier version")
    parser.add_argument("--one", type=Path, help="convert this file only (for this program's own use)")
    options = parser.parse_args()
    if options.one:
        print(json.dumps(convert_all(options.one, options.rounds)))
        return
    versions = {**({"before": options.old} if options.old else {}), "now": measured.ROOT}
    print(
        "| recording, format | version | Mev per CPU s, 95 % | Mev/s real, 95 % | ratio of CPU times |"
        " bytes an event | memory |\n| --- | --- | ---: | ---: | ---: | ---: | ---: |"
    )
    with tempfile.TemporaryDirectory() as folder:
        paths = {path.name: path for path in options.recording}
        bench_evt3.EVENTS = int(1e6 * options.events)
        for name, scene in bench_evt3.SCENES.items() if options.events else ():
            paths[name] = Path(folder) / f"{name}.raw"
            bench_evt3.write_scene(paths[name], *scene)
        if options.repeated:
            name = f"{options.repeated.stem}, 1 GB"
            paths[name] = Path(folder) / "repeated.raw"
            write_repeated(paths[name], options.repeated)
        for name, path in paths.items():
            taken: dict[str, dict[str, list[Conversion]]] = {version: {} for version in versions}
            for version, where in [*versions.items()] * TURNS:
                for kind, conversions in in_version(where, path, options.rounds).items():
                    taken[version].setdefault(kind, []).extend(conversions)
            for kind, shown in KINDS.items():
                show(
                    f"{name}, {shown}",
                    {version: of_kinds.get(kind, []) for version, of_kinds in taken.items()},
                )


def show(what: str, taken: dict[str, list[Conversion]]) -> None:
    """Print the rows of a recording and a format."""
    before = None
    for version, conversions in taken.items():
        if not conversions:
            print(f"| {what} | {version} | cannot | | | | |", flush=True)
            continue
        cpu, real = (
            measured.spread(conversion.cpu_s for conversion in conversions),
            measured.spread(conversion.real_s for conversion in conversions),
        )
        ratio = f"{cpu.median_s / before.median_s:.2f}" if before else ""
        before = before or cpu
        print(
            f"| {what} | {version} | {cpu.rates(conversions[0].events / 1e6)} | {real.rates(conversions[0].events / 1e6)} |"
            f" {ratio} | {conversions[0].bytes / conversions[0].events:.2f} | {max(conversion.memory_mb for conversion in conversions):.0f} MB |",
            flush=True,
        )


if __name__ == "__main__":
    measured.run(main, "costs", "Converting a recording")
