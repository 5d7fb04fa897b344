"""The errors that the bench itself raises. Errors of the other packages pass through the bench unchanged.

BenchError
├── UsageError           an invalid argument or option
├── ScriptError          a sequence or station file that cannot be run (with all their faults)
├── RunFolderError       a run folder that exists already, is missing, locked, sealed or not a run folder
│   └── JournalBroken    a journal whose hash chain is broken
├── StorageError         disk full, no permission, a read or write that failed
├── PreflightFailed      the devices differ from the station file
├── PoseFailed           all attempts at a pose failed
├── InterlockHeld        an interlock has held a run for longer than its limit
├── ControlRefused       a control of the align page that cannot be used now
├── EvidenceError        a seal or signature that is not valid, a key that cannot be used
└── SimulationError      the simulated bench did not start, or has ended
Aborted                  not an error: the operator or the system has asked to stop (see bench.base.clock)
"""

from __future__ import annotations

from collections.abc import Sequence


class BenchError(Exception):
    """An error that states what is wrong, where, and what the operator should do."""

    exit_status = 1

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = _one_stop(what)
        self.where = where
        self.remedy = remedy
        place = f"{where}: " if where else ""
        advice = f" {remedy}" if remedy else ""
        super().__init__(f"{place}{self.what}{advice}")


def _one_stop(text: str) -> str:
    """Return a text with one full stop at its end, where it has two because it ends with a quoted sentence."""
    return text[:-1] if text.endswith("..") and not text.endswith("...") else text


class UsageError(BenchError):
    """An invalid argument or option."""

    exit_status = 2


class ScriptError(BenchError):
    """Files that cannot be run, with every fault found as ``file:line:column: what``."""

    exit_status = 2

    def __init__(self, faults: Sequence[str]) -> None:
        self.faults = list(faults)
        super().__init__("\n".join(self.faults))


class RunFolderError(BenchError):
    """A run folder that cannot be used for what was asked."""


class JournalBroken(RunFolderError):
    """A journal whose hash chain is broken."""


class StorageError(BenchError):
    """The file system refused to read or to write."""


class PreflightFailed(BenchError):
    """The devices differ from the station file."""


class PoseFailed(BenchError):
    """All attempts at a pose failed."""


class InterlockHeld(BenchError):
    """An interlock has held a run for longer than its limit."""


class ControlRefused(BenchError):
    """A control of the align page that cannot be used now; nothing was changed."""


class EvidenceError(BenchError):
    """A seal or signature that is not valid, or a key that cannot be used."""


class SimulationError(BenchError):
    """The simulated bench did not start, or has ended."""
