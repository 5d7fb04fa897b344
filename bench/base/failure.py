"""One shape for every error that was foreseen, whichever package raised it: kind, what, where, remedy."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from bench.base.encoding import printable_line
from bench.base.errors import BenchError
from calib.errors import CalibrationError
from drivers.errors import DriverError, NotARecording, RecordingCorrupt
from sequences.errors import SequencesError

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
        place = f"{printable_line(self.where)}: " if self.where else ""
        advice = f" {self.remedy.strip()}" if self.remedy else ""
        return f"{place}{self.what}{advice}"

    @classmethod
    def of(cls, error: BaseException) -> Failure:
        """Describe an error, with its own place and remedy where it has them."""
        if isinstance(error, FORESEEN):  # names of other programs stand in it, and write no line of their own
            lines = [str(fault) for fault in getattr(error, "faults", ())]
            what = "\n".join(map(printable_line, lines if len(lines) > 1 else [error.what]))
            return cls(type(error).__name__, what, error.where, error.remedy)
        return cls(type(error).__name__, str(error), "", "This is a defect of the program. Please report it.")

    def to_dict(self) -> dict[str, str]:
        """Return the failure as journal and JSON hold it."""
        return asdict(self)
