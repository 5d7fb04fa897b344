"""What the bench's ledger knows of the verdicts of a camera's runs, for the first page of its certificate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from bench.extras.certificate.lab_config import LabConfig
from bench.extras.certificate.limits import limits_of
from bench.record.ledger_marks import LedgerRun
from bench.record.results import Results
from bench.record.run_verdict import Limits, hashes_of, run_verdict
from bench.wording.earlier_runs import ENDS


def verdict_history(runs: Sequence[LedgerRun], results: Results, lab: LabConfig) -> str:
    """Return how the runs of the camera of ``results`` were judged or ended, and when the limits were stated.

    ``runs`` are all of the ledger; one of another camera, or of simulated devices beside real ones, does not count.
    """
    own = run_verdict(results)
    simulated = bool(results["run"]["simulated"])
    of_camera = [run for run in runs if run.simulated == simulated and own.camera in _cameras_of(run)]
    of_lab = _of_lab(lab)
    counts = Counter(_words(run, [hashes_of(of_lab), own.specifications]) for run in of_camera)
    counted = "; ".join(f"{count} {words}" for words, count in counts.items()) or "none"
    text = f"Runs of this camera on this bench, by its ledger: {counted}."
    return f"{text} {_when(of_lab, results)}".rstrip()


def _cameras_of(run: LedgerRun) -> set[str]:
    """Return the serial numbers of a run: the one that its station expected, and the one that the camera stated."""
    return {run.camera} if run.verdict is None else {run.camera, run.verdict.camera}


def _of_lab(lab: LabConfig) -> dict[str, list[Limits]]:
    limits: dict[str, list[Limits]] = {}
    for rule in lab.decision_rules or ():
        limits.setdefault(rule.specification, []).append(limits_of(rule))
    return limits


def _words(run: LedgerRun, here: Sequence[Mapping[str, str]]) -> str:
    """Return a verdict in words; ``here`` holds the specifications of the certificate, each with its hash."""
    verdict = run.verdict
    if run.how != "finished":  # one that was killed when its verdict was known has no other
        return f"not finished ({ENDS.get(run.how, run.how)})"
    if verdict is None:
        return "of an earlier version, with a verdict that its ledger does not hold"
    if verdict.verdict is None:
        return "without limits"
    named = []
    for name, sha256 in sorted(verdict.specifications.items()):
        known = [stated[name] for stated in here if name in stated]
        other = ", with other limits than this certificate has" if known and sha256 not in known else ""
        named.append(f"{name or 'limits without a name'}{other}")
    return f"{verdict.verdict} against {' and '.join(named)}" if named else verdict.verdict


def _when(of_lab: Mapping[str, Sequence[Limits]], results: Results) -> str:
    """Return when the limits of the certificate were stated; empty if it has none."""
    judged = results.get("conformity")
    before = {limits_of(statement) for statement in (judged.statements if judged else ())}
    if {limits for of in of_lab.values() for limits in of} - before:
        which = "Limits" if before else "The limits"
        return f"{which} of this certificate were stated after the run."
    return "The limits of this certificate were stated before the run." if before else ""
