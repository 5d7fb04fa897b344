"""Compares what the journal of a sealed run repeats of its results; nothing is measured again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.evidence.findings import Findings
from bench.record.run_folder import JOURNAL, RESULTS
from bench.record.stored_run import StoredRun
from bench.report.verdict import verdict
from bench.solve.results_content import causes_without_earlier_run, other_software

_OF_CALIBRATION = ("model", "converged", "rms_px", "sigma", "coverage_factor", "coverage_factors")


def check_verdict(folder: Path) -> Findings:
    """Compare what lists of runs and messages show with the results.

    A verdict by another version of the program is not compared: its rules and its words may have been others.
    """
    findings, run = Findings(), StoredRun(folder)
    if run.has_results:
        with findings.unreadable("results", RESULTS, "the results give no verdict"):
            _compare(run, findings)
    return findings


def _compare(run: StoredRun, findings: Findings) -> None:
    due, solved = verdict(run.results), run.history.solved
    repeated = _repeated(run.results)
    told = {**solved, "causes": causes_without_earlier_run(solved)}
    for name in repeated.keys() & told.keys():
        if told[name] != repeated[name]:
            what = f"its {name} of the calibration differs from that of the results"
            findings.fault("journal", JOURNAL, what)
    stated = run.history.verdict
    if other_software(run.results["run"]["software"], ["program"]):
        return
    if stated is None:
        findings.fault("journal", JOURNAL, "it has no verdict; this version of the program writes one")
    elif (stated["kind"], stated["headline"]) != (due.kind, due.line):
        what = f"its verdict is {stated['headline']!r} ({stated['kind']})"
        findings.fault("journal", JOURNAL, f"{what}; by the results it is {due.line!r} ({due.kind})")


def _repeated(results: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of results that the journal's line of the calibration repeats."""
    calibration = results["calibration"]
    placed = {**calibration["camera"], **(calibration["collimator"] or {})}
    return {
        **{name: calibration[name] for name in _OF_CALIBRATION},
        "values": {name: placed.get(name) for name in calibration["sigma"]},
        "causes": list(results.get("causes", ())),
    }
