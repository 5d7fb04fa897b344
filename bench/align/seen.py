"""What a live image and its recording show, as the advice of the align page reads it."""

from __future__ import annotations

from dataclasses import dataclass

from bench.align.focus_figure import FocusFigures
from bench.align.live_image import LiveImage
from bench.align.where_to_turn import TurnFigures
from calib.stars.beam import Beam
from calib.stars.quick import QuickStars
from drivers.camera import RecordingFacts
from drivers.camera.frames import FrameFacts


@dataclass(frozen=True)
class Seen:
    """Everything that the advice is made from."""

    image: LiveImage
    facts: RecordingFacts | FrameFacts | None  # What the driver states about it; None if unknown
    beam: Beam  # The beam's disc
    stars: QuickStars | None  # Tag and stars; None if they were not searched
    other_tag: str  # What is wrong with the tags seen; empty if nothing is
    focus: FocusFigures
    best_edge_width_px: float | None  # Smallest edge width seen so far, px
    best_sharpness: float | None
    best_coarse_detail: float | None
    # Best edge width since the camera was turned, px, if the present one is clearly worse; else None.
    better_before_px: float | None
    trend: str  # Where the focus goes: ``better``, ``worse`` or empty
    contrast: float | None  # Contrast inside the beam; None without light
    turn: TurnFigures  # Where to turn

    @property
    def count(self) -> int:
        """Number of stars."""
        return 0 if self.stars is None else len(self.stars.points_px)

    @property
    def tag_seen(self) -> bool:
        """Whether the tag, or enough of it to identify the stars, is in view."""
        return self.stars is not None and (self.stars.tag is not None or bool(self.stars.named_by))
