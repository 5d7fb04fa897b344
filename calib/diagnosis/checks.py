"""All checks of wrong data: `check_views` before an adjustment of them, `check_adjustment` after it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.parameters import AdjustmentParameters
from calib.diagnosis.duplicate_views import find_duplicates
from calib.diagnosis.shifted_views import find_other_origins, find_shifted_ids
from calib.diagnosis.stated_numbers import check_image_size, check_target_units, require_points_inside
from calib.view import View


def check_views(views: Sequence[View], *, known_r_mm: float | None = None) -> tuple[str, ...]:
    """Return a sentence for each doubt about views without gross errors, before an adjustment: size, duplicates, unit.

    ``known_r_mm`` is the collimator's radius from a passport, a certificate or a data sheet.
    Raises InputMismatch: If points lie outside of the image size, or the known radius shows another unit of the target.
    """
    require_points_inside(views)
    notes = find_duplicates(views)
    units = check_target_units(views, known_r_mm=known_r_mm)
    return (*notes, units) if units else tuple(notes)


def check_adjustment(
    views: Sequence[View], bundle: Bundle, parameters: AdjustmentParameters, sigma: Mapping[str, float]
) -> tuple[str, ...]:
    """Return a sentence for each doubt after an adjustment: shifted ids, other origins, image size.

    Other origins are looked for only if no ids are shifted, because shifted ids spoil the comparison. The views have no
    gross errors; the bundle is of a model in which they share one centre. Of ``sigma``, cx and cy are used, px.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        projected = bool(np.isfinite(bundle.residuals_px(parameters)).all())
    # A star behind the camera cannot be compared with others.
    shifted = find_shifted_ids(views, bundle, parameters) if projected else ""
    other = find_other_origins(views, bundle, parameters) if projected and not shifted else ""
    size = ""
    if "cx" in sigma and "cy" in sigma:
        size = check_image_size(views, parameters.camera, (sigma["cx"], sigma["cy"]))
    return tuple(one for one in (shifted, other, size) if one)
