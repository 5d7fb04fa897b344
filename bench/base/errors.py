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
from dataclasses import asdict, dataclass

from calib.errors import CalibrationError
from drivers.errors import DriverError, NotARecording, RecordingCorrupt
from sequences.errors import SequencesError


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


# One shape for every error that was foreseen, whichever package raised it: kind, what, where, remedy.


FORESEEN = (BenchError, CalibrationError, DriverError, SequencesError)
"""Errors that state what is wrong and what to do; any other exception is a defect."""
INVALID_FILES = (NotARecording, RecordingCorrupt)
"""Those of a file that cannot be read for what it holds: exit status 2, as for invalid arguments."""


@dataclass(frozen=True)
class Failure:
    """Why something failed."""

    kind: str  # The error's class, as in the tree at the head of each package's ``errors`` module
    what: str
    where: str = ""  # The device, port, file or view it concerns; empty where it concerns none
    remedy: str = ""  # What the operator should do; empty where nothing is known

    @property
    def message(self) -> str:
        """Place, what is wrong, and remedy, as people read them."""
        place = f"{self.where}: " if self.where else ""
        advice = f" {self.remedy.strip()}" if self.remedy else ""
        return f"{place}{self.what}{advice}"

    @classmethod
    def of(cls, error: BaseException) -> Failure:
        """Describe an error, with its own place and remedy where it has them."""
        if isinstance(error, FORESEEN):
            return cls(type(error).__name__, error.what, error.where, error.remedy)
        return cls(type(error).__name__, str(error), "", "This is a defect of the program. Please report it.")

    def to_dict(self) -> dict[str, str]:
        """Return the failure as JSON holds it: ``kind``, ``what``, ``where``, ``remedy``."""
        return asdict(self)
