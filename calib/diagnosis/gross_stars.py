"""What neighbouring stars say of each other: gross errors, the sentences that name them, and the noise of a view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array, Bools
from calib.errors import DegenerateViews, InputMismatch, TooFewStars
from calib.model.beam import inside_guard_band, visible_discs
from calib.model.homography import (
    apply_homography,
    gross_errors,
    neighbours_of,
    rough_homography,
    view_homography,
)
from calib.model.local_consistency import LIMIT_PX, local_sigma_px, local_spacing
from calib.stars.grid_map import predict_locally
from calib.view import View

#: A view with a larger share of gross errors is refused: so many are no slips, and the others may be wrong, too.
MAX_SHARE = 0.2
#: Points up to this far outside of the outermost pixel centres are inside of the image, px: half a pixel, and another
#: half for points whose origin is the corner.
OUTSIDE_PX = 1.0
#: One point outside of the image, or up to this share of all, is left out; more say that the stated size is wrong.
_FEW_OUTSIDE = 0.002


@dataclass(frozen=True)
class GrossStars:
    """The stars of one view that have a gross error."""

    view: str
    wrong: Bools  # (N,) bool, which of the N stars of the view have a gross error
    distances_px: Array  # (K,) px, distance of those that neighbours contradict from where they predict it
    outside: int = 0  # How many of them lie outside of the image
    fault: str = ""  # Why none of the view's stars can be used, a sentence

    @property
    def sentence(self) -> str:
        """Names the view, the number of stars and their distances; empty if there are none."""
        if self.fault:
            return f"View {self.view} was left out. {self.fault}"
        said = []
        if count := len(self.distances_px):
            ends = self.distances_px.min(), self.distances_px.max()
            span = " to ".join(dict.fromkeys(f"{float(f'{end:.2g}'):g}" for end in ends))
            far = f"{span} px from where the neighbours predict {'it' if count == 1 else 'them'}"
            said.append(self._left_out(count, far))
        if self.outside:
            said.append(self._left_out(self.outside, "outside of the image"))
        return " ".join(said)

    def _left_out(self, count: int, where: str) -> str:
        lie, they = ("lies", "it was") if count == 1 else ("lie", "they were")
        return f"{count} of {len(self.wrong)} points in view {self.view} {lie} {where}; {they} left out."


def find_gross_stars(views: Sequence[View]) -> tuple[GrossStars, ...]:
    """Find the gross errors of each view: stars whose point or id their neighbours on the target contradict.

    By `contradicts_neighbours`; `InputMismatch` names a view in which more than a fifth of the stars are wrong. So are
    stars outside of the image, if they are few: many show that its size is wrong. All stars of a view are left out if
    they are too few or lie on a line.
    """
    outside = [outside_image(view) for view in views]
    few = sum(map(np.count_nonzero, outside)) <= max(1.0, _FEW_OUTSIDE * sum(map(len, views)))
    return tuple(_left_out_of(view, few & own) for view, own in zip(views, outside, strict=True))


def outside_image(view: View) -> Bools:
    """Tell which of the N stars of a view lie outside of its image."""
    limit = np.array(view.image_size) - 1.0 + OUTSIDE_PX
    return np.asarray(((view.points_px < -OUTSIDE_PX) | (view.points_px > limit)).any(axis=1))


def _left_out_of(view: View, outside: Bools) -> GrossStars:
    """Return the gross errors of the stars inside of the image, and those outside with them."""
    wrong = outside.copy()
    try:
        inside = _gross_stars(view.part(~outside) if outside.any() else view)
    except (TooFewStars, DegenerateViews) as error:
        return GrossStars(view.name, np.ones_like(wrong), np.zeros(0), fault=error.what)
    wrong[~outside] = inside.wrong
    return replace(inside, wrong=wrong, outside=int(np.count_nonzero(outside)))


def without_gross_stars(views: Sequence[View], gross: Sequence[GrossStars]) -> list[View]:
    """Return the views without their gross errors; a view that has none is the same object."""
    return [
        view.part(~stars.wrong) if stars.wrong.any() else view
        for view, stars in zip(views, gross, strict=True)
    ]


def _gross_stars(view: View) -> GrossStars:
    """Return the gross errors of one view; refuse the view if there are too many."""
    wrong = gross_errors(view)
    count = int(np.count_nonzero(wrong))
    if count > MAX_SHARE * len(view):
        raise InputMismatch(
            f"{count} of {len(view)} points do not lie where their neighbours predict them.",
            where=f"view {view.name}",
            remedy="Check the ids, the points and the target positions of this view, or leave it out.",
        )
    if not count:
        return GrossStars(view.name, wrong, np.zeros(0))
    right = view.part(~wrong)
    spacing = local_spacing(right.target_mm)
    h = view_homography(right) @ np.diag([spacing, spacing, 1.0])
    wanted = view.target_mm[wrong] / spacing
    predicted = predict_locally(h, right.target_mm / spacing, right.points_px, wanted)
    distances = np.linalg.norm(view.points_px[wrong] - predicted, axis=1)
    is_wrong = wrong.copy()
    is_wrong[wrong] = far = distances > LIMIT_PX  # right stars amid many wrong ones seem wrong too
    return GrossStars(view.name, is_wrong, distances[far])


def used_stars(views: Sequence[View], guard_band: float, wrong: Sequence[GrossStars]) -> list[Bools]:
    """Return for each view which stars are neither in a guard band (share of the disc's radius; 1: none) nor wrong."""
    used = [~stars.wrong for stars in wrong] or [np.ones(len(view), np.bool_) for view in views]
    discs = visible_discs(views) if guard_band < 1.0 else []
    if discs:  # else the rim is nowhere in view, and no star is near it
        inside = [inside_guard_band(view, disc, guard_band) for view, disc in zip(views, discs, strict=True)]
        used = [own & stars for own, stars in zip(used, inside, strict=True)]
    return used


def noise_px(view: View) -> float:
    """Return the 1-sigma per axis, px, that neighbouring stars show (`local_sigma_px`); NaN for fewer than 8 stars."""

    def noise(seen: View) -> float:
        mapped = apply_homography(rough_homography(seen), seen.target_mm)
        return local_sigma_px(seen.target_mm, mapped, seen.points_px, neighbours_of(seen))

    return view.remembered("noise", noise)
