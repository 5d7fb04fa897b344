"""What the engine's commands print: comparisons, passports, rigs, studies; in words or as JSON."""

from __future__ import annotations

from collections.abc import Sequence

import click

from bench.commands.calibration_output import unit_text
from bench.commands.output import print_json
from bench.report.text import with_uncertainty
from calib.model.passport import Passport
from calib.studies.monte_carlo import MonteCarloStudy
from calib.studies.rig import RelativeRotation


def show_passport(passport: Passport, *, as_json: bool) -> int:
    """Show what a passport says."""
    if as_json:
        print_json(passport.to_dict())
        return 0
    for name, value, variance in zip(
        passport.names, passport.values, passport.covariance.diagonal(), strict=True
    ):
        told, expanded = with_uncertainty(float(value), 2.0 * float(variance) ** 0.5)
        click.echo(f"  {name:<8} {told:>12} ± {expanded:<8} {unit_text(name):<3} (k = 2)")
    for name, condition in passport.conditions.items():
        click.echo(f"  {name}: {', '.join(condition) if isinstance(condition, list) else condition}")
    if passport.views:
        click.echo(f"  from {len(passport.views)} views: {', '.join(passport.views)}")
        click.echo(f"  they differed by {passport.birge_ratio:.1f} times their stars' noise")
    return 0


def show_rig(turn: RelativeRotation, skipped: Sequence[str], *, as_json: bool) -> int:
    """Show the turn from one camera of a rig to the other."""
    if as_json:
        print_json({**turn.to_dict(), "skipped": list(skipped)})
        return 0
    for reason in skipped:
        click.echo(f"Left out: {reason}")
    click.echo(f"Second camera <- first camera, by {len(turn.views)} poses that both saw:")
    for axis, angle, sigma in zip("xyz", turn.vector_deg, turn.sigma_arcsec, strict=True):
        told, expanded = with_uncertainty(3600.0 * float(angle), 2.0 * float(sigma))
        click.echo(f"  rotation vector {axis} {angle:>12.6f} deg = {told} ± {expanded} arcsec (k = 2)")
    for row in turn.rotation:
        click.echo("  [" + " ".join(f"{number:>13.9f}" for number in row) + "]")
    for view, off in zip(turn.views, turn.residuals_arcsec, strict=True):
        click.echo(f"  {view}: off by {' '.join(f'{axis:.1f}' for axis in off)} arcsec")
    verdict = (
        "the rig is rigid" if turn.rigid else "THE RIG FLEXED, or the cameras did not see the same poses"
    )
    click.echo(
        f"Chi-square {turn.chi_square:.1f} for {turn.degrees_of_freedom} degrees of freedom: {verdict}."
    )
    click.echo("How far apart the cameras are cannot be seen through a collimator: no translation is given.")
    return 0


def show_study(study: MonteCarloStudy, *, as_json: bool) -> int:
    """Show what repeated calibrations showed."""
    low, high = study.coverage_band
    held = all(low <= share <= high for share in study.coverage.values())
    if as_json:
        facts = {"runs": len(study.values), "failed": list(study.failed), "held": held, "band": [low, high]}
        print_json({**facts, "scatter": study.scatter, "z_rms": study.z_rms, "coverage": study.coverage})
        return 0
    click.echo(f"{len(study.values)} calibrations, {len(study.failed)} failed.")
    for at, name in enumerate(study.names):
        click.echo(
            f"  {name:<3} error {study.scatter[name]:>9.4g} rms, stated {float(study.sigmas[:, at].mean()):>9.4g},"
            f" ratio {study.z_rms[name]:.2f}; within U {study.coverage[name]:.1%}"
        )
    verdict = "they hold" if held else "THEY DO NOT HOLD"
    click.echo(f"Errors lie within a true U (k = 2, or more) {low:.1%} to {high:.1%} of the time: {verdict}.")
    return 0
