"""Output of the calibration engine's commands: passports, rigs, studies; text for people, JSON for programs."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import click

from bench.commands.calibration_output import unit_text
from bench.commands.output import print_json
from bench.evidence.passport_seal import read_passport_seal
from bench.report.text import with_uncertainty
from calib.model.passport import Passport
from calib.studies.monte_carlo import MonteCarloStudy
from calib.studies.rig import RelativeRotation


def show_passport(passport: Passport, data: bytes, *, as_json: bool) -> int:
    """Print the values of a passport with their uncertainties, the hash of its file and its seal.

    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
    seal, sha256 = read_passport_seal(data), hashlib.sha256(data).hexdigest()
    if as_json:
        print_json({**passport.to_dict(), "sha256": sha256, "sealed_by": seal.fingerprint if seal else None})
        return 0
    for name, value, variance in zip(
        passport.names, passport.values, passport.covariance.diagonal(), strict=True
    ):
        text, expanded = with_uncertainty(float(value), 2.0 * float(variance) ** 0.5)
        click.echo(f"  {name:<8} {text:>12} ± {expanded:<8} {unit_text(name):<3} (k = 2)")
    for name, condition in passport.conditions.items():
        click.echo(f"  {name}: {_condition_text(condition)}")
    if passport.views:
        click.echo(f"  from {len(passport.views)} views: {', '.join(passport.views)}")
        click.echo(f"  the views differ by {passport.birge_ratio:.1f} times the noise of their stars")
    click.echo(f"  SHA-256: {sha256}")
    click.echo(f"  sealed by: {seal.fingerprint if seal else 'nobody (unsealed)'}")
    return 0


def _condition_text(condition: object) -> str:
    if isinstance(condition, dict):
        return ", ".join(f"{name} {value}" for name, value in condition.items())
    return ", ".join(map(str, condition)) if isinstance(condition, list) else str(condition)


def show_rig(rotation: RelativeRotation, skipped: Sequence[str], *, as_json: bool) -> int:
    """Print the rotation from one camera of a rig to the other.

    rotation: Rotation from the first camera to the second.
    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
    if as_json:
        print_json({**rotation.to_dict(), "skipped": list(skipped)})
        return 0
    for reason in skipped:
        click.echo(f"Left out: {reason}")
    click.echo(f"Second camera <- first camera, by {len(rotation.views)} poses that both cameras saw:")
    for axis, angle, sigma in zip("xyz", rotation.vector_deg, rotation.sigma_arcsec, strict=True):
        text, expanded = with_uncertainty(3600.0 * float(angle), 2.0 * float(sigma))
        click.echo(f"  rotation vector {axis} {angle:>12.6f} deg = {text} ± {expanded} arcsec (k = 2)")
    for row in rotation.rotation:
        click.echo("  [" + " ".join(f"{number:>13.9f}" for number in row) + "]")
    for view, residual in zip(rotation.views, rotation.residuals_arcsec, strict=True):
        click.echo(f"  {view}: residual {' '.join(f'{axis:.1f}' for axis in residual)} arcsec")
    verdict = (
        "the views agree with a rigid rig"
        if rotation.rigid
        else "THE RIG IS NOT RIGID, or the cameras did not see the same poses"
    )
    click.echo(
        f"Chi-square {rotation.chi_square:.1f} for {rotation.degrees_of_freedom} degrees of freedom: {verdict}."
    )
    click.echo(
        "The distance between the cameras cannot be measured through a collimator: no translation is given."
    )
    return 0


def show_study(study: MonteCarloStudy, *, as_json: bool) -> int:
    """Print what repeated simulated calibrations found.

    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
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
    verdict = (
        "no contradiction to the stated uncertainties found"
        if held
        else "THE STATED UNCERTAINTIES DO NOT HOLD"
    )
    click.echo(
        f"A correct U (k = 2, or more) covers the error in {low:.1%} to {high:.1%} of calibrations: {verdict}."
    )
    return 0
