"""The command `rig`: how two cameras that saw the same poses stand to each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.errors import UsageError
from bench.commands.calibrations import BOARD, LENS, rig_options, stated_camera
from bench.commands.options import ExistingPath, OutputFolder, command
from bench.commands.output import JSON, left_out_lines, show, wants_json
from bench.commands.workers import views_line
from bench.wording.numbers import plus_minus

if TYPE_CHECKING:
    from bench.camera_files.camera_values import LensFamily
    from bench.extras.tools.rig_of_views import RigFound
    from calib.studies.clock_offset import ClockOffset
    from calib.studies.rig import Rig, RigDifference


@command(
    "starbench rig runs/left runs/right",
    "starbench rig runs/left runs/right --sync",
    "starbench rig left right --board checkerboard:11x7:20mm -o rig",
    "starbench rig left right --board checkerboard:11x7:20mm --stated rig/extrinsics.json",
    "starbench rig runs/left runs/right --boards left right --board checkerboard:11x7:20mm",
)
@click.argument("first", type=ExistingPath())
@click.argument("second", type=ExistingPath())
@click.option(
    "--boards",
    nargs=2,
    type=ExistingPath(),
    metavar="FIRST SECOND",
    help="Views of a board of both cameras, which give the translation; the other views are behind a collimator.",
)
@click.option(
    "--calibration",
    nargs=2,
    type=ExistingPath(),
    metavar="FIRST SECOND",
    help="The intrinsics of both cameras with their uncertainty, from other views, as `check` reads them.  "
    "[default: adjusted with the rig]",
)
@click.option(
    "--camera",
    nargs=2,
    metavar="FIRST SECOND",
    help="The cameras of calibration files that hold several, such as cam0 cam1.",
)
@LENS
@click.option(
    "--stated",
    type=ExistingPath(),
    metavar="FILE",
    help="An earlier rig.json, or the extrinsics.json of Metavision SDK 5: is it still right? Status 1 if not.",
)
@click.option(
    "--sync",
    is_flag=True,
    help="Also the offset of the cameras' clocks, from a sync signal at both trigger inputs; for RAW recordings.",
)
@BOARD
@click.option(
    "--output", "-o", type=OutputFolder(), help="New folder for files of Kalibr, ROS, OpenCV and Metavision."
)
@rig_options
@JSON
def rig(
    first: Path,
    second: Path,
    boards: tuple[Path, ...] | None,
    calibration: tuple[Path, ...] | None,
    camera: tuple[str, ...] | None,
    lens: LensFamily | None,
    stated: Path | None,
    sync: bool,
    output: Path | None,
    **options: Any,
) -> int:
    """Calculate rotation and translation from the camera of FIRST to the camera of SECOND on one rig.

    FIRST and SECOND are run folders or folders of files. Views of the same name must show the same pose of the rig.
    Behind a collimator they give the rotation, of a board the translation too.
    """
    from bench.extras.tools.rig_of_views import find_clocks, find_rig, read_rig_file, rig_exports
    from bench.record.storage import new_output, write_files
    from bench.solve.offline_options import OfflineOptions

    earlier = read_rig_file(stated) if stated else None
    choices = OfflineOptions.from_command_line(**options)
    pairs = [pair for pair in ((first, second), boards) if pair]
    names = camera or (None, None)
    with new_output(output) if output is not None else nullcontext() as part:
        clocks = find_clocks(pairs, choices) if sync else ()
        cameras = [
            stated_camera(file, name, lens, choices.image_size)
            for file, name in zip(calibration or (), names, strict=False)
        ]
        with views_line(quiet=wants_json()) as progress:
            rig_of_views = find_rig((first, second), boards or (), cameras, choices, progress)
        solved = replace(rig_of_views, clocks=clocks)
        if part is not None and solved.rig.translation_mm is None:
            raise UsageError(
                "These views give no translation, and the files hold one.",
                remedy="Add views of a board (--boards, --board), or leave out --output.",
            )
        content = solved.to_dict()
        if part is not None:
            write_files(part, rig_exports(solved.rig, content))
    if stated is None or earlier is None:
        show(lambda: content, _lines(solved))
        return 0
    off = solved.rig.compared(earlier.rotation, earlier.translation_mm, earlier.covariance)
    compared = {**asdict(off), "right": off.right, "has_covariance": earlier.covariance is not None}
    words = _comparison(off, str(stated), known=earlier.covariance is not None)
    show(lambda: {**content, "stated": compared}, chain(words, _lines(solved)))
    return 0 if off.right else 1


def _comparison(off: RigDifference, path: str, *, known: bool) -> Iterator[str]:
    """Return what a stated rig is worth. known: Whether it states an uncertainty."""
    moved = "" if off.mm is None else f" and {off.mm:.3f} mm"
    verdict = "RIGHT within U" if off.right else "NOT RIGHT"
    yield f"{path}: {verdict}. It differs by {off.arcsec:.1f} arcsec{moved}, {off.normalised:.2f} of U."
    if not known:
        yield "The file states no uncertainty: U is that of this measurement alone."


def _lines(solved: RigFound) -> Iterator[str]:
    rig = solved.rig
    yield from left_out_lines(solved.skipped)
    seen = [(rig.views, "poses behind the collimator"), (rig.boards, "boards")]
    by = " and ".join(f"{len(names)} {what}" for names, what in seen if names)
    if rig.half_turned:
        yield (
            f"The board looks the same after half a turn: the second camera had numbered {len(rig.half_turned)} of"
            f" {len(rig.boards)} boards from the other end. They were numbered anew."
        )
    yield f"Second camera <- first camera, by {by} that both cameras saw:"
    for axis, angle, sigma in zip("xyz", rig.vector_deg, rig.sigma_arcsec, strict=True):
        shown = plus_minus(3600.0 * float(angle), 2.0 * float(sigma), "arcsec")
        yield f"  rotation vector {axis} {angle:>12.6f} deg = {shown} (k = 2)"
    if rig.translation_mm is not None:
        for axis, length, sigma in zip("xyz", rig.translation_mm, rig.sigma_mm, strict=True):
            yield f"  translation {axis} {plus_minus(float(length), 2.0 * float(sigma), 'mm')} (k = 2)"
    for row in rig.rotation:
        yield "  [" + " ".join(f"{number:>13.9f}" for number in row) + "]"
    yield from _residual_lines(rig)
    yield from _clock_lines(solved.clocks)


def _clock_lines(clocks: Sequence[ClockOffset]) -> Iterator[str]:
    from calib.studies.clock_offset import common_rate

    if not clocks:
        return
    rate, sigma = common_rate(clocks)
    gain = plus_minus(rate, 2.0 * sigma, "parts in a million")
    yield f"Clock of the second camera: it gains {gain} (k = 2)."
    for compared in clocks:
        offset = plus_minus(compared.offset_us, 2.0 * compared.sigma_us, "us")
        yield (
            f"  {compared.name}: second - first = {offset} (k = 2) at {compared.at_us / 1e6:.3f} s of"
            f" the first clock, by {compared.edges} edges"
        )
    periods = [clock.period_us for clock in clocks if clock.period_us is not None]
    if periods:
        yield (
            f"The sync signal repeats every {min(periods):.0f} us: the offsets may differ by whole periods. The values"
            " nearest zero are given."
        )


def _residual_lines(rig: Rig) -> Iterator[str]:
    if rig.residuals_arcsec is not None:
        for view, residual in zip(rig.views, rig.residuals_arcsec, strict=True):
            yield f"  {view}: residual {' '.join(f'{axis:.1f}' for axis in residual)} arcsec"
        verdict = "the views agree with a rigid rig"
        if not rig.rigid:
            verdict = "THE RIG IS NOT RIGID, or the cameras did not see the same poses"
        yield f"Chi-square {rig.chi_square:.1f} for {rig.degrees_of_freedom} degrees of freedom: {verdict}."
    if rig.boards_rms_px is not None:
        for name, (first_px, other) in zip(rig.boards, rig.boards_rms_px, strict=True):
            yield f"  {name}: residual {first_px:.3f} px in the first camera, {other:.3f} px in the second"
    if rig.translation_mm is None:
        yield "The distance between the cameras cannot be measured through a collimator: no translation is given."
