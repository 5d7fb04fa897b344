"""Print a plan: steps, times, sizes and the expected uncertainty; text for people, JSON for programs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from bench.commands.output import print_json
from bench.plan.plan import Plan
from bench.plan.plan_text import render_plan
from bench.report.verdict import angle_text
from calib.model.budget_row import WORST_CORNER, BudgetRow
from calib.uncertainty.projection_uncertainty import ARCSEC

if TYPE_CHECKING:
    from bench.results.forecasts import PlanForecast
    from bench.results.until_forecast import ExpectedCourse
    from calib.studies.planning import Forecast, SuggestedPose

_URAD_PER_ARCSEC = 1e6 / ARCSEC
_MOST_TERMS = 5
_SMALLEST_SHARE = 0.005
"""Terms with a smaller share of the variance are not printed."""


def show_plan(planned: Plan, *, suggest: int, as_json: bool) -> int:
    """Print a plan, its expected uncertainty, and suggested additional poses.

    as_json: Whether to print JSON.
    Returns: Exit status: 0, or 2 if the files have faults.
    """
    if planned.faults:  # the engine is not needed, and it takes a second to load
        _print_plan(planned, None, [], [], as_json=as_json)
        return 2
    from bench.results.forecasts import expected_uncertainty, suggest_poses

    found, courses = expected_uncertainty(planned), []
    if planned.most_poses > len(planned.poses):  # an `until` may choose poses
        from bench.results.until_forecast import expected_courses

        courses = expected_courses(planned)
    suggested = suggest_poses(planned, suggest) if suggest else []
    _print_plan(planned, found, courses, suggested, as_json=as_json)
    return 0


def _print_plan(
    planned: Plan,
    found: PlanForecast | None,
    courses: Sequence[ExpectedCourse],
    suggested: Sequence[SuggestedPose],
    *,
    as_json: bool,
) -> None:
    if as_json:
        poses = [
            {
                **pose.angles_deg,
                "worst_px": pose.worst_px if math.isfinite(pose.worst_px) else None,
                "rim_share": round(pose.rim_share, 3),
                "why": _why(pose),
            }
            for pose in suggested
        ]
        print_json(
            {
                **planned.to_dict(),
                "expected": _forecast_dict(found),
                "expected_untils": [course.to_dict() for course in courses],
                "suggested": poses,
            }
        )
        return
    click.echo(render_plan(planned))
    if found is not None:
        click.echo(f"\n{_forecast_text(found)}")
    for course in courses:
        click.echo(course.text)
    if suggested:
        from bench.results.forecasts import forecasts_with

        before = None if found is None or found.chosen else found.forecast
        for pose, forecast in zip(suggested, forecasts_with(planned, suggested), strict=True):
            click.echo(_suggestion_text(pose, before, forecast))
            before = forecast


def _forecast_dict(found: PlanForecast | None) -> dict[str, Any] | None:
    """Return a forecast for programs."""
    if found is None:
        return None
    forecast = found.forecast
    return {
        "model": forecast.model,
        "poses": found.poses,
        "chosen_in_run": found.chosen,
        "sigma": dict(forecast.sigma),
        "coverage_factor": forecast.coverage_factor,
        "expanded_fx_px": forecast.limited["expanded_fx"],
        "worst_corner_px": forecast.limited[WORST_CORNER],
        "worst_px": forecast.projection_map.worst_px,
        "stars": list(forecast.stars),
        "budget_rows": [row.to_dict() for row in forecast.budget_rows],
        "not_included": list(forecast.not_included),
        "remarks": list(found.remarks),
    }


def _forecast_text(found: PlanForecast) -> str:
    """Return a forecast for people: expanded uncertainties, the largest terms, and remarks."""
    forecast = found.forecast
    k = forecast.coverage_factor
    poses = f"{found.poses} poses" if found.poses != 1 else "1 pose"
    if found.chosen:
        poses = f"as many poses as allowed, {found.poses}"
    fx, corners = forecast.limited["expanded_fx"], forecast.limited[WORST_CORNER]
    direction = angle_text(_URAD_PER_ARCSEC * k * forecast.projection_map.worst_arcsec)
    lines = [
        f"Expected with {poses}, {forecast.model} model; U with k = {k:.3g}:",
        f"  U(fx) {fx:.2g} px, U at the corners {corners:.2g} px, U of a direction at most {direction}",
        f"  {'largest parts of U, px':<44}{'fx':>8}{'corners':>10}",
    ]
    for row in _largest(forecast.budget_rows):
        parts = [k * row.contribution.get(name, 0.0) for name in ("fx", WORST_CORNER)]
        lines.append(f"  {row.name:<44}{parts[0]:>8.2g}{parts[1]:>10.2g}")
    return "\n".join([*lines, *found.remarks])


def _largest(rows: Sequence[BudgetRow]) -> list[BudgetRow]:
    """Return the rows that matter for the focal length or at the corners, the largest first."""
    share = {row.name: max(row.share.get("fx", 0.0), row.share.get(WORST_CORNER, 0.0)) for row in rows}
    shown = sorted(rows, key=lambda row: -share[row.name])[:_MOST_TERMS]
    return [row for row in shown if share[row.name] >= _SMALLEST_SHARE]


def _suggestion_text(pose: SuggestedPose, before: Forecast | None, found: Forecast | None) -> str:
    """Return a suggested pose with the uncertainty that it is expected to give."""
    angles = ", ".join(f"{name}: {round(a, 3):g}" for name, a in pose.angles_deg.items())
    parts = [f"it {why}"] if (why := _rim_text(pose)) else []
    if found is None:
        parts.append("the poses do not determine the camera yet")
    else:
        for name, quantity in (("U(fx)", "expanded_fx"), ("U at the corners", WORST_CORNER)):
            instead = f" instead of {before.limited[quantity]:.2g} px" if before is not None else ""
            parts.append(f"{name} {found.limited[quantity]:.2g} px{instead}")
        parts[-1] += f" (k = {found.coverage_factor:.3g})"
    return f"Suggested: {{{angles}}}: {', '.join(parts)}"


def _rim_text(pose: SuggestedPose) -> str:
    if not pose.rim_reason:
        return ""
    return f"shows {100 * pose.rim_share:.0f} % of the rim of the beam, which {pose.rim_reason}"


def _why(pose: SuggestedPose) -> str:
    """Return why a pose is suggested, for programs."""
    if not math.isfinite(pose.worst_px):
        return _rim_text(pose) or "the poses do not determine the camera yet"
    worst = f"largest uncertainty on the sensor {pose.worst_px:.2g} px, 1 sigma"
    return f"{why}; {worst}" if (why := _rim_text(pose)) else worst
