"""Compares verdict and causes in the journal of a sealed run with its results; nothing is measured again."""

from __future__ import annotations

from pathlib import Path

from bench.again.compare import differences
from bench.base.errors import RunFolderError
from bench.evidence.findings import UNREADABLE, Findings
from bench.record.run_folder import JOURNAL, RESULTS
from bench.record.stored_run import StoredRun
from bench.report.verdict import verdict
from bench.solve.results_content import other_software


def check_verdict(folder: Path) -> Findings:
    """Compare the verdict that lists of runs and messages show with the one that the results give.

    A verdict by another version of the program is not compared: its rules and its words may have been others.
    """
    findings, run = Findings(), StoredRun(folder)
    if not (folder / RESULTS).is_file():
        return findings
    try:
        results = run.results_as_written
        due = verdict(results)
        made = results["run"]["software"]
        causes = {"causes": list(results.get("causes", ()))}
    except RunFolderError as error:
        findings.fault("results", RESULTS, error.what.rstrip("."))
        return findings
    except UNREADABLE as error:
        findings.fault("results", RESULTS, f"the results give no verdict ({error!r})")
        return findings
    for difference in differences({"causes": list(run.history.solved.get("causes", ()))}, causes):
        findings.fault(
            "journal",
            JOURNAL,
            f"what a person did to the bench is another thing in the results: {difference}",
        )
    if other_software(made, ["program"]):
        return findings
    stated = run.history.verdict
    if stated is None:
        findings.fault("journal", JOURNAL, "it has no verdict; this version of the program writes one")
    elif (stated["kind"], stated["headline"]) != (due.kind, due.line):
        what = f"its verdict is {stated['headline']!r} ({stated['kind']})"
        findings.fault("journal", JOURNAL, f"{what}; by the results it is {due.line!r} ({due.kind})")
    return findings
