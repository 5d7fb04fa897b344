"""The options that say how to calibrate, for the commands that calibrate without devices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from bench.commands.options import CheckedStation, Number

MODELS = ["auto", "joint", "spherical", "planar", "radial", "pupil", "rim", "field", "coma", "drift"]
MODEL_HELP = (
    "auto: the joint adjustment. spherical, planar: for comparison. Others: names of earlier versions."
)
LOSSES = ["l2", "huber", "cauchy"]
LOSS_HELP = "Loss function for outliers: l2 gives them full weight, huber less, cauchy least."
_Command = TypeVar("_Command", bound=Callable[..., Any])
_CUTOFF_HZ = (0.01, 1000.0)


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
        type=click.Choice(MODELS),
        help=f"{MODEL_HELP}  [default: as in the run; else auto]",
    ),
    "distortion": click.option(
        "--distortion",
        help="Distortion coefficients, e.g. k1k2k3p1p2, none or auto.  [default: as in the run; else k1k2]",
    ),
    "loss": click.option(
        "--loss",
        type=click.Choice(LOSSES),
        help=f"{LOSS_HELP}  [default: as in the run; else huber]",
    ),
    "guard-band": click.option(
        "--guard-band",
        type=Number(least=0, above=True, most=1),
        metavar="SHARE",
        help="Use only stars within this share of the beam's radius: above 0, at most 1.  [default: as in the run; "
        "else 1]",
    ),
    "passport": click.option(
        "--passport",
        metavar="FILE",
        help="Passport of the collimator, or none.  [default: that of the run, if it has one]",
    ),
    "readings": click.option(
        "--readings",
        type=click.Choice(["auto", "witness"]),
        help="Gimbal readings of a run. auto: they enter the adjustment, if the station states their uncertainty; "
        "witness: they are only compared with the result.  [default: as in the run]",
    ),
    "image-size": click.option(
        "--image-size", metavar="WxH", help="Image size for point files, which do not state it."
    ),
    "views": click.option("--views", metavar="1,5,9", help="Use only these views. The first one is 1."),
    "image": click.option(
        "--image",
        default="auto",
        show_default=True,
        help="Kind of event image for RAW files (docs/sequences.md).",
    ),
    "origin": click.option(
        "--origin",
        type=click.Choice(["corner", "centre"]),
        default="corner",
        show_default=True,
        help="Position of (0, 0) in point files: corner or centre of the first pixel.",
    ),
    "station": click.option(
        "--station",
        "-s",
        type=CheckedStation(),
        help="Station file that describes the target, if it is not the standard target.",
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
    "pictures-at": click.option(
        "--pictures-at",
        metavar="0.5,1,1.5",
        help="Times of the reconstructed pictures, in seconds after the first event.  [default: at most 40 pictures, "
        "evenly spread]",
    ),
}
_THROUGH_COLLIMATOR = ("model", "distortion", "passport", "image-size", "views", "origin", "station")
"""Options of commands that take all others from the runs."""


def engine_options(command: _Command) -> _Command:
    """Add all options that say how to calibrate to a command."""
    for option in reversed(_OPTIONS.values()):
        command = option(command)
    return command


def collimator_options(command: _Command) -> _Command:
    """Add the options of a calibration through a collimator to a command."""
    for name in reversed(_THROUGH_COLLIMATOR):
        command = _OPTIONS[name](command)
    return command
