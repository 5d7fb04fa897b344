"""Commands of the engine, which need no devices: calibrate again, rigs of two cameras, passports, studies.

Knows words and exits, like `bench.commands.cli`; the work stands in the modules it calls.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from bench.commands.options import JSON, SEED, ExistingFile, ExistingPath, NewFile, Number

_Command = TypeVar("_Command", bound=Callable[..., Any])
_MODELS = ["spherical", "pupil", "rim", "field", "coma", "drift", "planar", "auto"]
_LOSS = click.option(
    "--loss",
    type=click.Choice(["l2", "huber", "cauchy"]),
    default="huber",
    show_default=True,
    help="How little a star counts that lies far off: l2 in full, huber less, cauchy least.",
)
_MODEL = click.option(
    "--model",
    type=click.Choice(_MODELS),
    default="spherical",
    show_default=True,
    help="How far the collimator's imperfections are followed (docs/calibration.md).",
)


class _Station(click.ParamType):
    """A station file or the name of a shipped one, that can be read: also where what is calibrated brings its own."""

    name = "text"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Give the word back once it names a station. Raises DocumentFaults."""
        del param, ctx
        from bench.stations.station import load_station

        load_station(value)
        return str(value)


_OPTIONS = (
    _MODEL,
    click.option(
        "--distortion", default="k1k2", show_default=True, help="Coefficients, e.g. k1k2k3p1p2, none."
    ),
    _LOSS,
    click.option(
        "--guard-band",
        type=Number(least=0, above=True, most=1),
        metavar="SHARE",
        default=1.0,
        show_default=True,
        help="Share of the beam's radius to use, above 0 to 1.",
    ),
    click.option("--passport", type=ExistingFile(), help="The collimator's, made by `passport make`."),
    click.option("--image-size", metavar="WxH", help="For point files, which do not know it."),
    click.option("--views", metavar="1,5,9", help="Use these only, counted from 1 in the order listed."),
    click.option("--image", default="auto", show_default=True, help="Kind of event image for RAW captures."),
    click.option(
        "--origin",
        type=click.Choice(["corner", "centre"]),
        default="corner",
        show_default=True,
        help="What (0, 0) is in point files: a pixel's corner or its centre.",
    ),
    click.option(
        "--station",
        "-s",
        type=_Station(),
        help="Station file that describes the target, where not the standard one.",
    ),
)


def _engine_options(command: _Command) -> _Command:
    """Give a command the words that say how to calibrate."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def _views_and_options(command: _Command) -> _Command:
    """Give a command the words that say which views, and how to calibrate from them."""
    command = _engine_options(command)
    paths = click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=ExistingPath())
    return paths(command)


@click.command()
@_views_and_options
@click.option("--compare", is_flag=True, help="Beside OpenCV's planar method and the published recipe.")
@JSON
def calibrate(paths: tuple[Path, ...], compare: bool, as_json: bool, **words: Any) -> int:
    """Calibrate again, without devices, from any PATH.

    A PATH is a run folder, a RAW capture, a photograph of the target, a file of points (columns x, y, X, Y, id),
    or a folder of such files.
    """
    from bench.commands.calibration_output import print_calibration
    from bench.results.offline import calibrate_paths, compare_methods
    from bench.results.offline_options import OfflineOptions

    choices = OfflineOptions.from_command_line(**words)
    result = calibrate_paths(paths, choices)
    print_calibration(result, compare_methods(result, choices) if compare else None, as_json=as_json)
    return 0


@click.command()
@click.argument("first", type=ExistingPath())
@click.argument("second", type=ExistingPath())
@_engine_options
@JSON
def rig(first: Path, second: Path, as_json: bool, **words: Any) -> int:
    """Turn from the camera of FIRST to that of SECOND: two cameras on one rig, behind one collimator.

    FIRST and SECOND are run folders, or folders of files, whose views of one name show one pose of the rig.
    """
    from bench.commands.engine_output import show_rig
    from bench.results.offline import calibrate_paths
    from bench.results.offline_options import OfflineOptions
    from calib.studies.rig import relative_rotation

    choices = OfflineOptions.from_command_line(**words)
    results = [calibrate_paths([path], choices) for path in (first, second)]
    turn = relative_rotation(*(result.calibration for result in results))
    skipped = [reason for result in results for reason in result.skipped]
    return show_rig(turn, skipped, as_json=as_json)


@click.group()
def passport() -> None:
    """Calibrate a collimator once, and any camera from it with one to three views."""


@passport.command("make")
@_views_and_options
@click.option("--output", "-o", required=True, type=NewFile(), help="The new passport file.")
@click.option("--collimator", help="Its serial number or name.")
@click.option(
    "--temperature", "temperature_c", type=Number(), metavar="C", help="Degrees Celsius at the collimator."
)
def passport_make(
    paths: tuple[Path, ...], output: Path, collimator: str | None, temperature_c: float | None, **words: Any
) -> int:
    """Make a collimator's passport from the views of any PATH."""
    from datetime import UTC, datetime

    from bench.commands.calibration_output import print_calibration
    from bench.results.offline import calibrate_paths
    from bench.results.offline_options import OfflineOptions
    from bench.results.passports import passport_from_calibration, write_passport

    result = calibrate_paths(paths, OfflineOptions.from_command_line(**words))
    made = passport_from_calibration(
        result.calibration,
        collimator=collimator,
        temperature_c=temperature_c,
        now=datetime.now(UTC),
        sources=[str(path) for path in paths],
    )
    write_passport(output, made)
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
    help="The collimator's focal length.",
)
@click.option(
    "--sigma",
    "sigma_mm",
    type=Number(least=0, above=True),
    metavar="MM",
    required=True,
    help="Its standard uncertainty (k = 1).",
)
@click.option("--number", required=True, help="Number of the certificate.")
@click.option("--date", "issued", help="The day it was issued, as it says.")
@click.option("--collimator", help="Its serial number or name.")
@click.option(
    "--temperature", "temperature_c", type=Number(), metavar="C", help="Degrees Celsius for which it holds."
)
@click.option("--output", "-o", required=True, type=NewFile(), help="The new passport file.")
def passport_certificate(r_mm: float, sigma_mm: float, output: Path, **certificate: Any) -> int:
    """Make a passport from a certificate of the collimator's focal length alone."""
    from datetime import UTC, datetime

    from bench.results.passports import passport_from_certificate, write_passport

    made = passport_from_certificate(r_mm, sigma_mm, now=datetime.now(UTC), **certificate)
    write_passport(output, made)
    click.echo(f"Passport: {output}")
    return 0


@passport.command("show")
@click.argument("path", type=ExistingFile())
@JSON
def passport_show(path: Path, as_json: bool) -> int:
    """Show what a passport says, and how sure it is."""
    from bench.commands.engine_output import show_passport
    from bench.results.passports import read_passport

    return show_passport(read_passport(path), as_json=as_json)


@click.command()
@click.argument("sequence", default="three_pose")
@click.option(
    "--station", "-s", default="simulated", show_default=True, help="Station with an expected section."
)
@click.option(
    "--runs",
    type=click.IntRange(2, 100_000),
    metavar="N",
    default=200,
    show_default=True,
    help="How many calibrations.",
)
@click.option("--seed", type=SEED, metavar="N", default=1, show_default=True, help="Of the noise.")
@click.option(
    "--noise-px",
    type=Number(least=0, above=True),
    metavar="PX",
    help="1 sigma of a star; by default what the station expects.",
)
@click.option(
    "--drift-mm",
    type=Number(least=0),
    metavar="MM",
    default=0.0,
    show_default=True,
    help="1 sigma of each view's own centre about the shared one.",
)
@click.option(
    "--outliers",
    type=Number(least=0, most=1),
    metavar="SHARE",
    default=0.0,
    show_default=True,
    help="Share of stars that are grossly wrong, 0 to 1.",
)
@_MODEL
@_LOSS
@click.option("--plot", type=NewFile(), help="Draw the errors, in sigmas, into an SVG file.")
@JSON
def study(sequence: str, station: str, plot: Path | None, as_json: bool, **words: Any) -> int:
    """Calibrate an imagined camera again and again: see whether stated uncertainties hold."""
    from bench.commands.engine_output import show_study
    from bench.results.studies import run_study, write_study_plot

    studied = run_study(sequence, station, **words)
    if plot is not None:
        write_study_plot(studied, plot)
    return show_study(studied, as_json=as_json)


@click.command()
@click.argument("source", type=ExistingFile())
@click.argument("output", type=NewFile())
@click.option(
    "--as",
    "kind",
    type=click.Choice(["raw", "metavision", "hdf5", "numpy"]),
    help="Kind of OUTPUT, where its name does not tell: .raw, .hdf5 (Metavision's, ECF), .h5 (plain), .npz.",
)
def convert(source: Path, output: Path, kind: str | None) -> int:
    """Convert a file of events, of any kind and told by what it holds, to a new file OUTPUT of another kind.

    RAW (EVT3), Metavision's HDF5 (ECF), plain HDF5 and NumPy's .npz. A RAW file that was converted says so in its
    header: it is no camera's own bytes.
    """
    from datetime import UTC, datetime

    from bench.base.errors import UsageError
    from bench.terminal.signals import reliable_interrupts
    from drivers.camera.formats import event_conversion

    kind = kind or event_conversion.kind_of_name(output)
    if kind is None:
        raise UsageError(
            "Its name does not tell what kind of file it shall be.",
            where=str(output),
            remedy="Let it end in .raw, .hdf5, .h5 or .npz, or say it by --as.",
        )
    with reliable_interrupts():
        written = event_conversion.convert(
            source,
            output,
            kind,  # type: ignore[arg-type]
            utc_now=lambda: datetime.now(UTC),
        )
    moved = f", {written.moved_events} with their predecessor's time" if written.moved_events else ""
    click.echo(f"{output}: {written.events} events{moved}, {written.triggers} triggers")
    if written.cut_off:
        click.echo(f"{source}: cut off in the middle of a word; all before it is there.", err=True)
    return 0


ENGINE_COMMANDS = (calibrate, rig, passport, study, convert)
