"""The options that say how to calibrate, for the commands that calibrate without devices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from bench.base.encoding import counted
from bench.commands.options import STATION_NAME, together
from bench.commands.output import print_line
from bench.wording.conformity import conformity_headline, conformity_sentences
from bench.wording.numbers import exact, with_uncertainty
from bench.wording.parameters import unit_text
from bench.wording.target_words import TargetWords, words_for

if TYPE_CHECKING:
    from pathlib import Path

    from bench.camera_files.camera_values import LensFamily
    from bench.camera_files.reader import CameraFile
    from bench.solve.offline import OfflineResult
    from calib.calibration import Calibration


LENS = click.option(
    "--lens",
    type=click.Choice(["brown", "fisheye"]),
    help="What the coefficients of a file that names no lens model are: k1 k2 p1 p2 ..., or those of a fisheye.",
)
CAMERA = click.option(
    "--camera", metavar="NAME", help="Camera of a calibration file that holds several, such as cam1."
)
_CUTOFF_HZ = (0.01, 1000.0)  # As `calib.events.reconstruction.CUTOFF_RANGE_HZ`, whose import takes long

_THROUGH_COLLIMATOR = ("distortion", "passport", "image-size", "views", "origin", "station")
"""Options of commands that take all others from the runs."""


def stated_camera(
    file: Path, name: str | None, lens: LensFamily | None, image_size: tuple[int, int] | None
) -> CameraFile:
    """Read the camera of a calibration file, and print what is remarkable about it."""
    from bench.camera_files.reader import read_camera_file

    camera_file = read_camera_file(file, name, lens, image_size)
    for remark in camera_file.remarks:
        print_line(f"{file}: {remark}", err=True)
    return camera_file


def offline_lines(result: OfflineResult) -> Iterator[str]:
    """Return a calibration made without devices as text."""
    if judged := result.conformity:
        yield conformity_headline(judged)
        yield from (f"  {sentence}" for sentence in conformity_sentences(judged))
    yield from calibration_lines(result.calibration, words_for(result.board))


def calibration_lines(calibration: Calibration, words: TargetWords) -> list[str]:
    """Return a calibration as text: values with uncertainties first, reprojection error second."""
    points = sum(view.n for view in calibration.views)
    own = calibration.coverage_factors
    model = calibration.model.capitalize()
    counted_views = counted(len(calibration.views), "view")
    factors = "the k of each value" if own else f"k = {exact(round(calibration.coverage_factor, 2))}"
    lines = [f"{model} model, {counted_views}, {points} {words.points}; U with {factors}:"]
    width = max(map(len, calibration.values))
    for name, stated in calibration.values.items():
        value, expanded = with_uncertainty(stated, calibration.U[name])
        unit = f"{unit_text(name):<3} (k = {calibration.k[name]:.2f})" if own else unit_text(name)
        lines.append(f"  {name:<{width}} {value:>12} ± {expanded:<8} {unit}".rstrip())
    lines.append(
        f"Reprojection error: rms {calibration.rms_px:.4f} px, mean {calibration.mean_px:.4f} px"
        f" (how well the model fits the {words.points}; this is not the accuracy)."
    )
    if not calibration.converged:
        lines.append("NOT CONVERGED: do not use these numbers.")
    return [*lines, *(f"Note: {note}" for note in calibration.notes)]


class _CutoffFrequency(click.ParamType):
    """Cutoff frequency of the filter that reconstructs pictures, Hz."""

    name = "hz"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """See `click.ParamType.convert`. The value may be a path that follows the option."""
        try:
            frequency_hz = float(value)
        except ValueError:
            frequency_hz = 0.0
        if not _CUTOFF_HZ[0] <= frequency_hz <= _CUTOFF_HZ[1]:  # nan too
            self.fail(
                f"{value!r} is not a frequency of {_CUTOFF_HZ[0]:g} to {_CUTOFF_HZ[1]:g} Hz. "
                "Put --reconstruct after the paths, or write a number: --reconstruct 10.",
                param,
                ctx,
            )
        return frequency_hz


_OPTIONS = {
    "model": click.option(
        "--model",
        type=click.Choice(["joint", "spherical", "planar"]),
        help="joint: the joint adjustment. spherical (of the paper), planar (Zhang's): for comparison.  [default: as"
        " in the run; else joint]",
    ),
    "distortion": click.option(
        "--distortion",
        help="Distortion coefficients, e.g. k1k2k3p1p2, none or auto.  [default: as in the run; else k1k2, or"
        " k1k2p1p2 with a board]",
    ),
    "passport": click.option(
        "--passport",
        metavar="FILE",
        help="Passport of the collimator, or none.  [default: that of the run, if it has one]",
    ),
    "image-size": click.option(
        "--image-size",
        metavar="WxH",
        help="Image size, for point files, and for event files and calibrations that do not state it.",
    ),
    "views": click.option("--views", metavar="1,5,9", help="Use only these views. The first one is 1."),
    "origin": click.option(
        "--origin",
        type=click.Choice(["corner", "centre", "matlab"]),
        default="corner",
        show_default=True,
        help="Position of (0, 0) in point files: corner or centre of the first pixel; with matlab, that is (1, 1).",
    ),
    "station": click.option(
        "--station",
        "-s",
        type=STATION_NAME,
        help="Station file that states target and collimator, for files that are of no run.",
    ),
    "board": click.option(
        "--board",
        metavar="KIND:CxR:PITCHmm",
        help="The target is a board at finite distance, not the star target: checkerboard:11x7:20mm (inner corners), "
        "circles:9x6:25mm, asymmetric-circles:4x11:10mm. The planar model is used.",
    ),
    "reconstruct": click.option(
        "--reconstruct",
        "reconstruct_hz",
        type=_CutoffFrequency(),
        is_flag=False,
        flag_value="10",
        metavar="[HZ]",
        help="For a board that does not flicker, and a camera that moves: reconstruct pictures from the RAW files. HZ "
        "is the cutoff frequency of the high-pass filter: 10 if you give no number; use less for slower motion.",
    ),
}


engine_options = together(*_OPTIONS.values())
"""All options that say how to calibrate."""

BOARD, IMAGE_SIZE = _OPTIONS["board"], _OPTIONS["image-size"]
"""Options that single commands take."""

collimator_options = together(*(_OPTIONS[name] for name in _THROUGH_COLLIMATOR))
"""The options of a calibration through a collimator."""

rig_options = together(*(_OPTIONS[name] for name in ("distortion", "image-size", "origin", "station")))
"""The options of two cameras that are calibrated together."""
