"""From one recording to one view: RAW file, whole flicker periods, event image, stars.

This module joins the drivers' readers and the calibration engine. Every number that a gate or the report shows about
a recording is calculated here, from the file alone, so that it can be calculated again from the evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.records.events import MeasuredFacts
from bench.views.event_window import read_events, recorded_image, whole_image
from bench.views.no_light import without_light
from bench.views.stored_image import StoredImage
from calib.errors import (
    CalibrationError,
    DegenerateViews,
    StarsUnnamed,
    TargetNotFound,
    TooFewEvents,
    TooFewStars,
)
from calib.events.motion import motion_between
from calib.model.homography import fit_homography
from calib.stars.detect import detect_stars, detect_view
from calib.stars.rim import find_rim
from calib.stars.vignetting import downweight_vignetted
from calib.target import StarTarget
from calib.view import View
from drivers.errors import RecordingFileError

__all__ = [
    "ExpectedGrid",
    "Measurement",
    "aligned_poses",
    "edge_angle_deg",
    "find_stars",
    "measure",
    "motion_px",
    "plain_facts",
    "recorded_image",
]

ExpectedGrid = Callable[[tuple[int, int]], NDArray[np.float64]]
"""Returns, for an image size (width, height) in px, the expected homography of the target's grid: (3, 3) float64, from
[column row 1] to [u v 1] px. Raises DegenerateViews if no prediction is possible."""


_ALIGNED_DEG = 3.0
"""Largest angle to the pixel rows or diagonals at which the errors of star edges count as correlated, degrees. They are
correlated at 0.5 degrees and not at 10 degrees (docs/stars.md)."""


@dataclass(frozen=True)
class Measurement:
    """What a recording showed."""

    view: View | None  # The stars; None if none were found, then ``fault`` states why
    # Event image in which the stars were detected; None if it could not be made or was not asked for.
    image: StoredImage | None
    # Numbers for gates, journal and report: image kind and reason, window, periods, events per edge, ON
    # share, hot pixels, flicker frequency and its source, triggers expected and found, motion, what labelled
    # the stars and where their grid lies.
    facts: MeasuredFacts = field(default_factory=MeasuredFacts)
    fault: str = ""  # Why there is no view; empty if there is one

    @property
    def stars(self) -> int:
        """Number of stars found."""
        return 0 if self.view is None else len(self.view)


def measure(
    path: Path,
    *,
    name: str,
    target: StarTarget,
    image: str,
    periods: int | None,
    expected_hz: float | None,
    expected_grid: ExpectedGrid | None = None,
    motion: bool = True,
) -> Measurement:
    """Read a recording and find the stars in it.

    path: RAW file.
    image: Kind of event image, or ``auto``.
    periods: Number of whole flicker periods to use; None for all that the recording holds.
    expected_hz: Nominal frequency of the flicker, Hz; None if unknown.
    expected_grid: Predicts where the stars lie; used only if the tag does not label them.
    motion: Whether to measure how far the stars moved from the first half of the recording to the second,
      which takes twice as long as finding them. Without it, what else only gates and report need is left out
      too: the image for people, the flicker by the events, and the width of the stars' edges. The view
      depends on none of these.
    Returns: Also if the file cannot be read or shows no stars; then it holds the fault.
    """
    facts: MeasuredFacts = {}
    stored: StoredImage | None = None
    try:
        whole = whole_image(read_events(path), image, periods, expected_hz, facts, compare_flicker=motion)
        stored = StoredImage.from_image(whole.image) if motion else None
        try:
            found = find_stars(whole.image, target, name, expected_grid, facts, edge_width=motion)
        except TargetNotFound as error:
            raise without_light(error, facts, whole.image.size) from error
        view = downweight_vignetted(found, target)
        if motion:
            facts["motion_px"] = motion_px(whole.halves(), target, facts)
    except (CalibrationError, RecordingFileError) as error:
        return Measurement(None, stored, plain_facts(facts), str(error))
    return Measurement(view, stored, plain_facts(facts))


def find_stars(
    image: NDArray[Any],
    target: StarTarget,
    name: str,
    expected_grid: ExpectedGrid | None,
    facts: MeasuredFacts,
    *,
    edge_width: bool = True,
) -> View:
    """Detect and label the stars of an image, and find the rim of the beam in it.

    The expected grid is used if the tag does not label the stars.

    Four facts are added to ``facts``: ``named_by`` (``tag``, ``part of the tag`` or ``gimbal``), ``grid``,
    the homography of the view's grid, (3, 3) from [column row 1] to [u v 1] px as lists,
    ``expected_grid``, the one that was expected, and ``edge_width_px``, the blur of the stars' edges, px.

    image: (H, W), any numeric dtype, grey values.
    expected_grid: Predicts where the stars lie; None if no prediction is available.
    edge_width: Whether to measure the width of the stars' edges.
    Raises StarsUnnamed: If neither the tag nor the expected grid labels the stars.
    Raises CalibrationError: If no stars are found.
    """
    try:
        detection = detect_stars(image, target, name=name)
    except StarsUnnamed as unnamed:
        if expected_grid is None:
            raise
        try:
            expected = expected_grid((image.shape[1], image.shape[0]))
        except DegenerateViews as unknown:
            raise StarsUnnamed(unnamed.what, where=unnamed.where, remedy=str(unknown)) from unknown
        detection = detect_stars(image, target, name=name, expected=expected)
        facts["expected_grid"] = expected.tolist()
    grid = fit_homography(target.node_of(detection.view.ids).astype(float), detection.view.points_px)
    facts["named_by"] = "gimbal" if detection.named_by == "expected pose" else detection.named_by
    facts["grid"] = grid.tolist()
    if edge_width:
        facts["edge_width_px"] = detection.edge_width_px
    return replace(detection.view, rim=find_rim(image, detection.view, target))


def aligned_poses(facts: Iterable[MeasuredFacts]) -> int:
    """Count the recordings whose star edges run along the pixels, in an image of fired and silent pixels.

    Such an edge crosses all pixels of a row at the same place, so the errors of neighbouring stars are
    correlated. The covariance of a single star cannot express this (docs/stars.md).

    facts: Facts of recordings, as `measure` returns them.
    """
    return sum(
        edge_angle_deg(np.array(one["grid"])) < _ALIGNED_DEG
        for one in facts
        if "grid" in one and "image" in one and one["image"]["kind"] in {"fired-per-edge", "last-polarity"}
    )


def edge_angle_deg(grid: NDArray[np.float64]) -> float:
    """Return the angle between the star edges and the pixel rows or diagonals, whichever is smaller.

    grid: (3, 3) float64, from [column row 1] to [u v 1] px.
    Returns: Angle, degrees, 0 to 22.5.

    Examples
    --------
    >>> half = np.radians(50)
    >>> edge_angle_deg(np.array([[np.cos(half), -np.sin(half), 0], [np.sin(half), np.cos(half), 0], [0, 0, 1]]))
    5.0
    """
    # d(u, v)/d(column) at the grid's origin, times the square of grid[2, 2].
    along = grid[:2, 0] * grid[2, 2] - grid[:2, 2] * grid[2, 0]
    direction = np.degrees(np.arctan2(along[1], along[0]))
    return round(float(abs((direction + 22.5) % 45.0 - 22.5)), 6)


def motion_px(halves: Iterable[NDArray[Any]], target: StarTarget, facts: MeasuredFacts) -> float | None:
    """Return the length of the stars' shift from the first half of a recording to the second.

    halves: Images of the two halves, each (H, W), grey values.
    facts: Facts of the whole recording; its ``grid`` labels the stars if the tag cannot.
    Returns: Length, px; None if the halves do not show it.
    """
    grid = np.array(facts["grid"])
    try:
        first, second = (detect_view(half, target, name="half", expected=grid) for half in halves)
        return motion_between(first, second).length_px
    except (TooFewEvents, TooFewStars, TargetNotFound):
        return None


def plain_facts(facts: Any) -> Any:
    """Replace numbers that are not finite by None, because JSON has none.

    Returns: The same without such numbers.
    """
    if isinstance(facts, dict):
        return {name: plain_facts(fact) for name, fact in facts.items()}
    if isinstance(facts, list):
        return [plain_facts(fact) for fact in facts]
    return None if isinstance(facts, float) and not math.isfinite(facts) else facts
