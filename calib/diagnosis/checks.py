"""Checks of what is stated of views: `check_views` before an adjustment of them, `check_image_size` after it.

The unit of the target positions and the image size are stated beside the points. A wrong unit scales the collimator's
radius, and nothing else: the camera is the same, and no residual changes. So views alone decide only when the numbers
are implausible. A known radius decides. An image size is wrong if points lie outside of it, or if it is too large for
the points and the principal point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, pairwise

import numpy as np

from calib.arrays import Array, rms_length
from calib.diagnosis.gross_stars import OUTSIDE_PX, noise_px, outside_image
from calib.errors import InputMismatch
from calib.model.camera import CameraModel
from calib.model.closed_forms import linear_solution
from calib.model.homography import neighbours_of, view_homography
from calib.view import View

#: Points closer than this are the same numbers, px.
SAME_PX = 1e-6
#: Two recordings of one pose differ by sqrt(2) times the noise of one; below this share of it they are too much alike.
_TOO_MUCH_ALIKE = 0.5
#: Only pairs of views with a smaller rms distance of the common stars are compared, px: other poses lie farther apart.
_NEAR_PX = 1.0
#: Views with fewer common stars are not compared, nor views of which less than `_COMMON_SHARE` is common: a few stars
#: of different views may be near each other by chance.
_FEWEST = 4
#: Views that a sentence names, and pairs that have one of their own.
_MOST_NAMED = 5
_COMMON_SHARE = 0.5
Size = tuple[int, int]

#: What may be in another unit.
_TARGET, _CERTIFICATE = "target positions", "lengths of the certificate"
#: Millimetres in units that are taken for millimetres by mistake.
_UNITS = {"metres": 1000.0, "centimetres": 10.0, "inches": 25.4, "micrometres": 0.001}
#: Pitches and radii outside of these ranges are implausible, mm: those that were meant in metres or micrometres are.
PLAUSIBLE_PITCH_MM = (0.05, 500.0)
PLAUSIBLE_R_MM = (5.0, 50_000.0)  # From a lens as collimator to a mirror of an observatory
#: A ratio of radii names a unit if it is within this factor of it. A closed-form radius is known to some 20 per cent.
_TOLERANCE = 1.5
#: No camera is turned so far that one axis of the target is so many times as long as the other: that needs 81 degrees.
_TWO_UNITS = 6.5
#: Closed forms with a free and with a central principal point agree within this factor if the views show the radius.
_ALIKE = 1.05

#: Sizes of event cameras and of common frame cameras, px.
KNOWN_SIZES: tuple[Size, ...] = (
    (1280, 720), (640, 480), (346, 260), (320, 320), (304, 240), (240, 180), (128, 128), (320, 240),
    (480, 320), (640, 512), (768, 640), (816, 612), (752, 480), (800, 600), (1024, 768), (1280, 800),
    (1280, 960), (1280, 1024), (1440, 1080), (1600, 1200), (1632, 1224), (1920, 1080), (1920, 1200),
    (2048, 1536), (2448, 2048), (2592, 1944), (4096, 3000),
)  # fmt: skip
#: Points that all lie within this are shares of the image: no target of four points is as small, px.
_SHARES_PX = 2.0
#: Places of one point of the target may differ by this share of a pitch, beside whole columns and rows: at a half, no
#: whole number is the nearest.
_SAME_PLACE = 0.4
#: A principal point this share of the width or height away from the middle is implausible: a lens is mounted better.
_FAR_FROM_MIDDLE = 0.15
#: A size explains the views if its middle is within this share of the principal point ...
_NEAR_MIDDLE = 0.1
#: ... and if the outermost points come this close to its border, as a share of it.
_NEAR_BORDER = 0.1


def check_views(views: Sequence[View], *, known_r_mm: float | None = None) -> tuple[str, ...]:
    """Return a sentence for each doubt about views without gross errors, before an adjustment: size, duplicates, unit.

    ``known_r_mm`` is the collimator's radius from a passport, a certificate or a data sheet.
    Raises InputMismatch: If points lie outside of the image, or X and Y, or target and r, are in different units.
    """
    require_points_inside(views)
    _require_one_unit(views)
    return (*find_duplicates(views), *filter(None, [check_target_units(views, known_r_mm=known_r_mm)]))


def find_duplicates(views: Sequence[View]) -> list[str]:
    """Return a sentence for views, without gross errors, that hold the same measurement, and for each pair nearly so.

    Two recordings of one pose differ by their noise, and are not duplicates. Own rule: the root mean square distance of
    the common stars per axis is below half of sqrt(2) times the noise that neighbouring stars show.
    """
    groups: list[list[View]] = []
    for view in views:
        same = next((group for group in groups if _apart(group[0], view)[1] <= SAME_PX), None)
        if same is None:
            groups.append([view])
        else:
            same.append(view)
    sentences = [_same_words(group) for group in groups if len(group) > 1]
    pairs = combinations([group[0] for group in groups], 2)
    alike = list(filter(None, (_alike_words(*pair) for pair in pairs)))
    more = len(alike) - _MOST_NAMED
    if more > 1:
        alike[_MOST_NAMED:] = [f"{more} more pairs of views are nearly the same measurement."]
    return [*sentences, *alike]


def _apart(first: View, other: View) -> tuple[int, float]:
    """Return the number of common points and their rms distance, px; infinite if too few are common."""
    _, here, there = np.intersect1d(first.ids, other.ids, assume_unique=True, return_indices=True)
    if len(here) < max(_FEWEST, _COMMON_SHARE * min(len(first), len(other))):
        return len(here), np.inf
    return len(here), rms_length(first.points_px[here] - other.points_px[there])


def _same_words(group: Sequence[View]) -> str:
    """Return a sentence on views that hold one measurement."""
    *names, last = [view.name for view in group[:_MOST_NAMED]]
    more = len(group) - _MOST_NAMED
    listed = f"{', '.join([*names, last])} and {more} more" if more > 0 else f"{', '.join(names)} and {last}"
    points = f"their {_apart(*group[:2])[0]} common points have the same places"
    leave = "one of them" if len(group) == 2 else "all but one"
    return f"Views {listed} are the same measurement: {points}. They count once; leave {leave} out."


def _alike_words(first: View, other: View) -> str:
    """Return a sentence on two views that are too much alike for two recordings; empty if they are not."""
    common, rms = _apart(first, other)
    if rms > _NEAR_PX:
        return ""
    noise = float(np.fmin(noise_px(first), noise_px(other)))
    if rms / np.sqrt(2.0) >= _TOO_MUCH_ALIKE * np.sqrt(2.0) * noise:
        return ""
    return (
        f"Views {first.name} and {other.name} are nearly the same measurement: their {common} common points differ by"
        f" {rms:.2g} px rms, less than two recordings would ({1.4142 * noise:.2g} px per axis). Check that one"
        " recording was not used twice."
    )


def _require_one_unit(views: Sequence[View]) -> None:
    """Refuse a target whose X and Y are in two units: no turn of a camera makes all views so narrow."""
    ratios = [_x_to_y(view) for view in views]
    if min(ratios) > _TWO_UNITS or max(ratios) * _TWO_UNITS < 1.0:
        raise InputMismatch(
            f"In the image, a length of 1 along X of the target is {np.median(ratios):.3g} times as long as along Y.",
            where=_TARGET,
            remedy="X and Y are in two units: give both in mm.",
        )


def _x_to_y(view: View) -> float:
    """Return the ratio of lengths in the image along X and along Y of the target; 1 for stars on a line."""
    (x, y, _), _, rank, _ = np.linalg.lstsq(np.c_[view.target_mm, np.ones(len(view))], view.points_px)
    return float(np.hypot(*x) / np.hypot(*y)) if rank == 3 else 1.0


def check_target_units(views: Sequence[View], *, known_r_mm: float | None = None) -> str:
    """Return a sentence if the unit of the target positions is implausible; empty if not, which is no proof of it.

    ``known_r_mm`` is from a passport, a certificate or a data sheet, and is compared with a closed form; without it,
    only implausible numbers count.
    Raises InputMismatch: If the positions contradict the known radius, and another unit explains that.
    """
    why, what, unit = _doubt_of_unit(views, known_r_mm)
    if unit and known_r_mm is not None:
        # Without this refusal, the adjustment would end in an obscure one.
        remedy = "Compare the lengths of target and certificate with what states them; give both in mm."
        raise InputMismatch(f"{why} The {what} look like {unit}.", where=what, remedy=remedy)
    if unit:
        return f"{why} The {what} look like {unit}; give them in mm."
    return f"{why} Check that the {what} are in mm." if why else ""


def _doubt_of_unit(views: Sequence[View], known_r_mm: float | None) -> tuple[str, str, str]:
    """Return what is implausible, a sentence, whose lengths are, and the unit that would explain it, or nothing."""
    r_mm = None if known_r_mm is None else closed_form_radius(views)
    plausible = r_mm is not None and PLAUSIBLE_R_MM[0] <= r_mm <= PLAUSIBLE_R_MM[1]
    if r_mm is not None and known_r_mm is not None:
        why = f"The views give a collimator radius of {r_mm:.6g} mm, and {known_r_mm:.6g} mm is known."
        if plausible and (unit := _unit(r_mm / known_r_mm)) and unit != "micrometres":
            return why, _CERTIFICATE, unit
        if unit := _unit(known_r_mm / r_mm):
            return why, _TARGET, unit
    pitch = min(neighbours_of(view).spacing for view in views)
    if not PLAUSIBLE_PITCH_MM[0] <= pitch <= PLAUSIBLE_PITCH_MM[1]:
        why = f"Neighbouring points of the target are {pitch:.6g} mm apart, which is implausible."
        return why, _TARGET, "metres" if pitch < 1.0 else "micrometres"
    if r_mm is not None and not plausible:
        why = f"The views give a collimator radius of {r_mm:.6g} mm, which is implausible."
        return why, _TARGET, "metres" if r_mm < 1.0 else "micrometres" if r_mm > 1e5 else ""
    return "", "", ""


def closed_form_radius(views: Sequence[View]) -> float | None:
    """Return the collimator's radius, mm (arXiv:2512.16092, eq. 5); None if it is not real, as of one view.

    Also None if it depends on whether the principal point is known: then these views hardly show it.
    """
    h, size = np.array([view_homography(view) for view in views]), views[0].image_size
    both = [linear_solution(h, size, free_principal_point=free) for free in (True, False)]
    radii = [closed_form[1].r for closed_form in both if closed_form is not None]
    return radii[0] if radii and max(radii) < _ALIKE * min(radii) else None


def _unit(ratio: float) -> str:
    """Return the unit whose length in mm is within a factor of a ratio; empty if none is."""
    near = {name: abs(np.log(ratio / length)) for name, length in _UNITS.items()}
    name = min(near, key=lambda unit: near[unit])
    return name if near[name] < np.log(_TOLERANCE) else ""


def require_one_target(views: Sequence[View]) -> None:
    """Refuse views in which one number names points at different places of the target.

    Numbers that are shifted by whole columns and rows in all of a view are found with the camera, and named then.
    """
    for view, other in pairwise(views):
        _, here, there = np.intersect1d(view.ids, other.ids, return_indices=True)
        if not here.size:
            continue
        apart = (other.target_mm[there] - view.target_mm[here]) / neighbours_of(view).spacing
        wrong = np.abs(apart - np.round(np.median(apart, axis=0))).max(axis=1) > _SAME_PLACE
        if wrong.any():
            at = int(wrong.argmax())
            places = [
                f"({of.target_mm[k, 0]:g}, {of.target_mm[k, 1]:g}) mm in view {of.name}"
                for of, k in ((view, here[at]), (other, there[at]))
            ]
            raise InputMismatch(
                f"On the target, point {view.ids[here[at]]} is at {places[0]}, and at {places[1]}.",
                remedy="Give each point of the target a number of its own, the same in every view. Check also that"
                " points of the image and of the target are not exchanged.",
            )


def require_points_inside(views: Sequence[View]) -> None:
    """Refuse views with points outside of their image size; names the first one, and a known size that holds all."""
    if all(np.ptp(view.points_px, axis=0).max(initial=0.0) < _SHARES_PX for view in views if len(view)):
        raise InputMismatch(
            f"All points of a view lie within {_SHARES_PX:g} px: they look like shares of the image.",
            where=f"view {views[0].name}",
            remedy="Give px.",
        )
    for view in views:
        limit = np.array(view.image_size) - 1.0 + OUTSIDE_PX
        outside = outside_image(view)
        if not outside.any():
            continue
        beyond = np.maximum(view.points_px - limit, -OUTSIDE_PX - view.points_px).max(axis=1)
        x, y = view.points_px[int(beyond.argmax())]
        before = min(view.points_px.min() for view in views) < -OUTSIDE_PX
        size = None if before else _known_size(_reached(views), 2.0 * _NEAR_BORDER)
        hint = f" The points fit into {size[0]} x {size[1]}." if size else ""
        raise InputMismatch(
            f"{np.count_nonzero(outside)} of {len(view)} points lie outside the stated image size "
            f"{view.image_size[0]} x {view.image_size[1]}, the outermost at ({x:.1f}, {y:.1f}).{hint}",
            where=f"view {view.name}",
            remedy="Give the image size of the camera, width first.",
        )


def check_image_size(views: Sequence[View], camera: CameraModel, sigma_px: tuple[float, float]) -> str:
    """Return a sentence if the principal point contradicts the stated image size; empty if not, or if nothing decides.

    Own rule: the principal point is farther from the middle than 15 % of the width or height, by more than 4 sigma. A
    known size explains this if its middle is near the principal point, and the outermost points are near its border.
    ``sigma_px`` is that of cx and cy.
    """
    size = np.array(views[0].image_size, float)
    point = np.array([camera.cx, camera.cy])
    offset_px = np.abs(point - (size - 1) / 2)
    if not (offset_px - 4.0 * np.array(sigma_px) > _FAR_FROM_MIDDLE * size).any():
        return ""

    def explains(known: Array) -> bool:
        near = np.abs(point - (known - 1) / 2) < _NEAR_MIDDLE * known
        return bool((near & (known <= size)).all())

    reached = _reached(views)
    plausible = _known_size(reached, _NEAR_BORDER, explains)
    text = (
        f"The principal point lies {np.hypot(*offset_px):.0f} px from the middle of the stated image size "
        f"{views[0].image_size[0]} x {views[0].image_size[1]}, and no point lies beyond x = {reached[0]:.0f} and "
        f"y = {reached[1]:.0f}."
    )
    if plausible:
        return f"{text} The image size is probably {plausible[0]} x {plausible[1]}."
    return f"{text} Check the image size, and whether the points come from a part of the image."


def _reached(views: Sequence[View]) -> Array:
    """Return the largest x and the largest y of all points, (2,) px."""
    return np.asarray(np.max([view.points_px.max(axis=0) for view in views], axis=0))


def _known_size(
    reached: Array, share: float, explains: Callable[[Array], bool] = lambda _known: True
) -> Size | None:
    """Return the smallest known size that explains the views, and whose border they reach to a share of it, or None."""
    for size in sorted(KNOWN_SIZES, key=lambda size: size[0] * size[1]):
        known = np.array(size, float)
        close = (reached <= known - 1.0 + OUTSIDE_PX) & (known - reached < share * known)
        if close.all() and explains(known):
            return size
    return None
