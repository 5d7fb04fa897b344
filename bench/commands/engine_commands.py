"""Commands of the calibration engine, which need no devices: rig, passport, study.

Arguments, options and exit statuses only, like `bench.commands.cli`; other modules do the work.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from bench.commands.options import (
    JSON,
    SEED,
    CutoffFrequency,
    ExistingFile,
    ExistingPath,
    NewFile,
    Number,
    OutputFolder,
)
from bench.commands.worker_options import open_workers, worker_options

if TYPE_CHECKING:
    from datetime import datetime

    from bench.evidence.keys import BenchKey

_Command = TypeVar("_Command", bound=Callable[..., Any])
_MODELS = ["spherical", "radial", "pupil", "rim", "field", "coma", "drift", "planar", "auto"]
_LOSSES = ["l2", "huber", "cauchy"]
_LOSS_HELP = "Loss function for outliers: l2 gives them full weight, huber less, cauchy least."
_MODEL_HELP = "Model of the collimator and its aberrations (docs/calibration.md)."


class _Station(click.ParamType):
    """A station file, or the name of a station that is included, that can be read."""

    name = "text"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the value after reading the station. Raises DocumentFaults."""
        del param, ctx
        from bench.stations.station import load_station

        load_station(value)
        return str(value)


_OPTIONS = (
    click.option(
        "--model",
        type=click.Choice(_MODELS),
        help=f"{_MODEL_HELP}  [default: as in the run; else auto]",
    ),
    click.option(
        "--distortion",
        help="Distortion coefficients, e.g. k1k2k3p1p2, none or auto.  [default: as in the run; else k1k2]",
    ),
    click.option(
        "--loss",
        type=click.Choice(_LOSSES),
        help=f"{_LOSS_HELP}  [default: as in the run; else huber]",
    ),
    click.option(
        "--guard-band",
        type=Number(least=0, above=True, most=1),
        metavar="SHARE",
        help="Use only stars within this share of the beam's radius: above 0, at most 1.  [default: as in the run; "
        "else 1]",
    ),
    click.option(
        "--passport",
        metavar="FILE",
        help="Passport of the collimator, or none.  [default: that of the run, if it has one]",
    ),
    click.option(
        "--readings",
        type=click.Choice(["auto", "witness"]),
        help="Gimbal readings of a run. auto: they enter the adjustment, if the station states their uncertainty; "
        "witness: they are only compared with the result.  [default: as in the run]",
    ),
    click.option("--image-size", metavar="WxH", help="Image size for point files, which do not state it."),
    click.option("--views", metavar="1,5,9", help="Use only these views. The first one is 1."),
    click.option(
        "--image",
        default="auto",
        show_default=True,
        help="Kind of event image for RAW files (docs/sequences.md).",
    ),
    click.option(
        "--origin",
        type=click.Choice(["corner", "centre"]),
        default="corner",
        show_default=True,
        help="Position of (0, 0) in point files: corner or centre of the first pixel.",
    ),
    click.option(
        "--station",
        "-s",
        type=_Station(),
        help="Station file that describes the target, if it is not the standard target.",
    ),
    click.option(
        "--board",
        metavar="KIND:CxR:PITCHmm",
        help="The target is a board at finite distance, not the star target: checkerboard:11x7:20mm (inner corners), "
        "circles:9x6:25mm, asymmetric-circles:4x11:10mm. The planar model is used.",
    ),
    click.option(
        "--reconstruct",
        "reconstruct_hz",
        type=CutoffFrequency(),
        is_flag=False,
        flag_value="10",
        metavar="[HZ]",
        help="For a board that does not flicker, and a camera that moves: reconstruct pictures from the RAW files. HZ "
        "is the cutoff frequency of the high-pass filter: 10 if you give no number; use less for slower motion.",
    ),
    click.option(
        "--pictures-at",
        metavar="0.5,1,1.5",
        help="Times of the reconstructed pictures, in seconds after the first event.  [default: at most 40 pictures, "
        "evenly spread]",
    ),
)


def engine_options(command: _Command) -> _Command:
    """Add the options that say how to calibrate to a command."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def views_and_options(command: _Command) -> _Command:
    """Add the argument that names the views, and the options that say how to calibrate, to a command."""
    command = engine_options(command)
    paths = click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=ExistingPath())
    return paths(command)


@click.command()
@click.argument("first", type=ExistingPath())
@click.argument("second", type=ExistingPath())
@engine_options
@JSON
def rig(first: Path, second: Path, as_json: bool, **options: Any) -> int:
    """Calculate the rotation from the camera of FIRST to the camera of SECOND on one rig, behind one collimator.

    FIRST and SECOND are run folders or folders of files. Views of the same name must show the same pose of the rig.
    """
    from bench.commands.engine_output import show_rig
    from bench.results.offline import calibrate_paths, require_common_views
    from bench.results.offline_options import OfflineOptions
    from calib.studies.rig import relative_rotation

    choices = OfflineOptions.from_command_line(**options)
    require_common_views(first, second, choices)
    results = [calibrate_paths([path], choices) for path in (first, second)]
    rotation = relative_rotation(*(result.calibration for result in results))
    skipped = [reason for result in results for reason in result.skipped]
    return show_rig(rotation, skipped, as_json=as_json)


@click.group()
def passport() -> None:
    """Calibrate a collimator once, then any camera with it from one to three views."""


@passport.command("make")
@views_and_options
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
    from datetime import UTC, datetime

    from bench.commands.calibration_output import print_calibration
    from bench.results.offline import calibrate_paths
    from bench.results.offline_options import OfflineOptions
    from bench.results.passports import passport_from_calibration, seals_of, write_passport

    key = _key()
    result = calibrate_paths(paths, OfflineOptions.from_command_line(**options))
    made = passport_from_calibration(
        result.calibration,
        collimator=collimator or result.collimator.serial,
        temperature_c=temperature_c if temperature_c is not None else result.collimator.temperature_c,
        now=datetime.now(UTC),
        sources=[str(path) for path in paths],
        seals=seals_of(paths),
    )
    write_passport(output, made, key)
    print_calibration(result, None, as_json=False)
    click.echo(f"Passport: {output}")
    return 0


@passport.command("certificate")
@click.option(
    "--radius",
    "r_mm",
    type=Number(least=0, above=True),
    metavar="MM",
    required=True,
    help="Focal length of the collimator, mm.",
)
@click.option(
    "--sigma",
    "sigma_mm",
    type=Number(least=0, above=True),
    metavar="MM",
    required=True,
    help="Standard uncertainty of the focal length (k = 1), mm.",
)
@click.option("--number", required=True, help="Number of the certificate.")
@click.option("--date", "issued", help="Date of issue, as written on the certificate.")
@click.option(
    "--valid-until",
    type=click.DateTime(["%Y-%m-%d"]),
    metavar="YEAR-MONTH-DAY",
    help="Last day on which the certificate is valid.",
)
@click.option("--collimator", help="Serial number or name of the collimator.")
@click.option(
    "--temperature",
    "temperature_c",
    type=Number(),
    metavar="C",
    help="Temperature for which the focal length holds, degrees Celsius.",
)
@click.option("--output", "-o", required=True, type=NewFile(), help="New passport file.")
def passport_certificate(
    r_mm: float, sigma_mm: float, output: Path, valid_until: datetime | None, **certificate: Any
) -> int:
    """Make a passport from a certificate that states only the collimator's focal length."""
    from datetime import UTC, datetime

    from bench.results.passports import passport_from_certificate, write_passport

    until = valid_until.date().isoformat() if valid_until else None
    made = passport_from_certificate(r_mm, sigma_mm, valid_until=until, now=datetime.now(UTC), **certificate)
    write_passport(output, made, _key())
    click.echo(f"Passport: {output}")
    return 0


def _key() -> BenchKey:
    """Return the bench's key, to seal a passport."""
    from datetime import UTC, datetime

    from bench.base.home import home_folder
    from bench.commands.evidence_output import ask_passphrase
    from bench.evidence.keys import usable_key

    return usable_key(home_folder(), datetime.now(UTC), ask_passphrase=ask_passphrase)


@passport.command("seal")
@click.argument("path", metavar="FILE", type=ExistingFile())
@click.option("--output", "-o", required=True, type=NewFile(), help="New, sealed passport file.")
def passport_seal(path: Path, output: Path) -> int:
    """Seal a passport FILE that has no seal, after you have compared its values with their source."""
    from bench.results.passports import seal_file

    fingerprint = seal_file(path, output, _key())
    click.echo(f"Passport: {output}, sealed by {fingerprint}")
    return 0


@passport.command("show")
@click.argument("path", type=ExistingFile())
@JSON
def passport_show(path: Path, as_json: bool) -> int:
    """Show the values of a passport, their uncertainties, its hash and its seal."""
    from bench.commands.engine_output import show_passport
    from bench.plan.passport_file import read_passport_file

    return show_passport(*read_passport_file(path), as_json=as_json)


@click.command()
@click.argument("sequence", default="three_pose")
@click.option(
    "--station",
    "-s",
    default="simulated",
    show_default=True,
    help="Station file with an `expected` section, or the name of a station that is included.",
)
@click.option(
    "--runs",
    type=click.IntRange(2, 100_000),
    metavar="N",
    default=200,
    show_default=True,
    help="Number of calibrations.",
)
@click.option(
    "--seed", type=SEED, metavar="N", default=1, show_default=True, help="Random seed of the noise."
)
@click.option(
    "--noise-px",
    type=Number(least=0, above=True),
    metavar="PX",
    help="Standard deviation of a star position, px.  [default: the station's expected value]",
)
@click.option(
    "--drift-mm",
    type=Number(least=0),
    metavar="MM",
    default=0.0,
    show_default=True,
    help="Standard deviation of each view's collimator centre about the common centre, mm.",
)
@click.option(
    "--outliers",
    type=Number(least=0, most=1),
    metavar="SHARE",
    default=0.0,
    show_default=True,
    help="Share of stars with gross errors, 0 to 1.",
)
@click.option("--model", type=click.Choice(_MODELS), default="spherical", show_default=True, help=_MODEL_HELP)
@click.option("--loss", type=click.Choice(_LOSSES), default="huber", show_default=True, help=_LOSS_HELP)
@click.option("--plot", type=NewFile(), help="Plot the errors, in units of their sigma, to an SVG file.")
@worker_options
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="Folder that keeps what is done. After an interruption, repeat the command with the same folder: it "
    "continues.",
)
@JSON
def study(
    sequence: str,
    station: str,
    plot: Path | None,
    output: Path | None,
    scheduler: str | None,
    workers: int | None,
    memory: int,
    runs: int,
    as_json: bool,
    **options: Any,
) -> int:
    """Calibrate a simulated camera many times, and check whether the stated uncertainties hold.

    The work is done on all processors of this computer or on the workers of a Dask scheduler, with the same result.
    """
    from bench.cluster.many_calibrations import BLOCK
    from bench.commands.engine_output import show_study
    from bench.commands.many_output import run_study
    from bench.results.studies import plan_study, write_study_plot

    planned = plan_study(sequence, station, **options)
    who = open_workers(scheduler, workers, memory, most=-(-runs // BLOCK))
    studied = run_study(planned, runs, who, output)
    if plot is not None:
        write_study_plot(studied, plot)
    return show_study(studied, as_json=as_json)


ENGINE_COMMANDS = (rig, passport, study)
