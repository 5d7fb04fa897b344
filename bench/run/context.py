"""What the parts of one run share: task, folder, journal, clock, devices, interlocks. Data only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bench.base.clock import BenchClock
from bench.plan.job import Job
from bench.records.run_folder import RunFolder
from bench.records.run_log import RunLog
from bench.results.interim import Decisions
from bench.results.result import ResultWriter
from bench.run.interlocks import Interlocks
from bench.run.run_devices import RunDevices


@dataclass(frozen=True)
class RunContext:
    """One run, as its states and steps see it."""

    job: Job
    folder: RunFolder  # Locked by this process
    log: RunLog
    clock: BenchClock  # A requested stop ends the run safely
    devices: RunDevices
    interlocks: Interlocks
    results: ResultWriter
    decisions: Decisions  # Decides for the ``until`` steps
    say: Callable[[str], None]  # Shows a line to the operator
