"""Derives a run's results again from its recordings: finds the stars, calibrates, and compares every number.

Reads the run folder only. On the same computer with the same program all numbers are equal to the last bit. Another
computer may round otherwise, so numbers count as equal within a small tolerance: values and standard uncertainties of
the calibration within a thousandth of the standard uncertainty, all other numbers within one millionth. Numbers of the
planar model, which is there for comparison, may differ by a hundredth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.base.errors import BenchError
from bench.evidence.findings import Findings
from bench.records.history import Attempt
from bench.records.run_folder import JOURNAL, RESULTS
from bench.results.compare_json import Number, Tolerance, differences
from bench.results.derive_again import RunEvidence, read_evidence
from bench.results.derive_report import UNREADABLE
from bench.results.other_engine import described, is_excused, same_stars
from bench.results.other_software import other_program
from bench.results.results_content import results_content
from bench.results.solution import Solution, solve_run
from bench.views.camera_kinds import CameraKind
from bench.views.expected_grid import grid_from_journal
from bench.views.gates import failed_gate_texts
from bench.views.measure import Measurement
from bench.views.views_file import VIEWS, read_picture, read_views
from calib.errors import CalibrationError
from calib.view import View
from drivers.errors import DriverError

TOLERANCE_SIGMAS = 1e-3
"""Values that differ by less than this fraction of their standard uncertainty count as equal."""
TOLERANCE_SHARE = 1e-6
TOLERANCE_PLANAR = 1e-2
"""The same for all numbers of the planar model, which is there for comparison. Three views hardly determine it: points
that are moved by 1e-11 px change its standard uncertainties by up to 0.6 %."""
_COUNTED = ("iterations",)
"""Numbers of work, not of results: rounding may change them by a few."""
_MOST_SHOWN = 12


@dataclass(frozen=True)
class SeenView:
    """How a stored view differs from the one found again."""

    name: str
    seen: Sequence[str]  # What differs: ``other star ids``
    # Whether another program found it, and its stars are the same (`bench.results.other_engine.same_stars`).
    excused: bool


def check_recordings(folder: Path) -> Findings:
    """Measure every recording of a run again, calibrate again, and compare journal, results.json and views.h5.

    folder: The run folder; its seal, its journal and its files as compared with each other have no fault.
    Raises OSError: When a file cannot be read.
    """
    found = Findings()
    evidence = read_evidence(folder, found)
    if evidence is None:
        return found
    measured = _check_attempts(evidence, found)
    step = evidence.solve_step
    if evidence.results is None or step is None:
        found.remarks.append("this run has no results to calculate again")
        return found
    try:
        solution = solve_run(evidence.job, folder, step, evidence.history, measured)
        truth = evidence.job.read_truth()
        used = evidence.results["run"]["software"]
        again = results_content(evidence.job, evidence.history, solution, truth, used)
        check_numbers(evidence.results, again, found)
    except (BenchError, CalibrationError, DriverError) as error:
        found.fault("results", RESULTS, f"the run cannot be calibrated again: {error}")
        return found
    except UNREADABLE as error:
        found.fault("results", RESULTS, f"the results have no calibration to compare ({error!r})")
        return found
    _check_views(folder, solution, found, other=bool(other_program(used)))
    return found


def _check_attempts(evidence: RunEvidence, found: Findings) -> dict[int, Measurement]:
    """Measure every recording again and compare with the journal; return the measurements of the accepted ones."""
    kept: dict[int, Measurement] = {}
    other = other_program(evidence.history.started.get("software", {}))
    for attempt in evidence.history.attempts:
        name = str(attempt.stored["capture"])
        if not (evidence.folder / name).is_file():
            found.remarks.append(f"{name} was lost before the run was resumed, so it was not measured again")
            continue
        again = _measure(evidence, attempt)
        if attempt.accepted and again.view is not None:
            kept[attempt.pose_index] = again
        if attempt.checked is None:
            continue
        due = _judged(evidence.job.camera_kind, evidence, attempt, again)
        had = {name: attempt.checked.get(name) for name in due}
        where = f"pose {attempt.pose_index} attempt {attempt.attempt}"
        seen = list(differences(had, due, _tolerance({}, {}), where))
        if other and had["accepted"] == due["accepted"]:
            seen = [one for one in seen if not (is_excused(one, {}) or ".reasons[" in one.where)]
        for one in seen[:_MOST_SHOWN]:
            found.fault("journal", JOURNAL, f"the recordings do not give what it states: {one}")
    return kept


def _measure(evidence: RunEvidence, attempt: Attempt) -> Measurement:
    job = evidence.job
    step = job.record_step(attempt.pose_index)
    path = evidence.folder / str(attempt.stored["capture"])
    return job.camera_kind.measure(path, step, job.frequency_hz(step), job.target, grid_from_journal(attempt))


def _judged(kind: CameraKind, evidence: RunEvidence, attempt: Attempt, again: Measurement) -> dict[str, Any]:
    """Return what the journal must hold about the measurement of a recording, except the expected grid."""
    job, stored = evidence.job, attempt.stored
    step = job.record_step(attempt.pose_index)
    gates, other_reasons = kind.judge(stored["facts"], step, job.frequency_hz(step), again)
    gates += job.motion_gates(stored["measured_deg"], stored["measured_after_deg"])
    reasons = [again.fault] if again.fault else []
    reasons += failed_gate_texts(gates) + other_reasons
    facts = {name: value for name, value in again.facts.items() if name != "expected_grid"}
    stated = attempt.measured.get("expected_grid")
    return {
        "accepted": not reasons,
        "reasons": reasons,
        "stars": again.stars,
        "gates": [gate.as_data() for gate in gates],
        "measured": {**facts, **({"expected_grid": stated} if stated is not None else {})},
    }


def check_numbers(stored: Mapping[str, Any], again: Mapping[str, Any], found: Findings) -> None:
    """Compare all of results.json, except the comparison with an earlier run, whose folder may be gone.

    found: Findings; they are added.
    """
    had = {name: value for name, value in stored.items() if name != "previous"}
    rounded = list(differences(had, again))
    if not rounded:
        found.remarks.append("calculated again from the recordings: every number is equal to the last bit")
        return
    planar = again.get("planar") or {"sigma": {}}
    every = list(differences(had, again, _tolerance(again["calibration"]["sigma"], planar["sigma"])))
    other = other_program(stored["run"]["software"])
    sigma = again["calibration"]["sigma"]
    excused = [one for one in every if other and is_excused(one, sigma)]
    seen = [one for one in every if one not in excused]
    if excused:
        places = described(excused, sigma, _MOST_SHOWN)
        found.not_compared.append(
            f"{RESULTS} with the recordings: another program calculated it, with differences in {places}"
        )
    for one in seen[:_MOST_SHOWN]:
        found.fault("results", RESULTS, f"the recordings do not give it: {one}")
    if len(seen) > _MOST_SHOWN:
        found.fault("results", RESULTS, f"{len(seen) - _MOST_SHOWN} further values differ")
    if seen and other:
        found.remarks.append(
            f"the results were made with {other}, but the differences are too large to come from that alone"
        )
    rounded = [one for one in rounded if one.kind == "value" and not isinstance(one.stored, str)]
    if not seen and not excused and rounded:
        found.remarks.append(
            f"calculated again from the recordings: {len(rounded)} numbers differ, by rounding only: {rounded[0]}"
        )


def _tolerance(sigma: Mapping[str, float], planar_sigma: Mapping[str, float]) -> Tolerance:
    """Return the tolerance for numbers of results.json, with the standard uncertainties of both calibrations."""
    parameters = {
        f"{which}.{part}.{name}": share * value
        for which, share, stated in (
            ("calibration", TOLERANCE_SIGMAS, sigma),
            ("planar", TOLERANCE_PLANAR, planar_sigma),
        )
        for name, value in stated.items()
        for part in ("camera", "collimator", "sigma")
    }

    def equal(where: str, stored: Number, derived: Number, scale: float) -> bool:
        if where.rpartition(".")[2] in _COUNTED:
            return abs(stored - derived) <= max(2.0, 0.1 * abs(derived))
        if where in parameters:
            return abs(stored - derived) <= parameters[where]
        share = TOLERANCE_PLANAR if where.startswith("planar.") else TOLERANCE_SHARE
        return abs(stored - derived) <= share * scale

    return equal


def _check_views(folder: Path, solution: Solution, found: Findings, *, other: bool) -> None:
    """Compare stars, residuals and images of views.h5 with those found again; those of another program roughly."""
    stored = read_views(folder / VIEWS)
    residuals = solution.calibration.residuals_px
    views = []
    for number, (had, found_again, residual) in enumerate(
        zip(stored, solution.measurements, residuals, strict=True), start=1
    ):
        assert found_again.view is not None
        assert found_again.image is not None
        name = found_again.view.name
        seen = [f"other {what}" for what in views_differ(had.view, found_again.view)]
        if not close(had.residuals_px, residual):
            seen.append("other residuals")
        if differ := np.count_nonzero(read_picture(folder / VIEWS, number) != found_again.image.decoded()):
            seen.append(f"another image: {differ} pixels differ")
        views.append(SeenView(name, seen, other and same_stars(had.view, found_again.view)))
    tell_views(views, "recordings", found)


def tell_views(views: Sequence[SeenView], source: str, found: Findings) -> None:
    """Tell how the stored views of recordings differ from those found again.

    source: What the views come from: ``recordings``.
    found: Findings; they are added.
    """
    excused = [view for view in views if view.seen and view.excused]
    if excused:
        parts = ", ".join(dict.fromkeys(part for view in excused for part in view.seen))
        names = ", ".join(view.name for view in excused)
        found.not_compared.append(
            f"{names} of {VIEWS} with the {source}: another program found the stars, with {parts}"
        )
    for view in views:
        if view.excused:
            continue
        for what in view.seen:
            found.fault("views", VIEWS, f"the {source} of {view.name} give {what}")


def views_differ(stored: View, again: View) -> list[str]:
    """Return which parts of two views differ.

    stored: View of views.h5.
    """
    arrays: Sequence[tuple[str, Any, Any]] = [
        ("image sizes", stored.image_size, again.image_size),
        ("star ids", stored.ids, again.ids),
        ("image points", stored.points_px, again.points_px),
        ("points of the target", stored.target_mm, again.target_mm),
        ("covariances", stored.covariances_px2, again.covariances_px2),
    ]
    if (stored.rim is None) != (again.rim is None):
        return ["points of the rim"]
    if stored.rim is not None and again.rim is not None:
        arrays = [
            *arrays,
            ("points of the rim", stored.rim.points_mm, again.rim.points_mm),
            ("sigmas of the rim", stored.rim.sigmas_mm, again.rim.sigmas_mm),
        ]
    return [name for name, had, due in arrays if not close(np.asarray(had, float), np.asarray(due, float))]


def close(stored: NDArray[np.float64], again: NDArray[np.float64]) -> bool:
    """Return whether two arrays are equal but for rounding.

    stored, again: float64 arrays of any shape and unit.
    Returns: Whether shapes are equal, and values within one millionth of the largest.
    """
    if stored.shape != again.shape:
        return False
    scale = float(np.max(np.abs(again), initial=0.0))
    return bool(np.all(np.abs(stored - again) <= TOLERANCE_SHARE * scale))
