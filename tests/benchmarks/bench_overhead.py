"""What a pose costs besides its devices: the sequencing of 120 poses, every sync included.

Devices are virtual and take no time; folder, recordings and journal are real, on the disk of the working folder. Waits
of the script do not wait. What remains is the machine, the journal, the checks and the disk: printed as milliseconds
a pose, beside what the disk alone takes for as many syncs at that moment, for machines and hours differ.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from pathlib import Path

from bench.base.clock import BenchClock
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.records.journal import Journal, read_journal
from bench.rehearsal.rehearsal import RehearsedJob, rehearse_job
from bench.rehearsal.virtual_devices import VirtualDevices

POSES = 120
BUDGET_MS = 50.0
REPEATS = 3
SEQUENCE = """\
format: starbench/sequence/1
name: A hundred and twenty poses
defaults:
  light: {waveform: square, frequency_hz: 60, duty_percent: 50}
  settle: {duration_s: 0.3}
  record: {window_ms: 33, attempts: 2}
poses:
  many:
    pan_deg: {first: -6, last: 6, count: 12}
    tilt_deg: {first: -2.5, last: 2.5, count: 10}
    order: serpentine
steps:
  - light
  - repeat: {poses: many, steps: [move, settle, record]}
  - light: off
  - solve: {model: spherical, distortion: [k1, k2]}
  - report
"""


class Unhurried(BenchClock):
    """The system's time, in which nobody has to wait."""

    def sleep(self, seconds: float) -> None:
        """Go on at once."""
        del seconds
        self.check()


class Syncs:
    """Counts and times ``os.fsync``."""

    def __init__(self) -> None:
        self.count, self.seconds, self._fsync = 0, 0.0, os.fsync

    def __call__(self, descriptor: int) -> None:
        began_s = time.perf_counter()
        self._fsync(descriptor)
        self.seconds += time.perf_counter() - began_s
        self.count += 1


def one_run(folder: Path) -> dict[str, float]:
    """Run the sequence once; return milliseconds and syncs a pose."""
    sequence = folder / "sequence.yaml"
    sequence.write_text(SEQUENCE, encoding="utf-8")
    task = Job.from_plan(make_plan(*load_documents(str(sequence), "simulated")), seed=1, operator=None)
    clock, syncs = Unhurried(), Syncs()
    job = RehearsedJob(task.plan, task.steps, task.seed, task.operator, clock)
    os.fsync, cpu_s = syncs, time.process_time()
    try:
        end = rehearse_job(
            job, folder / "run", lambda: VirtualDevices(job.station, seed=1, clock=clock), Journal
        )
    finally:
        os.fsync = syncs._fsync
    cpu_s = time.process_time() - cpu_s
    assert end.how == "finished", end.why
    entries, _ = read_journal(folder / "run" / "journal.jsonl")
    begin_s = next(e.mono_s for e in entries if e.event == "entering" and e.data["state"] == "slewing")
    end_s = next(e.mono_s for e in entries if e.event == "entering" and e.data["state"] == "parking")
    return {
        "ms": 1e3 * (end_s - begin_s) / POSES,
        "syncs": syncs.count / POSES,
        "sync_ms": 1e3 * syncs.seconds / POSES,
        "cpu_ms": 1e3 * cpu_s / POSES,
    }


def one_sync_ms(folder: Path) -> float:
    """Time to append 400 bytes and sync them, ms: the disk alone."""
    taken = []
    with (folder / "probe").open("ab", buffering=0) as stream:
        for _ in range(100):
            began_s = time.perf_counter()
            stream.write(b"x" * 400)
            os.fsync(stream.fileno())
            taken.append(time.perf_counter() - began_s)
    return 1e3 * statistics.median(taken)


def main() -> None:
    """Print what a pose costs."""
    runs = []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory(prefix=".bench-overhead-", dir=".") as place:
            probe_ms = one_sync_ms(Path(place))
            runs.append(one_run(Path(place)))
            run = runs[-1]
            print(
                f"{run['ms']:6.1f} ms a pose, {run['syncs']:.1f} syncs taking {run['sync_ms']:.1f} ms,"
                f" all computing {run['cpu_ms']:.1f} ms; a sync alone takes {probe_ms:.2f} ms here and now"
            )
    best = min(run["ms"] for run in runs)
    print(f"Best of {REPEATS}: {best:.1f} ms a pose; the budget is {BUDGET_MS:.0f} ms.")


if __name__ == "__main__":
    main()
