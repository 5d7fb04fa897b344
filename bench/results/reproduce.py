"""Whether the results of a run follow from its recordings: finds the stars and calibrates again, and compares.

Reads the run folder only: captures, journal, sequence, station, results. Another machine may round the last bits
otherwise, so values count as the same when they differ by a small share of their own uncertainty.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.plan.job import Job, calibration_options
from bench.records.run_folder import RESULTS, SEQUENCE_COPY, STATION_COPY
from bench.results.offline import OfflineOptions, calibrate_paths
from calib.errors import CalibrationError
from drivers.errors import DriverError
from sequences.script import SolveStep

TOLERANCE_SIGMAS = 1e-3
"""Values that differ by less than this share of their standard uncertainty are the same."""


def differences(folder: Path) -> list[str]:
    """Calibrate a run again from its recordings, and say where its results differ.

    Parameters
    ----------
    folder
        The run folder.

    Returns
    -------
    list of str
        A sentence for each value that differs, or why it cannot be done again; empty when all follows.

    Raises
    ------
    ScriptError
        When the run's sequence or station file cannot be read.
    JournalBroken
        When its journal does not hold.
    """
    job = Job.from_files(str(folder / SEQUENCE_COPY), str(folder / STATION_COPY), seed=0, operator=None)
    solve = [step for step in job.steps if isinstance(step, SolveStep)][-1]
    stored = json.loads((folder / RESULTS).read_bytes())["calibration"]
    try:
        again = calibrate_paths([folder], OfflineOptions(options=calibration_options(solve)))
    except (BenchError, CalibrationError, DriverError) as error:
        return [f"it cannot be calibrated again: {error}"]
    skipped = [f"a recording that was accepted shows no stars now: {why}" for why in again.skipped]
    return skipped + _differences_between(stored, again.calibration.to_dict())


def _differences_between(stored: Mapping[str, Any], again: Mapping[str, Any]) -> list[str]:
    """Compare two calibrations as results.json holds them."""
    if stored["model"] != again["model"] or set(stored["sigma"]) != set(again["sigma"]):
        models = [f"{c['model']} in {', '.join(c['sigma'])}" for c in (again, stored)]
        return [f"the recordings give the model {models[0]}; the results tell {models[1]}"]
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
                f"the recordings give {name} the sigma {sigma:.6g}, the results {stored['sigma'][name]:.6g}"
            )
    return found
