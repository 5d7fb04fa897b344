"""Derives recalculated results again from their sources: calibrates with the stored options, compares every number.

Reads the folder of the results and the sources that it names. Where a source has gone, or is another file now, it says
that the numbers were not compared.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.evidence.findings import Findings
from bench.evidence.passport_seal import read_passport_seal
from bench.plan.passport_file import read_passport_file
from bench.plan.passports import PassportInUse
from bench.records.reading import read_json
from bench.records.run_folder import PASSPORT_COPY, RESULTS
from bench.records.storage import sha256_of
from bench.results.derive_report import UNREADABLE
from bench.results.offline import OfflineResult, calibrate_paths
from bench.results.offline_folder import SOURCES, offline_results, source_data
from bench.results.other_engine import same_stars
from bench.results.other_software import other_program
from bench.results.reproduce import SeenView, check_numbers, close, tell_views, views_differ
from bench.results.stored_options import options_of_data
from bench.views.views_file import VIEWS, read_views
from calib.errors import CalibrationError
from calib.target import StarTarget
from drivers.errors import DriverError


def check_recalculated(folder: Path) -> Findings:
    """Calibrate the sources of recalculated results again, with the same options, and compare every number.

    folder: The folder; its seal and its files as compared with each other have no fault.
    Returns: Every number that differs; or why the numbers could not be compared.
    Raises OSError: When a file cannot be read.
    """
    found = Findings()
    described = read_json(folder / SOURCES)
    if why := _cannot(described):
        found.not_compared.append(f"{RESULTS} with its sources: {why}")
        return found
    stored = read_json(folder / RESULTS)
    try:
        again = _calibrated(folder, described)
        sources = [
            source_data(source, view.name) for source, view in zip(again.sources, again.views, strict=True)
        ]
        if sources != described["sources"]:
            found.not_compared.append(
                f"{RESULTS} with its sources: the paths hold other files now than those that were calculated from"
            )
            return found
        content = offline_results(again, str(stored["run"]["id"]), sources)
        run = {name: stored["run"][name] for name in ("calibrated_utc", "sealed_by", "software")}
        check_numbers(stored, json.loads(json.dumps({**content, "run": {**content["run"], **run}})), found)
    except (BenchError, CalibrationError, DriverError) as error:
        found.fault("results", RESULTS, f"its sources cannot be calibrated again: {error}")
        return found
    except UNREADABLE as error:
        found.fault("results", RESULTS, f"it cannot be compared with its sources ({error!r})")
        return found
    _check_stars(folder, again, found, other=bool(other_program(stored["run"]["software"])))
    return found


def _cannot(described: Mapping[str, Any]) -> str:
    """Return why the calibration cannot be made again; empty if it can."""
    if "options" not in described:
        return "an earlier version wrote them, without the options of the calculation"
    gone = [path for path in described["paths"] if not Path(path).exists()]
    if gone:
        return f"{gone[0]} is not there any more" + (f", and {len(gone) - 1} more" if len(gone) > 1 else "")
    for source in described["sources"]:
        path = Path(str(source["path"]))
        if not path.is_file():
            return f"{path} is not there any more"
        if sha256_of(path) != source["sha256"]:
            return f"{path} is another file now"
    return ""


def _calibrated(folder: Path, described: Mapping[str, Any]) -> OfflineResult:
    """Calibrate the sources again. Raises the errors of the reader and of the engine, and one of ``UNREADABLE``."""
    stored, passport = described["options"], None
    if stored["passport"] is not None:
        copied, data = read_passport_file(folder / PASSPORT_COPY)
        seal = read_passport_seal(data)
        passport = PassportInUse(copied, data, "command line", str(stored["passport"]), seal=seal)
    given = described["option_target"]
    target = StarTarget(**{**given, "tag_square": tuple(given["tag_square"])})
    return calibrate_paths(
        [Path(path) for path in described["paths"]], options_of_data(stored, passport, target)
    )


def _check_stars(folder: Path, again: OfflineResult, found: Findings, *, other: bool) -> None:
    """Compare stars and residuals of views.h5 with those found again."""
    residuals = again.calibration.residuals_px
    views = []
    for had, view, residual in zip(read_views(folder / VIEWS), again.views, residuals, strict=True):
        seen = [f"other {what}" for what in views_differ(had.view, view)]
        if not close(had.residuals_px, residual):
            seen.append("other residuals")
        views.append(SeenView(view.name, seen, other and same_stars(had.view, view)))
    tell_views(views, "sources", found)
