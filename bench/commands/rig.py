"""The command `rig`: the rotation between two cameras that saw the same poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands.engine_options import collimator_options
from bench.commands.options import ExistingPath, epilog
from bench.commands.output import JSON, show
from bench.report.text import with_uncertainty

if TYPE_CHECKING:
    from calib.studies.rig import RelativeRotation


@click.command(epilog=epilog("starbench rig runs/left runs/right"))
@click.argument("first", type=ExistingPath())
@click.argument("second", type=ExistingPath())
@collimator_options
@JSON
def rig(first: Path, second: Path, **options: Any) -> int:
    """Calculate the rotation from the camera of FIRST to the camera of SECOND on one rig, behind one collimator.

    FIRST and SECOND are run folders or folders of files. Views of the same name must show the same pose of the rig.
    """
    from bench.results.offline import calibrate_paths, require_common_views
    from bench.results.offline_options import OfflineOptions
    from calib.studies.rig import relative_rotation

    choices = OfflineOptions.from_command_line(**options)
    require_common_views(first, second, choices)
    results = [calibrate_paths([path], choices) for path in (first, second)]
    rotation = relative_rotation(*(result.calibration for result in results))
    skipped = [reason for result in results for reason in result.skipped]
    show(lambda: {**rotation.to_dict(), "skipped": skipped}, _lines(rotation, skipped))
    return 0


def _lines(rotation: RelativeRotation, skipped: Sequence[str]) -> Iterator[str]:
    for reason in skipped:
        yield f"Left out: {reason}"
    yield f"Second camera <- first camera, by {len(rotation.views)} poses that both cameras saw:"
    for axis, angle, sigma in zip("xyz", rotation.vector_deg, rotation.sigma_arcsec, strict=True):
        text, expanded = with_uncertainty(3600.0 * float(angle), 2.0 * float(sigma))
        yield f"  rotation vector {axis} {angle:>12.6f} deg = {text} ± {expanded} arcsec (k = 2)"
    for row in rotation.rotation:
        yield "  [" + " ".join(f"{number:>13.9f}" for number in row) + "]"
    for view, residual in zip(rotation.views, rotation.residuals_arcsec, strict=True):
        yield f"  {view}: residual {' '.join(f'{axis:.1f}' for axis in residual)} arcsec"
    verdict = (
        "the views agree with a rigid rig"
        if rotation.rigid
        else "THE RIG IS NOT RIGID, or the cameras did not see the same poses"
    )
    yield f"Chi-square {rotation.chi_square:.1f} for {rotation.degrees_of_freedom} degrees of freedom: {verdict}."
    yield "The distance between the cameras cannot be measured through a collimator: no translation is given."
