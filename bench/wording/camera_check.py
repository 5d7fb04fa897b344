"""Whether a checked calibration is right, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from bench.wording.numbers import number

if TYPE_CHECKING:
    from calib.model.result_parts import CameraCheck
    from calib.studies.camera_check import OneViewCheck


_CAUSES = {
    "scale": "A change of scale explains it: the focus or the temperature of the lens changed",
    "principal point": "A shift of the principal point explains it: the lens or the sensor moved in its mount",
    "lens": "A change of the distortion explains it: the lens, its focus or its aperture changed",
    "": "No single change explains it",
}


def check_sentences(check: CameraCheck) -> Iterator[str]:
    """Yield whether the calibration is right, where it is not, and the cause; or how large a change may be unseen."""
    worst = check.worst
    there = f"{worst.name}, at ({worst.at_px[0]:.0f}, {worst.at_px[1]:.0f})"
    if check.right:
        unseen = max(region.expanded_px for region in check.regions)
        yield f"RIGHT within U everywhere on the sensor: the largest E_n is {worst.normalised:.2f} ({there})."
        yield f"A change of the image of less than {unseen:.2f} px can stay unseen by these views."
        return
    yield (
        f"NOT RIGHT: {there}, the image moved by {worst.offset_px:.2f} px; U is {worst.expanded_px:.2f} px"
        f" (E_n {worst.normalised:.2f}). {_CAUSES[check.cause]}."
    )


def one_view_sentences(check: OneViewCheck, *, board: bool) -> Iterator[str]:
    """Yield what one view at an unknown place tells, and which changes it can see."""
    whose = "of a board" if board else "without a known collimator"
    yield f"One view {whose}: judged is only what no other pose explains."
    off = (
        f"after the best pose the image still differs by {check.rms_px:.2f} px RMS, most at"
        f" ({check.at_px[0]:.0f}, {check.at_px[1]:.0f}): {check.largest_px:.2f} px (E_n {check.normalised:.2f})."
    )
    if check.right:
        yield f"RIGHT as far as this view can tell (E_n {check.normalised:.2f}, {check.points} points)."
    elif board:
        yield f"NOT RIGHT: {off}"
    else:
        yield f"UNDECIDED: {off} The lens changed, or the collimator distorts: a passport of it would decide."
    seen = [_seen_text(name, size) for name, size in check.seen_from.items()]
    yield f"A change of one value alone would be seen from: {', '.join(seen)}."


def _seen_text(name: str, size: float) -> str:
    if not math.isfinite(size):
        return f"{name} never"
    if name == "scale":
        return f"scale {number(100.0 * size, 2)} %"
    return f"{name} {number(size, 2)}{' px' if name in ('cx', 'cy') else ''}"
