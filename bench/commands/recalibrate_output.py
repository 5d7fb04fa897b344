"""Print a recalculation of many runs: a line for each run in plain words, the progress, and the sum at the end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.commands.live_line import LiveLine
from bench.terminal.duration import clock_text
from bench.terminal.encoding import printable

if TYPE_CHECKING:
    from bench.cluster.recalculation import Counts

_SHOWN = ("fx", "cx", "cy", "r")
_ROUNDING_SIGMA = 1e-6


def run_text(row: Mapping[str, Any]) -> str:
    """Return one line about a run.

    Returns: Values with their expanded uncertainty and its k, and the largest change against the run's own
      results; or why it failed.
    """
    from bench.commands.calibration_output import unit_text
    from bench.report.target_words import words_for
    from bench.report.text import with_uncertainty

    name = Path(str(row["folder"]).rstrip("/")).name
    if row["state"] != "done":
        failure = row["failure"]
        place = f" ({failure['where']})" if failure["where"] else ""
        return printable(f"{name}: FAILED. {failure['what']}{place} {failure['remedy']}".rstrip())
    if row.get("skipped"):
        where = f"; its results are in {row['results']}" if row["results"] else ""
        return printable(f"{name}: was done before{where}.")
    shown, k = [], row["coverage_factor"]
    for parameter in _SHOWN:
        if parameter in row["sigma"]:
            value, expanded = with_uncertainty(row["values"][parameter], k * row["sigma"][parameter])
            shown.append(f"{parameter} {value} ± {expanded} {unit_text(parameter)}".rstrip())
    located = f"{row['stars']} {words_for(row.get('board')).points}"  # rows of earlier versions have no board
    parts = [f"{', '.join(shown)} (U with k = {k:.3g})", f"{row['views']} views, {located}"]
    if row["left_out"]:
        parts.append(f"{len(row['left_out'])} recordings left out")
    if not row["converged"]:
        parts.append("NOT CONVERGED")
    return printable(f"{name}: {'; '.join([*parts, change_text(row)])}.")


def change_text(row: Mapping[str, Any]) -> str:
    """Return the largest change of a value against the run's own results.

    row: Row of a run that is done.
    Returns: In units of the standard uncertainty that the run stated.
    """
    before = row["before"]
    if before is None:
        return "no earlier results to compare"
    changes = {
        name: abs(value - before["values"][name]) / before["sigma"][name]
        for name, value in row["values"].items()
        if before["sigma"].get(name)
    }
    if not changes:
        return "no earlier results to compare"
    name = max(changes, key=lambda one: changes[one])
    if changes[name] < _ROUNDING_SIGMA:
        return "all values as in the run"
    return f"largest change since the run: {name} by {changes[name]:.2g} sigma"


class CountedProgress(LiveLine):
    """Shows how far a recalculation is."""

    def counted(self, counts: Counts, left_s: float | None) -> None:
        """Show the counts, if it is time.

        left_s: Expected time to the end, s; None if unknown.
        """
        if not self.due():
            return
        left = "" if left_s is None else f", {clock_text(left_s)} left"
        failed = f", {counts.failed} failed" if counts.failed else ""
        self.show(f"{counts.ended} of {counts.runs} runs{failed}, {counts.recordings} recordings{left}")


def sum_text(counts: Counts) -> str:
    """Return how a recalculation ended.

    counts: Its counts.
    """
    parts = [f"{counts.done} of {counts.runs} runs calibrated"]
    if counts.skipped:
        parts.append(f"{counts.skipped} were done before")
    if counts.failed:
        parts.append(f"{counts.failed} FAILED")
    missing = counts.runs - counts.ended
    if missing:
        parts.append(f"{missing} not done")
    kept = f", {counts.kept} of them with kept views" if counts.kept else ""
    return f"{'; '.join(parts)} ({counts.recordings} recordings{kept})."
