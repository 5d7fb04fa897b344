"""The group `passport`: passports of collimators."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.home import home_folder
from bench.commands.calibrations import collimator_options, offline_lines
from bench.commands.options import ExistingFile, ExistingPath, Family, NewFile, epilog
from bench.commands.output import JSON, ask_passphrase, left_out_lines, print_line, show
from bench.commands.values import Number
from bench.commands.workers import views_line
from bench.evidence.keys import BenchKey, usable_key
from bench.wording.numbers import with_uncertainty
from bench.wording.parameters import unit_text

if TYPE_CHECKING:
    from calib.model.passport import Passport


@click.group(
    cls=Family,
    epilog=epilog(
        "starbench passport make runs/* -o collimator.json",
        "starbench calibrate runs/cam8 --passport collimator.json",
    ),
)
def passport() -> None:
    """Calibrate a collimator once, then any camera with it from one to three views."""


@passport.command(
    "make",
    epilog=epilog("starbench passport make runs/* -o collimator.json --collimator C-17"),
)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=ExistingPath())
@collimator_options
@click.option("--output", "-o", required=True, type=NewFile(), help="New passport file.")
@click.option(
    "--collimator", help="Serial number or name of the collimator.  [default: as in the run's station]"
)
@click.option(
    "--temperature",
    "temperature_c",
    type=Number(),
    metavar="C",
    help="Temperature of the collimator, degrees Celsius.  [default: as in the run's station]",
)
def passport_make(
    paths: tuple[Path, ...], output: Path, collimator: str | None, temperature_c: float | None, **options: Any
) -> int:
    """Make a collimator's passport from the views in one or more PATHs."""
    from bench.record.storage import new_output
    from bench.solve.offline import calibrate_paths
    from bench.solve.offline_options import OfflineOptions
    from bench.solve.passports import passport_from_calibration, sealed_bytes, seals_of

    with new_output(output) as part:
        key = _key()
        with views_line() as progress:
            result = calibrate_paths(paths, OfflineOptions.from_command_line(**options), progress=progress)
        made = passport_from_calibration(
            result.calibration,
            collimator=collimator or result.collimator.serial,
            temperature_c=temperature_c if temperature_c is not None else result.collimator.temperature_c,
            now=datetime.now(UTC),
            sources=[str(path) for path in paths],
            seals=seals_of(paths),
        )
        part.write_bytes(sealed_bytes(made, key))
    for line in left_out_lines(result.skipped):
        print_line(line, err=True)
    for line in (*offline_lines(result), f"Passport: {output}"):
        print_line(line)
    return 0


def _key() -> BenchKey:
    """Return the bench's key, to seal a passport."""
    return usable_key(home_folder(), datetime.now(UTC), ask_passphrase=ask_passphrase)


@passport.command(
    "show",
    epilog=epilog(
        "starbench passport show collimator.json",
        "starbench passport show collimator.json --seal collimator_sealed.json",
    ),
)
@click.argument("path", type=ExistingFile())
@click.option(
    "--seal",
    "sealed",
    type=NewFile(),
    help="Write a sealed copy of a file that has no seal; first compare its values with their source.",
)
@JSON
def passport_show(path: Path, sealed: Path | None) -> int:
    """Show the values of a passport, their uncertainties, its hash and its seal."""
    from bench.plan.passport_file import read_passport_file

    if sealed is not None:
        from bench.solve.passports import seal_file

        seal_file(path, sealed, _key())
        path = sealed
    own_passport, data, seal = read_passport_file(path)
    sha256, sealed_by = hashlib.sha256(data).hexdigest(), seal.fingerprint if seal else None
    show(
        lambda: {**own_passport.to_dict(), "sha256": sha256, "sealed_by": sealed_by},
        _lines(own_passport, sha256, sealed_by),
    )
    return 0


def _lines(own_passport: Passport, sha256: str, sealed_by: str | None) -> Iterator[str]:
    for name, value, variance in zip(
        own_passport.names, own_passport.values, own_passport.covariance.diagonal(), strict=True
    ):
        text, expanded = with_uncertainty(float(value), 2.0 * float(variance) ** 0.5)
        yield f"  {name:<8} {text:>12} ± {expanded:<8} {unit_text(name):<3} (k = 2)"
    for name, condition in own_passport.conditions.items():
        yield f"  {name}: {_condition_text(condition)}"
    if own_passport.views:
        yield f"  from {len(own_passport.views)} views: {', '.join(own_passport.views)}"
        yield f"  the views differ by {own_passport.birge_ratio:.1f} times the noise of their stars"
    yield f"  SHA-256: {sha256}"
    yield f"  sealed by: {sealed_by or 'nobody (unsealed)'}"


def _condition_text(condition: object) -> str:
    if isinstance(condition, dict):
        return ", ".join(f"{name} {value}" for name, value in condition.items())
    return ", ".join(map(str, condition)) if isinstance(condition, list) else str(condition)
