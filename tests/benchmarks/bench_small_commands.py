"""CPU time of commands that only read, in turns with an older commit of this repository.

Usage::

    python tests/benchmarks/bench_small_commands.py                     # this checkout alone
    python tests/benchmarks/bench_small_commands.py --against 29bc854   # in turns with that commit, as ratios

Each version first makes a run of its own on the simulated bench. The older commit is checked out into a temporary
worktree and runs with this environment's packages. The commands take turns, so that a machine that becomes slower
becomes slower for both. CPU time is user and system time of the process, by the operating system's account. It is also
stated over that of a process that only imports click, pydantic, PyYAML and rich, which depends less on the machine.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import measured

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = (
    ("status", ["status", "{run}"]),
    ("runs", ["runs"]),
    ("verify", ["verify", "{run}"]),
    ("plan", ["plan", "three_pose", "--station", "simulated"]),
    ("--help", ["--help"]),
    ("an unknown word", ["nonsense"]),
)


class Version:
    """One version of the program, with a run folder and a home of its own.

    folder: Where its run and its home lie.
    """

    def __init__(self, source: Path, folder: Path) -> None:
        self.run_folder = folder / "run"
        home = {"STARBENCH_HOME": str(folder / "home"), "STARBENCH_LOCKS": str(folder / "locks")}
        self._environment = {**os.environ, **home, "PYTHONPATH": str(source)}
        self._environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed program has its bytecode
        self._source = source
        self.cpu_s(
            "run", "three_pose", "--station", "simulated", "--seed", "1", "--output", str(self.run_folder)
        )

    def cpu_s(self, *words: str) -> float:
        """Run a command; return its CPU time, s."""
        return self._spent_s("-m", "bench", *words)

    def bare_imports_s(self) -> float:
        """Return the CPU time of a process that imports the libraries that small commands need, s."""
        return self._spent_s("-c", "import click, pydantic, rich, yaml")

    def _spent_s(self, *words: str) -> float:
        process = subprocess.Popen(
            [sys.executable, *words],
            env=self._environment,
            cwd=self._source,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        return usage.ru_utime + usage.ru_stime


def measure(versions: list[Version], words: list[str], rounds: int) -> list[measured.Spread]:
    """Run a command in turns; return each version's CPU times."""
    times: list[list[float]] = [[] for _ in versions]
    for number in range(rounds + 1):
        for version, found in zip(versions, times, strict=True):
            spent = version.cpu_s(*(word.format(run=version.run_folder) for word in words))
            if number:  # the first round compiles bytecode
                found.append(spent)
    return [measured.spread(found) for found in times]


def main() -> None:
    """Measure and print a table."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--against", metavar="COMMIT", help="an older commit to compare with")
    options.add_argument("--rounds", type=int, default=7, help="counted runs of each command")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory(prefix="starbench-bench-") as name:
        folder = Path(name)
        (folder / "now").mkdir()
        versions = [Version(ROOT, folder / "now")]
        worktree = folder / "source"
        if chosen.against:
            subprocess.run(
                ["git", "worktree", "add", "--detach", worktree, chosen.against], cwd=ROOT, check=True
            )
            (folder / "then").mkdir()
            versions.append(Version(worktree, folder / "then"))
        try:
            bare = measured.spread(versions[0].bare_imports_s() for _ in range(chosen.rounds)).median_s
            print(f"{'command':<18}{'CPU s':>8}{'95 %':>8}{'/ bare':>8}{'then':>8}{'95 %':>8}{'ratio':>8}")
            for label, words in COMMANDS:
                now, *then = measure(versions, words, chosen.rounds)
                beside = "".join(
                    f"{old.median_s:>8.3f}{old.p95_s:>8.3f}{now.median_s / old.median_s:>8.2f}"
                    for old in then
                )
                print(
                    f"{label:<18}{now.median_s:>8.3f}{now.p95_s:>8.3f}{now.median_s / bare:>8.1f}{beside}",
                    flush=True,
                )
        finally:
            if chosen.against:
                subprocess.run(["git", "worktree", "remove", "--force", worktree], cwd=ROOT, check=False)


if __name__ == "__main__":
    main()
