"""Every error the bench itself raises; those of the other folders pass through it unchanged.

BenchError
├── UsageError           an argument or option that makes no sense
├── ScriptError          a sequence or station file that cannot be run (carries every fault at once)
├── RunFolderError       a run folder that exists, is missing, locked, sealed or not a run
│   └── JournalBroken    a journal whose chain does not hold
├── StorageError         disk full, no permission, a write that failed
├── PreflightFailed      the bench is not as the station file says
├── PoseFailed           a pose failed all its attempts
├── InterlockHeld        an interlock has held a run for longer than it may
├── EvidenceError        a bundle that does not verify, a key that cannot be used
└── SimulationError      the simulated bench did not start, or died
Aborted                  not an error: the operator or the system asked to stop (see bench.base.clock)
"""

from __future__ import annotations

from collections.abc import Sequence


class BenchError(Exception):
    """What is wrong, where, and what to do about it.

    ``exit_status`` is what the command line ends with.
    """

    exit_status = 1

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        place = f"{where}: " if where else ""
        advice = f" {remedy}" if remedy else ""
        super().__init__(f"{place}{what}{advice}")


class UsageError(BenchError):
    """An argument or option that makes no sense."""

    exit_status = 2


class ScriptError(BenchError):
    """Files that cannot be run, with every fault found in them.

    Parameters
    ----------
    faults
        Lines of the form ``file:line:column: what``.
    """

    exit_status = 2

    def __init__(self, faults: Sequence[str]) -> None:
        self.faults = list(faults)
        super().__init__("\n".join(self.faults))


class RunFolderError(BenchError):
    """A run folder that cannot be used as asked."""


class JournalBroken(RunFolderError):
    """A journal whose chain does not hold."""


class StorageError(BenchError):
    """The disk did not take what it was given."""


class PreflightFailed(BenchError):
    """The bench is not as the station file says."""


class PoseFailed(BenchError):
    """A pose failed all its attempts."""


class InterlockHeld(BenchError):
    """An interlock has held a run for longer than it may."""


class EvidenceError(BenchError):
    """A bundle that does not verify, or a key that cannot be used."""


class SimulationError(BenchError):
    """The simulated bench did not start, or died."""
