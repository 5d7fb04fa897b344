"""What helps after a run that did not finish: the command for terminal, messages, panel and the report of the run."""

from __future__ import annotations

from pathlib import Path

import calib.errors
from bench.records.history import History


def way_on(history: History, folder: Path) -> tuple[str, str]:
    """Return what there is to know, as a sentence, and the command that can work.

    A resumed run uses the copies of its files in the run folder and the recordings that it has. It ends in the same
    way if a file was wrong, or if the recordings do not determine the camera.
    """
    kind = history.failures[-1]["kind"] if history.ended == "failed" and history.failures else ""
    if kind and issubclass(getattr(calib.errors, kind, type(None)), calib.errors.CalibrationError):
        return (
            "All recordings are kept. With the same model they are refused again. To let the data choose the model:",
            f"starbench calibrate {folder} --model auto",
        )
    if kind and not history.attempts:
        copies = f"a resumed run would use the copies of its files in {folder}"
        return (
            f"Nothing was recorded. Remove the cause; {copies}. To begin again, with corrected files:",
            "starbench run SEQUENCE --station STATION",
        )
    return "All recordings are kept. To continue:", f"starbench resume {folder}"
