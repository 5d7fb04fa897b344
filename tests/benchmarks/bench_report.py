"""Measure the processor time of a run's own solve and of its results and report, in fresh processes.

    python tests/benchmarks/bench_report.py RUN [--old FOLDER] [--rounds 5]

RUN is a finished run. Its stars are found first, as the run found them before it solved; that is not counted. What is
measured is what the run does in its states `solving` and `reporting`, with all imports that these need: calibration,
checks, results.json, views.h5, exports, report.html. FOLDER is another copy of the sources, measured in turn.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ONE = "--one"


class Written:
    """A run folder whose files are written elsewhere; the part of `RunFolder` that `ResultWriter` uses."""

    def __init__(self, run: Path, folder: Path) -> None:
        self.path, self._folder = run, folder

    def write_atomic(self, name: str, data: bytes) -> Path:
        """Write a file."""
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return path


def measure(code: Path, run: Path) -> dict[str, float]:
    """Solve and report a run once with a copy of the sources; return processor times in seconds."""
    sys.path.insert(0, str(code))
    import bench.run.runner
    from bench.plan.job import Job
    from bench.records.history import replay
    from bench.records.journal import read_journal
    from bench.results.result import ResultWriter
    from bench.results.solution import measure_again
    from sequences.script import SolveStep

    assert Path(str(bench.run.runner.__file__)).is_relative_to(code)
    history, job = replay(read_journal(run / "journal.jsonl")[0]), Job.from_run_folder(run)
    (step,) = [step for step in job.steps if isinstance(step, SolveStep)]
    measured = {index: measure_again(job, run, one) for index, one in sorted(history.accepted().items())}
    truth = job.read_truth() if job.simulated else None

    class Log:
        class journal:  # noqa: N801 - as RunLog names it
            head = "0" * 64

        @staticmethod
        def held():
            return contextlib.nullcontext(history)

    with tempfile.TemporaryDirectory() as folder:
        writer = ResultWriter(job, Written(run, Path(folder)))  # type: ignore[arg-type]
        began = time.process_time()
        writer.solve(step, history, measured, lambda: None)
        solved = time.process_time()
        writer.write(Log(), truth)  # type: ignore[arg-type]
        ended = time.process_time()
    return {"solve": solved - began, "results and report": ended - solved, "both": ended - began}


def main() -> None:
    """Measure each copy of the sources in turn, and print the medians."""
    if sys.argv[1] == ONE:
        print(json.dumps(measure(Path(sys.argv[2]), Path(sys.argv[3]))))
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path)
    parser.add_argument("--old", type=Path, help="another copy of the sources")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    copies = {"here": Path(__file__).resolve().parents[2]}
    if options.old:
        copies["old"] = options.old.resolve()
    with tempfile.TemporaryDirectory() as home:
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "STARBENCH_HOME": home}
        times: dict[str, list[dict[str, float]]] = {name: [] for name in copies}
        for number in range(options.rounds + 1):
            for name, code in copies.items():
                words = [sys.executable, __file__, ONE, str(code), str(options.run.resolve())]
                done = subprocess.run(words, capture_output=True, text=True, check=True, env=environment)
                if number:  # the first one may compile kernels
                    times[name].append(json.loads(done.stdout))
    for part in times["here"][0]:
        middle = {name: statistics.median(one[part] for one in found) for name, found in times.items()}
        ratio = f", old / here {middle['old'] / middle['here']:.2f}" if "old" in middle else ""
        print(f"{part}: " + ", ".join(f"{name} {value:.3f} s" for name, value in middle.items()) + ratio)


if __name__ == "__main__":
    main()
