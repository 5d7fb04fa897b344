"""Many runs at the same time on one computer: each finishes with the right result, or says that it is too busy.

    python tests/benchmarks/bench_storm.py FOLDER

FOLDER is new. Prints for each run how it ended, how late the computer was, and fx, which is that of a quiet run of that
seed. A message with a wrong remedy makes the exit status 1.
"""

import argparse
import os
import time
from pathlib import Path

import measured
from running import journal, results, start

WRONG_REMEDIES = ("baud rate", "estart the simulated bench", "simulation section", "defect of the program")
RUN = ("run", "three_pose", "--station", "simulated", "--seed", 1, "--output")


def main() -> int:
    """Run the storm and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    given.folder.mkdir(parents=True)
    began_s = time.monotonic()
    folders = [given.folder / f"run-{number:02d}" for number in range(20)]
    # Each in a home of its own, so that they share no ledger.
    runs = [start(*RUN, folder, home=given.folder / f"home-of-{folder.name}") for folder in folders]
    loads, wrong = [], 0
    while any(run.poll() is None for run in runs):
        loads.append(os.getloadavg()[0])
        time.sleep(2.0)
    for folder, run in zip(folders, runs, strict=True):
        log = "".join(run.communicate())
        (end,) = journal(folder)[-1:] or [{}]
        lateness = end.get("lateness", {})
        bad = run.returncode != 0 and any(remedy in log for remedy in WRONG_REMEDIES)
        wrong += bad
        why = "" if run.returncode == 0 else " ".join(log.strip().splitlines()[-3:])[:300]
        solved = (folder / "results.json").exists()
        fx = f"{results(folder)['calibration']['camera']['fx']:.6f}" if solved else "-"
        print(
            f"{folder.name} status {run.returncode} {end.get('how', '?'):9} fx {fx}"
            f"  lost {lateness.get('lost_s', 0.0):6.1f} s, longest {lateness.get('longest_s', 0.0):5.2f} s"
            f"{'  WRONG REMEDY' if bad else ''} {why}"
        )
    loaded = f"load {min(loads):.1f} to {max(loads):.1f}"
    print(f"{time.monotonic() - began_s:.0f} s; {loaded}; wrong remedies: {wrong}")
    return int(wrong > 0)


if __name__ == "__main__":
    measured.run(main, "faults", "Twenty runs at once")
