"""Compares the numbers of results.json that follow from its calibration and its views, without calibrating again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.evidence.findings import Findings
from bench.plan.job import Job
from bench.records.history import History
from bench.records.run_folder import RESULTS
from bench.results.compare_json import differences, within
from bench.results.comparison import compare_with_truth
from bench.results.other_software import other_software
from bench.results.previous_calibration import change_since
from bench.results.results_content import SCHEMA, projection, software
from bench.results.solve_options import readings_result, solve_options
from calib.calibration import Calibration
from calib.view import View
from sequences.script import SolveStep

_SAME = within(1e-9)
"""Numbers that differ less were rounded differently by another computer."""
_WITH_AGAIN = ("planar", "halves", "gimbal", "parallax")
"""Parts that need a calibration; `bench.results.reproduce` compares them."""
_COMPARED_ELSEWHERE = {
    "run", "devices", "conditions", "calibration", "poses", "untils", "deviations", "devices_left", "failures",
    "states", "previous", "truth", *_WITH_AGAIN,
}  # fmt: skip
_MOST_SHOWN = 12


def check_calculated(
    history: History,
    job: Job,
    step: SolveStep,
    results: Mapping[str, Any],
    calibration: Calibration,
    views: Sequence[View],
    judged: Sequence[Mapping[str, Any]],
    found: Findings,
) -> None:
    """Compare gates, projection, passport, readings, comparison and change with what the calibration gives.

    history: History of the run when its results were made.
    found: Findings; they are added.
    """
    readings = [attempt.stored["measured_deg"] for _, attempt in sorted(history.accepted().items())]
    options = solve_options(job, step, readings)
    in_use = job.plan.passport.in_use if options.passport is not None else None
    truth = results.get("truth")  # --again asks the simulated world for it
    due: dict[str, Any] = {
        "schema": SCHEMA,
        "gates": list(judged),
        "projection": projection(calibration, views),
        "passport": in_use.to_dict() if in_use else None,
        "gimbal_readings": readings_result(
            calibration,
            options,
            witness=step.readings == "witness",
            stated=job.station.gimbal is not None,
        ),
        "comparison": compare_with_truth(calibration, truth) if truth is not None else [],
        "sigma": dict(calibration.sigma),
    }
    had = {name: results.get(name) for name in due}
    had["gates"] = results["gates"][: len(judged)]
    had["sigma"] = results["calibration"]["sigma"]
    if isinstance(previous := results.get("previous"), Mapping) and previous.get("run") is not None:
        due["change"] = change_since(previous["calibration"], results["calibration"])
        had["change"] = previous["change"]
    if (truth is not None) != job.station.needs_simulated_bench:
        found.fault("results", RESULTS, "it has a truth if, and only if, the station has a simulated bench")
    seen = list(differences(had, due, _SAME))
    further = [name for name in results if name not in due and name not in _COMPARED_ELSEWHERE]
    other = other_software(results, tuple(software()))
    if other and (seen or further):
        places = ", ".join([*(one.where for one in seen), *further][:_MOST_SHOWN])
        found.not_compared.append(f"{places} of {RESULTS}: another program calculated it")
        return
    for one in seen[:_MOST_SHOWN]:
        found.fault("results", RESULTS, str(one))
    for name in further:
        found.fault("results", RESULTS, f"{name} follows from nothing; no run writes it")
