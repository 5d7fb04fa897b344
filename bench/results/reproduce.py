"""Checks that a run's results follow from its recordings: detects the stars again, calibrates again, and compares.

Reads the run folder only: captures, journal, sequence, station, results. Another machine may round the last bits
differently. Two values therefore count as equal if they differ by a small fraction of their uncertainty.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.records.run_folder import RESULTS
from bench.results.offline import calibrate_paths
from bench.results.offline_options import OfflineOptions
from calib.errors import CalibrationError
from drivers.errors import DriverError

TOLERANCE_SIGMAS = 1e-3
"""Values that differ by less than this fraction of their standard uncertainty count as equal."""


def differences(folder: Path) -> list[str]:
    """Calibrate a run again from its recordings, and list the differences from its results.

    Parameters
    ----------
    folder
        The run folder.

    Returns
    -------
    list of str
        A sentence for each value that differs, or the reason why the run cannot be calibrated again; empty if all
        values agree.

    Raises
    ------
    ScriptError
        When the run's sequence or station file cannot be read.
    JournalBroken
        When its journal is not intact.
    """
    stored = json.loads((folder / RESULTS).read_bytes())["calibration"]
    try:
        again = calibrate_paths([folder], OfflineOptions())
    except (BenchError, CalibrationError, DriverError) as error:
        return [f"the run cannot be calibrated again: {error}"]
    skipped = [f"no stars are found any more in an accepted recording: {why}" for why in again.skipped]
    return skipped + _differences_between(stored, again.calibration.to_dict())


def _differences_between(stored: Mapping[str, Any], again: Mapping[str, Any]) -> list[str]:
    """Compare two calibrations in the form of results.json."""
    if stored["model"] != again["model"] or set(stored["sigma"]) != set(again["sigma"]):
        models = [f"{c['model']} in {', '.join(c['sigma'])}" for c in (again, stored)]
        return [f"the recordings give the model {models[0]}; the results have {models[1]}"]
    values = [{**c["camera"], **(c["collimator"] or {})} for c in (stored, again)]
    found = []
    for name, sigma in again["sigma"].items():
        bound = TOLERANCE_SIGMAS * sigma
        if not abs(values[0][name] - values[1][name]) <= bound:
            found.append(
                f"the recordings give {name} = {values[1][name]:.9g}, the results {values[0][name]:.9g}"
            )
        if not abs(stored["sigma"][name] - sigma) <= bound:
            found.append(
                f"the recordings give {name} the standard uncertainty {sigma:.6g}, "
                f"the results {stored['sigma'][name]:.6g}"
            )
    return found
