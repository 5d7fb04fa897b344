"""CPU time of the lists of many runs: the first time, and again.

    python tests/benchmarks/bench_lists.py RUN [--runs 10000] [--rounds 3] [--write]

RUN is a sealed run of this bench (STARBENCH_HOME has its key). Its files are linked into many folders, and a ledger
enters each of them. The index of the home is removed before each round. A command is a process of its own; the panel looks at its folder within one process.
"""

import os
import resource
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import measured
from running import starbench

from bench.base.clock import BenchClock
from bench.base.home import home_folder
from bench.extras.pages.panel.folder_list import FolderList
from bench.record.ledger_marks import RUN_BEGUN, RUN_ENDED, LedgerMark, highest_run, write_own_mark
from bench.record.run_index import INDEX
from bench.record.storage import sha256_of
from bench.record.unsynced_journal import UnsyncedJournal

LINKED = ("journal.jsonl", "results.json", "SHA256SUMS", "SHA256SUMS.sig")


def make_runs(run: Path, folder: Path, number: int) -> list[Path]:
    """Make many runs of one: folders whose files are links to its own."""
    made = [folder / f"run-{n:05}" for n in range(1, number + 1)]
    for run_folder in made:
        run_folder.mkdir(parents=True)
        for name in LINKED:
            os.link(run / name, run_folder / name)
    return made


def make_home(home: Path, runs: list[Path]) -> None:
    """Make a configuration folder with the keys and the ledger of this bench, which then has the runs, too."""
    shutil.copytree(home_folder(), home, ignore=shutil.ignore_patterns("runs.sqlite3*", "kept-views"))
    seal = sha256_of(runs[0] / "SHA256SUMS")
    with UnsyncedJournal.open(home / "ledger.jsonl", BenchClock()) as ledger:
        before = highest_run(ledger.entries)
        for number, run in enumerate(runs, 1 + before):
            facts = {"run": run.name, "folder": str(run), "camera": "1", "simulated": True}
            ledger.append(RUN_BEGUN, number=number, **facts)
            ledger.append(RUN_ENDED, number=number, how="finished", seal=seal)
        lines, last = len(ledger.entries), ledger.entries[-1]
    write_own_mark(home, LedgerMark(lines, before + len(runs), last.hash, last.utc))


def looks_s(folder: Path) -> list[float]:
    """Return the CPU times of the panel's looks at a folder: until all is listed, then twice again."""
    listed, times, begun = FolderList(folder), [], time.process_time()
    while listed.look()["unread"]:
        pass
    for _ in range(3):
        times.append(time.process_time() - begun)
        begun = time.process_time()
        listed.look()
    return times


def command_s(home: Path, *words: str) -> float:
    """Call a command with a home; return its CPU time."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    starbench(*words, home=home)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def one_round(home: Path, runs: list[Path]) -> Iterator[tuple[str, float]]:
    """Yield what was measured, and its CPU time."""
    folder = str(runs[0].parent)
    for part_of_index in home.glob(f"{INDEX}*"):
        part_of_index.unlink()
    yield "runs FOLDER, first time", command_s(home, "runs", folder)
    yield "runs FOLDER", command_s(home, "runs", folder)
    first, *again = looks_s(Path(folder))
    yield "panel, first time", first
    yield from (("panel, a look", took) for took in again)


def main() -> None:
    """Print a table: a row for each list."""
    parser = measured.options(__doc__)
    parser.add_argument("run", type=Path, metavar="RUN")
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    took: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory(dir=options.run.resolve().parent) as name:
        home, runs = Path(name) / "home", make_runs(options.run, Path(name) / "runs", options.runs)
        make_home(home, runs)
        for _ in range(options.rounds):
            for what, cpu_s in one_round(home, runs):
                took.setdefault(what, []).append(cpu_s)
    print(f"| {options.runs:,} runs | CPU time | 95 % |\n| --- | ---: | ---: |")
    for what, times_s in took.items():
        print(f"| {what} | {measured.spread(times_s).cells(2)} |")


if __name__ == "__main__":
    measured.run(main, "costs", "Lists of runs")
