"""Print a plan: steps, times, sizes and the expected uncertainty; text for people, JSON for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from bench.commands.output import print_json
from bench.plan.plan import Plan
from bench.plan.plan_text import render_plan
from bench.results.forecasts import expected_uncertainty, suggest_poses

if TYPE_CHECKING:
    from calib.studies.planning import Forecast


def show_plan(planned: Plan, *, suggest: int, as_json: bool) -> int:
    """Print a plan, its expected uncertainty, and suggested additional poses.

    Parameters
    ----------
    planned
        The plan.
    suggest
        How many additional poses to suggest.
    as_json
        Whether to print JSON.

    Returns
    -------
    int
        Exit status: 0, or 2 if the files have faults.
    """
    forecast = None if planned.faults else expected_uncertainty(planned)
    suggested = suggest_poses(planned, suggest) if suggest and not planned.faults else []
    if as_json:
        print_json({**planned.to_dict(), "expected": _forecast_dict(forecast), "suggested": suggested})
    else:
        click.echo(render_plan(planned))
        if forecast is not None:
            click.echo(_forecast_text(forecast))
        for pose in suggested:
            angles = ", ".join(f"{name}: {angle:g}" for name, angle in pose.items())
            click.echo(f"Suggested: {{{angles}}}")
    return 2 if planned.faults else 0


def _forecast_dict(forecast: Forecast | None) -> dict[str, Any] | None:
    if forecast is None:
        return None
    return {
        "sigma": dict(forecast.sigma),
        "worst_px": forecast.projection_map.worst_px,
        "stars": list(forecast.stars),
    }


def _forecast_text(forecast: Forecast) -> str:
    shown = ("fx", "cx", "cy", "r")
    sigmas = ", ".join(f"{name} {forecast.sigma[name]:.2g}" for name in shown if name in forecast.sigma)
    worst = forecast.projection_map
    return (
        f"Expected, 1 sigma: {sigmas}; direction anywhere on the sensor at most {worst.worst_px:.2g} px"
        f" ({worst.worst_arcsec:.2g} arcsec)."
    )
