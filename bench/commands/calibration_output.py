"""Print runs and calibrations: values with uncertainties first, then the reprojection error, then other methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from bench.commands.output import STOPPED, error_object, print_json
from bench.records.captures import CAPTURES

if TYPE_CHECKING:
    from bench.records.results import CalibrationData, Results
    from bench.report.target_words import TargetWords
    from bench.results.offline import OfflineResult
    from bench.run.runner import RunEnd
    from calib.studies.reference_methods import MethodFailure, MethodResult

_MOST_LISTED = 20
"""Recordings that are listed by name."""


def show_run(end: RunEnd, *, as_json: bool) -> int:
    """Print how a run ended.

    as_json: Whether to print JSON.
    Returns: Exit status: 0 finished, 3 stopped on request, 1 failed.
    """
    status = {"finished": 0, "aborted": STOPPED}.get(end.how, 1)
    report = str(end.outcome.report) if end.outcome else None
    if as_json:
        facts = {
            "ended": end.how,
            "why": end.why,
            "unsafe": list(end.unsafe),
            "devices": [one.to_dict() for one in end.devices],
            "folder": str(end.folder),
            "report": report,
            "error": error_object(end.failure) if end.failure is not None else None,
        }
        results: Mapping[str, Any] = end.outcome.results if end.outcome else {}
        print_json({**facts, **dict(results.get("calibration", {})), "results": dict(results) or None})
        return status
    if end.how == "finished" and end.outcome is None:
        for line in _recorded_lines(end):
            click.echo(line)
        return status
    if end.outcome is None:
        for line in _early_end_lines(end):
            click.echo(line, err=True)
        return status
    click.echo(_run_text(end.outcome.results))
    click.echo(f"Report: {report}")
    return status


def _early_end_lines(end: RunEnd) -> list[str]:
    """Return why a run ended early, what is known of the bench, and how to continue."""
    lines = [f"The run {'was aborted' if end.how == 'aborted' else 'failed'}: {end.why}"]
    return [
        *lines,
        *_device_lines(end),
        "All recordings are kept. To continue:",
        f"  starbench resume {end.folder}",
    ]


def _device_lines(end: RunEnd) -> list[str]:
    """Return what is known of each device; nothing is said that no device has answered."""
    if all(one.state == "never opened" for one in end.devices):
        return [
            "No device was opened: this run moved nothing and switched nothing.",
            "Whether the light is on and the stage is still is not known: look at the bench.",
        ]
    unsure = [one for one in end.devices if one.state != "confirmed safe"]
    if end.devices and not unsure:
        head = "The bench is safe; each device confirmed it:"
    elif end.devices and all(one.device == "camera" for one in unsure):
        head = "Stage and light confirmed that they are safe:"  # a camera neither moves nor shines
    else:
        head = "CHECK THE BENCH. What is known of each device:"
    return [head, *(f"  {one.text}" for one in end.devices)]


def _recorded_lines(end: RunEnd) -> list[str]:
    """Return what a run without results has: its recordings, and what can be done with them."""
    recordings = sorted(
        path.relative_to(end.folder).as_posix() for path in (end.folder / CAPTURES).glob("pose-*")
    )
    lines = ["The run is finished and sealed. Its sequence has no report step, so there is no result."]
    lines.append(f"Folder: {end.folder}")
    if not recordings:
        return [*lines, "It has no recording."]
    shown = recordings[:_MOST_LISTED]
    lines.append(f"Recordings ({len(recordings)}):")
    lines += [f"  {name}" for name in shown]
    if len(recordings) > len(shown):
        lines.append(f"  and {len(recordings) - len(shown)} more")
    lines.append("To check the seal, and to calibrate from the recordings:")
    return [
        *lines,
        f"  starbench verify {end.folder}",
        f"  starbench calibrate {end.folder} --output NEW_FOLDER",
    ]


def print_calibration(
    result: OfflineResult, baselines: list[MethodResult | MethodFailure] | None, *, as_json: bool
) -> None:
    """Print a calibration made without devices, and other methods on the same points if there are any.

    baselines: Results of other methods; None if no comparison was asked for.
    as_json: Whether to print JSON.
    """
    if as_json:
        facts = result.to_dict()
        if baselines is not None:
            facts["compared"] = [baseline_dict(row) for row in baselines]
        print_json(facts)
        return
    for line in result.skipped:
        click.echo(f"left out: {line}", err=True)
    from bench.report.target_words import words_for

    words = words_for(result.board)
    click.echo(calibration_text(result.calibration.to_dict(), words))
    if baselines is not None:
        click.echo("\n" + comparison_text(baselines))
        if words.is_board:
            click.echo("The published recipe is left out: it needs a target at infinity, not a board.")
    elif result.planar is not None:
        click.echo("\n" + _planar_text(result.planar.to_dict()))


def _run_text(results: Results) -> str:
    from bench.report.target_words import words_of

    lines = [calibration_text(results["calibration"], words_of(results))]
    if results["comparison"]:
        lines += ["", "SIMULATED devices. Distance from the simulated truth:"]
        lines += [_distance_text(row) for row in results["comparison"]]
    lines += [f"Deviation: {what}" for what in results["deviations"]]
    return "\n".join([*lines, ""])


def _distance_text(row: Mapping[str, Any]) -> str:
    """Return how far a value lies from the truth, to the digits of its uncertainty."""
    from bench.report.text import fixed, with_uncertainty

    error, _ = with_uncertainty(row["error"], 2 * row["sigma"])
    sigmas = fixed(row["error_sigmas"], 2)
    return f"  {row['name']:<3} {error:>12} {unit_text(row['name']):<3} = {sigmas:>5} sigma"


def calibration_text(calibration: CalibrationData, words: TargetWords) -> str:
    """Return a calibration as text: values with uncertainties first, reprojection error second.

    calibration: Calibration as `results.json` holds it.
    """
    from bench.report.calibration_tables import coverage_factor
    from bench.report.text import exact, with_uncertainty

    values = {**calibration["camera"], **(calibration["collimator"] or {})}
    views = calibration["views"]
    points = sum(view["n"] for view in views)
    k = coverage_factor(calibration)
    model = calibration["model"].capitalize()
    counted = f"{len(views)} view{'' if len(views) == 1 else 's'}"
    lines = [f"{model} model, {counted}, {points} {words.points}; U with k = {exact(round(k, 2))}:"]
    for name, sigma in calibration["sigma"].items():
        value, expanded = with_uncertainty(values[name], k * sigma)
        lines.append(f"  {name:<3} {value:>12} ± {expanded:<8} {unit_text(name)}".rstrip())
    lines.append(
        f"Reprojection error: rms {calibration['rms_px']:.4f} px, mean {calibration['mean_px']:.4f} px"
        f" (how well the model fits the {words.points}; this is not the accuracy)."
    )
    if not calibration["converged"]:
        lines.append("NOT CONVERGED: do not use these numbers.")
    return "\n".join([*lines, *(f"Note: {note}" for note in calibration["notes"])])


def _planar_text(calibration: CalibrationData) -> str:
    """Return the planar calibration in a few lines, without its notes: it is not the result."""
    from bench.report.calibration_tables import coverage_factor
    from bench.report.text import with_uncertainty

    k = coverage_factor(calibration)
    shown = []
    for name in ("fx", "fy", "cx", "cy"):
        value, expanded = with_uncertainty(calibration["camera"][name], k * calibration["sigma"][name])
        shown.append(f"{name} {value} ± {expanded} px")
    return (
        "Only for comparison, not the result: the planar model (Zhang) on the same stars. It does not know that a\n"
        "collimator stands between them and the camera.\n"
        f"  {', '.join(shown)}; rms {calibration['rms_px']:.4f} px"
    )


def unit_text(name: str) -> str:
    """Return the unit of a parameter, as it is printed after a number.

    Returns: The unit; empty for a number without unit.
    """
    from bench.report.text import unit_of

    unit = unit_of(name)
    return "" if unit == "1" else unit


def baseline_dict(row: MethodResult | MethodFailure) -> dict[str, Any]:
    """Return the result of one method for JSON output, or why it has none."""
    from calib.studies.reference_methods import MethodFailure

    if isinstance(row, MethodFailure):
        return {"name": row.name, "failed": row.why}
    return {
        "name": row.name,
        "camera": row.camera.to_dict(),
        "sigma": dict(row.sigma),
        "rms_px": row.rms_px,
        "mean_px": row.mean_px,
        "left_out_rms_px": row.left_out_rms_px,
    }


def comparison_text(baselines: list[MethodResult | MethodFailure]) -> str:
    """Return the results of several methods on the same points as a table."""
    from calib.studies.reference_methods import MethodFailure

    head = f"  {'':<34}{'fx':>10}{'U(fx)':>9}{'cx':>10}{'cy':>10}{'rms px':>9}{'left out':>10}"
    lines = ["On the same points:", head]
    for row in baselines:
        if isinstance(row, MethodFailure):
            lines.append(f"  {row.name:<34}no result: {row.why}")
            continue
        left_out = f"{row.left_out_rms_px:.4f}" if row.left_out_rms_px is not None else "-"
        stated = f"{2 * row.sigma['fx']:.2f}" if "fx" in row.sigma else "-"
        lines.append(
            f"  {row.name:<34}{row.camera.fx:>10.2f}{stated:>9}{row.camera.cx:>10.2f}"
            f"{row.camera.cy:>10.2f}{row.rms_px:>9.4f}{left_out:>10}"
        )
    lines.append(
        "U(fx): 2 times the sigma that the method states (k = 2). left out: rms of views that were not used, with"
        " only their rotation solved."
    )
    return "\n".join(lines)
