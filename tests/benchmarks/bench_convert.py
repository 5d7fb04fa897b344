"""Speed of `convert`, beside an earlier version in the same minutes: CPU seconds and real seconds.

    python tests/benchmarks/bench_convert.py [--recording FILE]... [--events 20] [--rounds 5] [--old FOLDER] [--write]

The recordings are those of `bench_evt3.py`, with more events (millions), and any recordings of a real camera. Each
conversion is done by a process of its own, which converts once without a clock and then with it; the versions take turns.
The memory is the largest of the process. An earlier version that cannot write a format has no numbers there.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bench_evt3
import measured

KINDS = {"hdf5": "plain HDF5", "metavision": "Metavision's HDF5", "parquet": "Parquet"}


def convert_once(source: Path, kind: str) -> dict[str, float]:
    """Convert a file twice; return what the second conversion took."""
    from drivers.camera.formats.event_conversion import convert

    with tempfile.TemporaryDirectory() as folder:
        convert(source, Path(folder) / "first", kind)
        cpu, real = time.process_time(), time.perf_counter()
        summary = convert(source, Path(folder) / "second", kind)
        return {
            "cpu_s": time.process_time() - cpu,
            "real_s": time.perf_counter() - real,
            "events": summary.events,
            "bytes": (Path(folder) / "second").stat().st_size,
            "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        }


def in_version(folder: Path, source: Path, kind: str) -> dict[str, float] | None:
    """Let the packages of a checkout convert a file; None if they cannot."""
    command = [sys.executable, str(Path(__file__).resolve()), "--one", str(source.resolve()), "--kind", kind]
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return json.loads(done.stdout) if done.returncode == 0 else None


def main() -> None:
    """Print a table: a row for each recording, format and version."""
    parser = measured.options(__doc__)
    parser.add_argument("--recording", type=Path, action="append", default=[])
    parser.add_argument("--events", type=float, default=20.0, help="millions of each drawn recording")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--old", type=Path, help="checkout of an earlier version")
    parser.add_argument("--one", type=Path, help="convert this file only (for this program's own use)")
    parser.add_argument("--kind", choices=list(KINDS))
    options = parser.parse_args()
    if options.one:
        print(json.dumps(convert_once(options.one, options.kind)))
        return
    versions = {**({"before": options.old} if options.old else {}), "now": measured.ROOT}
    print(
        "| recording, format | version | Mev per CPU s, 95 % | Mev/s real, 95 % | ratio of CPU times |"
        " bytes an event | memory |\n| --- | --- | ---: | ---: | ---: | ---: | ---: |"
    )
    with tempfile.TemporaryDirectory() as folder:
        paths = {path.name: path for path in options.recording}
        bench_evt3.EVENTS = int(1e6 * options.events)
        for name, scene in bench_evt3.SCENES.items():
            paths[name] = Path(folder) / f"{name}.raw"
            bench_evt3.write_scene(paths[name], *scene)
        for name, path in paths.items():
            for kind, shown in KINDS.items():
                rounds = [
                    {version: in_version(where, path, kind) for version, where in versions.items()}
                    for _ in range(options.rounds)
                ]
                show(f"{name}, {shown}", rounds)


def show(what: str, rounds: list[dict[str, dict[str, float] | None]]) -> None:
    """Print the rows of a recording and a format."""
    slower = None
    for version in rounds[0]:
        done = [one for one in (taken[version] for taken in rounds) if one is not None]
        if not done:
            print(f"| {what} | {version} | cannot | | | | |", flush=True)
            continue
        cpu, real = (measured.spread(one[key] for one in done) for key in ("cpu_s", "real_s"))
        slower = slower or cpu
        events_m = done[0]["events"] / 1e6
        print(
            f"| {what} | {version} | {cpu.rates(events_m)} | {real.rates(events_m)} |"
            f" {cpu.median_s / slower.median_s:.2f} | {done[0]['bytes'] / done[0]['events']:.2f} |"
            f" {max(one['memory_mb'] for one in done):.0f} MB |",
            flush=True,
        )


if __name__ == "__main__":
    measured.run(main, "costs", "Converting a recording")
