"""Print a plan: steps, times, sizes, and the uncertainty that its poses will reach; in words or as JSON."""

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
    """Show a plan, what its poses will be worth, and further poses where asked for; return the exit status."""
    worth = None if planned.faults else expected_uncertainty(planned)
    further = suggest_poses(planned, suggest) if suggest and not planned.faults else []
    if as_json:
        print_json({**planned.to_dict(), "expected": _worth_dict(worth), "suggested": further})
    else:
        click.echo(render_plan(planned))
        if worth is not None:
            click.echo(_worth_text(worth))
        for pose in further:
            angles = ", ".join(f"{name}: {angle:g}" for name, angle in pose.items())
            click.echo(f"Suggested: {{{angles}}}")
    return 2 if planned.faults else 0


def _worth_dict(worth: Forecast | None) -> dict[str, Any] | None:
    if worth is None:
        return None
    return {"sigma": dict(worth.sigma), "worst_px": worth.projection_map.worst_px, "stars": list(worth.stars)}


def _worth_text(worth: Forecast) -> str:
    shown = ("fx", "cx", "cy", "r")
    sigmas = ", ".join(f"{name} {worth.sigma[name]:.2g}" for name in shown if name in worth.sigma)
    return (
        f"Expected, 1 sigma: {sigmas}; a direction anywhere on the sensor to {worth.projection_map.worst_px:.2g} px"
        f" ({worth.projection_map.worst_arcsec:.2g} arcsec)."
    )
