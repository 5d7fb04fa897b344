"""All checks of wrong data: `check_views` before an adjustment of them, `check_adjustment` after it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.parameters import AdjustmentParameters
from calib.diagnosis.gross_stars import noise_px
from calib.diagnosis.shifted_views import find_other_origins, find_shifted_ids
from calib.diagnosis.stated_numbers import check_image_size, check_target_units, require_points_inside
from calib.view import View

#: Points closer than this are the same numbers, px.
SAME_PX = 1e-6
#: Two recordings of one pose differ by sqrt(2) times the noise of one; below this share of it they are too much alike.
_TOO_MUCH_ALIKE = 0.5
#: Only pairs of views with a smaller rms distance of the common stars are compared, px.
_NEAR_PX = 1.0
#: Views with fewer common stars are not compared, nor views of which less than this share is common.
_FEWEST = 4
_COMMON_SHARE = 0.5


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


def find_duplicates(views: Sequence[View]) -> list[str]:
    """Return a sentence for each pair of views, without gross errors, that hold the same measurement.

    Two recordings of one pose differ by their noise, and are not duplicates. Own rule: the root mean square distance of
    the common stars per axis is below half of sqrt(2) times the noise that neighbouring stars show.
    """
    found = []
    for one, other in _alike(views):
        _, here, there = np.intersect1d(one.ids, other.ids, return_indices=True)
        apart = one.points_px[here] - other.points_px[there]
        rms = float(np.sqrt((apart**2).sum(axis=1).mean()))
        both, stars = f"Views {one.name} and {other.name}", f"their {len(here)} common stars"
        if rms <= SAME_PX:
            found.append(
                f"{both} are the same measurement: {stars} have the same points. They count once; leave one of them "
                "out."
            )
            continue
        noise = float(np.fmin(noise_px(one), noise_px(other)))
        if rms / np.sqrt(2.0) < _TOO_MUCH_ALIKE * np.sqrt(2.0) * noise:
            found.append(
                f"{both} are nearly the same measurement: {stars} differ by {rms:.2g} px rms, less than two recordings "
                f"would ({1.4142 * noise:.2g} px per axis). Check that one recording was not used twice."
            )
    return found


def _alike(views: Sequence[View]) -> Iterator[tuple[View, View]]:
    """Yield the pairs of views that show many of the same stars at about the same points; most pairs do not."""
    known = np.unique(np.concatenate([view.ids for view in views]))
    points = np.full((2, len(views), len(known)), np.nan)
    for i, view in enumerate(views):
        points[:, i, np.searchsorted(known, view.ids)] = view.points_px.T
    stars = np.array([len(view) for view in views])
    for i in range(len(views) - 1):
        x, y = points[:, i + 1 :] - points[:, i, None]
        squares = x * x + y * y
        common = np.isfinite(squares)
        count = common.sum(axis=1)
        enough = count >= np.maximum(_FEWEST, _COMMON_SHARE * np.minimum(stars[i], stars[i + 1 :]))
        near = np.where(common, squares, 0.0).sum(axis=1) <= _NEAR_PX**2 * count
        for j in np.flatnonzero(enough & near).tolist():
            yield views[i], views[i + 1 + j]
