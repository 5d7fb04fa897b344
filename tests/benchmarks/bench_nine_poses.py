"""A whole run of nine poses beside an earlier version: in real time, and on the virtual clock of a rehearsal.

    python tests/benchmarks/bench_nine_poses.py --old FOLDER [--rounds 3] [--write]

FOLDER is a checkout of the earlier version. The versions take turns; a first run of each, which compiles its loops,
is not counted. Times are those of the journals: of a run on the simulated bench, whose stage turns in real time, and
of a rehearsal, whose clock no other work on the computer changes.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import measured

SEED = "3"
QUEUE = """\
format: starbench/queue/1
name: Nine poses
jobs:
  - {name: nine, sequence: nine_pose, station: simulated, seed: 3}
"""
Times = dict[str, float]


def main() -> None:
    """Print a table: a row for each part of the run."""
    parser = measured.options(__doc__)
    parser.add_argument("--old", type=Path, required=True, help="checkout of an earlier version")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    versions = {"now": measured.ROOT, "before": options.old.resolve()}
    taken: dict[str, dict[str, list[float]]] = {}
    with tempfile.TemporaryDirectory() as name:
        for number in range(options.rounds + 1):
            for version, source in versions.items():
                folder = Path(name) / f"{version}-{number}"
                folder.mkdir()
                times = real_run(source, folder) | rehearsal(source, folder)
                for what, took_s in times.items() if number else ():
                    taken.setdefault(what, {}).setdefault(version, []).append(took_s)
    print(f"| {options.rounds} rounds | now | 95 % | before | 95 % | ratio |\n| --- |" + " ---: |" * 5)
    for what, by_version in taken.items():
        now, before = (measured.spread(by_version[version]) for version in versions)
        print(f"| {what} | {now.cells(1)} | {before.cells(1)} | {now.median_s / before.median_s:.2f} |")


def real_run(source: Path, folder: Path) -> Times:
    """Return what a run in real time took, and the CPU time of its command."""
    cpu_s = measured.command_s(
        source,
        folder / "home",
        "run",
        "nine_pose",
        "--seed",
        SEED,
        "-s",
        "simulated",
        "-o",
        "run",
        cwd=folder,
    )
    cycle_s, whole_s = journal_s(folder / "run" / "journal.jsonl")
    return {
        "real time, first to last recording": cycle_s,
        "real time, whole run with its report": whole_s,
        "CPU time of the command, with its start": cpu_s,
    }


def rehearsal(source: Path, folder: Path) -> Times:
    """Return what a run takes on the virtual clock."""
    (folder / "queue.yaml").write_text(QUEUE, encoding="utf-8")
    measured.command_s(source, folder / "home", "rehearse", "queue.yaml", "-o", "rehearsed", cwd=folder)
    run = next(
        path for path in (folder / "rehearsed").rglob("journal.jsonl") if path.parent.name != "rehearsed"
    )
    cycle_s, whole_s = journal_s(run)
    return {"virtual clock, first to last recording": cycle_s, "virtual clock, whole run": whole_s}


def journal_s(path: Path) -> tuple[float, float]:
    """Return the time from the first to the last recording of a run, and from its first to its last line."""
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    recorded = [line["mono_s"] for line in lines if line["event"] == "capture_stored"]
    return recorded[-1] - recorded[0], lines[-1]["mono_s"] - lines[0]["mono_s"]


if __name__ == "__main__":
    measured.run(main, "costs", "Nine poses while the next is turned to")
