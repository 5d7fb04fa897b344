"""Everything that a live picture showed, from which the advice is made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from bench.align.focus import FocusFigures
from bench.align.live_image import LiveImage, LiveSetting
from bench.align.where_to_turn import TurnFigures
from calib.stars.beam import Beam
from calib.stars.quick import QuickStars
from drivers.camera import RecordingFacts
from drivers.camera.frames import FrameFacts

SHARP_PX: Final = 1.0
"""Edge width below which the lens counts as focused; up to 1.3 px every star is found."""
BRIGHT_PERCENT: Final = 50.0
"""Level of the light from which the coarse detail has a slope while the lens is far out of focus."""


@dataclass(frozen=True)
class Seen:
    """Everything that the advice is made from."""

    image: LiveImage
    facts: RecordingFacts | FrameFacts | None  # What the driver states about it; None if unknown
    beam: Beam  # The beam's disc
    stars: QuickStars | None  # Tag and stars; None if they were not searched
    other_tag: str  # What is wrong with the tags seen; empty if nothing is
    focus: FocusFigures  # With those of the course
    contrast: float | None  # Contrast inside the beam; None without light
    turn: TurnFigures  # Where to turn

    @property
    def count(self) -> int:
        """Number of stars."""
        return 0 if self.stars is None else len(self.stars.points_px)

    @property
    def square_text(self) -> str:
        """Where a dark square is seen, without a full stop."""
        borders = self.turn.square_borders
        where = f" at the {' and '.join(borders)} border" if borders else ""
        return f"A dark square that looks like the tag is in view{where}"

    def is_dim(self, setting: LiveSetting) -> bool:
        """Return whether more light would show the way out of focus; a frame camera has its exposure for that."""
        level = setting.level_percent
        return self.image.signal is not None and level is not None and level < BRIGHT_PERCENT

    @property
    def tag_seen(self) -> bool:
        """Whether the tag, or enough of it to identify the stars, is in view."""
        return self.stars is not None and (self.stars.tag is not None or bool(self.stars.named_by))
