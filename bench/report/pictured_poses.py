"""Which poses a report shows as images, because a page cannot show thousands, and which of their stars its plots show.

Results.json alone decides: a report that is rendered again from the same results selects the same poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from bench.measure.view_picture import ViewPicture
from bench.record.measured_facts import GateData
from bench.record.results import Results

MOST_PICTURES = 24
"""Largest number of poses shown as images, so that the report stays small enough for a mail."""
_WORST = 3  # Views that somebody looks at first
_NOT_PASSED = ("fail", "marginal")

PLOTS = (
    "uncertainty", "direction", "distortion", "scene", "vectors", "cloud", "coverage", "regions",
    "change", "change_ratio",
)  # fmt: skip
"""Names of the plots in the template."""
MOST_STARS = 12_000
"""Approximate largest number of stars in a plot: more hide each other, and make the page slow."""
_GOLDEN = 0.6180339887498949  # Fraction of the golden ratio: its multiples spread evenly over 0 to 1


@dataclass(frozen=True)
class PictureSelection:
    """Poses that a report shows as images."""

    names: frozenset[str]
    shown: int
    total: int


def pictured_poses(results: Results) -> PictureSelection:
    """Select the poses to show: all if few, else `MOST_PICTURES`, evenly spread where a group does not fit.

    First the three of the largest RMS residual, then failed gates, marginal gates, others; none without stars.
    """
    poses = [pose for pose in results.get("poses") or [] if pose.get("rms_px") is not None]
    judged = _indices_by_verdict(results.get("gates") or [])
    worst_first = sorted(range(len(poses)), key=lambda place: (-(poses[place]["rms_px"] or 0.0), place))
    groups = [
        worst_first[:_WORST],
        *([p for p, pose in enumerate(poses) if pose["index"] in judged[verdict]] for verdict in _NOT_PASSED),
        list(range(len(poses))),
    ]
    chosen: set[int] = set()
    for group in groups:
        chosen.update(_evenly_spread([p for p in group if p not in chosen], MOST_PICTURES - len(chosen)))
    return PictureSelection(frozenset(str(poses[place]["name"]) for place in chosen), len(chosen), len(poses))


def _indices_by_verdict(gates: Sequence[GateData]) -> dict[str, set[int]]:
    """Return the indices of the poses that have a gate with this verdict; gates of the whole run belong to no pose."""
    indices: dict[str, set[int]] = {verdict: set() for verdict in _NOT_PASSED}
    for gate in gates:
        if "pose" in gate and gate["verdict"] in indices:
            indices[gate["verdict"]].add(gate["pose"])
    return indices


def _evenly_spread(places: Sequence[int], most: int) -> Sequence[int]:
    """Select at most ``most`` places, evenly spread, with the first and the last."""
    if len(places) <= most:
        return places
    return [places[k * (len(places) - 1) // max(1, most - 1)] for k in range(most)]


def thinned(views: Sequence[ViewPicture], most: int = MOST_STARS) -> Sequence[ViewPicture]:
    """Reduce the stars to about ``most``, evenly over all views; fewer stars stay as they are.

    By the fractional part of n times the golden ratio: of low discrepancy, unlike the target's rows, other stars each
    view.
    """
    total = sum(len(view.ids) for view in views)
    if total <= most:
        return views
    import numpy as np

    kept = np.arange(total) * _GOLDEN % 1.0 < most / total
    ends = np.cumsum([len(view.ids) for view in views])
    return [
        replace(view, detected=view.detected[k], reprojected=view.reprojected[k], ids=view.ids[k])
        for view, k in zip(views, np.split(kept, ends[:-1]), strict=True)
    ]
