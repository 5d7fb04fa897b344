"""Many runs at the same time on one computer: each finishes with the right result, or says that it is too busy.

    python tests/benchmarks/bench_storm.py FOLDER [--runs 20]

FOLDER is new. Prints for each run how it ended, how late the computer was, and fx against a quiet run of that seed, and
then the delays of all runs in one histogram. A message with a wrong remedy makes the exit status 1.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import measured

COMMAND = "import sys; from bench.commands.cli import main; sys.exit(main())"
WRONG_REMEDIES = ("baud rate", "estart the simulated bench", "simulation section", "defect of the program")


def start(folder: Path, number: int) -> subprocess.Popen[bytes]:
    """Start one run in a home of its own, so that runs share no ledger."""
    output = folder / f"run-{number:02d}"
    words = [sys.executable, "-c", COMMAND, "run", "three_pose", "--station", "simulated", "--seed", "1"]
    with (folder / f"run-{number:02d}.log").open("wb") as log:
        return subprocess.Popen(
            [*words, "--output", str(output)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env={**os.environ, "STARBENCH_HOME": str(folder / f"home-{number:02d}")},
        )


def ending(folder: Path) -> dict:
    """Return the last line of a run's journal; empty if it has none."""
    try:
        lines = (folder / "journal.jsonl").read_text().splitlines()
    except OSError:
        return {}
    entry = json.loads(lines[-1]) if lines else {}
    return entry.get("data", entry)


def focal_px(folder: Path) -> str:
    """Return fx as the results hold it; a dash where there are none."""
    try:
        values = json.loads((folder / "results.json").read_text())
    except OSError:
        return "-"
    return f"{values['calibration']['camera']['fx']:.6f}"


def main() -> int:
    """Run the storm and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=20)
    given = parser.parse_args()
    given.folder.mkdir(parents=True)
    began_s = time.monotonic()
    runs = [start(given.folder, number) for number in range(given.runs)]
    loads, wrong = [], 0
    while any(run.poll() is None for run in runs):
        loads.append(os.getloadavg()[0])
        time.sleep(2.0)
    for number, run in enumerate(runs):
        folder = given.folder / f"run-{number:02d}"
        log = folder.with_suffix(".log").read_text(errors="replace")
        end = ending(folder)
        lateness = end.get("lateness", {})
        bad = run.returncode != 0 and any(remedy in log for remedy in WRONG_REMEDIES)
        wrong += bad
        why = "" if run.returncode == 0 else " ".join(log.strip().splitlines()[-3:])[:300]
        print(
            f"{number:2} status {run.returncode} {end.get('how', '?'):9} fx {focal_px(folder)}"
            f"  lost {lateness.get('lost_s', 0.0):6.1f} s, longest {lateness.get('longest_s', 0.0):5.2f} s"
            f"{'  WRONG REMEDY' if bad else ''} {why}"
        )
    loaded = f"load {min(loads):.1f} to {max(loads):.1f}"
    print(f"{time.monotonic() - began_s:.0f} s; {loaded}; wrong remedies: {wrong}")
    return int(wrong > 0)


if __name__ == "__main__":
    measured.run(main, "faults", "Twenty runs at once")
