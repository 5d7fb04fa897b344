"""True board at finite distance, which may replace the collimator: its points, its light, and where a person puts it.

This module holds the numbers, and what a person has done to the board so far. `placing` computes poses from them,
`board_config` reads them, and ``optics`` draws the board.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

Vector = tuple[float, float, float]

KINDS: Final = ("checkerboard", "circles", "asymmetric-circles", "blinking-dots", "stars")
"""What a board shows. ``stars`` is the printed star target itself, of section ``target``."""

SURFACES: Final = ("print", "screen", "leds")

TREMOR: Final = ((0.2, 1.0), (1.0, 0.5), (3.0, 0.03), (7.0, 0.01), (9.5, 0.04), (12.0, 0.01), (15.0, 0.0))
"""Power density of a hand that holds a board, at frequencies in Hz: slow sway, and the tremor of 8 to 12 Hz."""


@dataclass(frozen=True)
class Placement:
    """A place of the board, and what is wrong with it."""

    # Middle of the board's points, from the camera's centre, in the camera's axes at zero angles (X right, Y
    # down, Z away).
    position_mm: Vector
    turn_deg: Vector = (0.0, 0.0, 0.0)
    flicker: bool = True  # Whether the board flickers; false: its light is steady
    # Where the middle of a second, equal board lies from that of the first; None: there is one board.
    second_mm: Vector | None = None


@dataclass(frozen=True)
class Anywhere:
    """Places that are drawn at random, wholly in view, in place of a list."""

    # distance_mm, distance_spread: Mean distance of the board's middle, and its largest relative deviation.
    distance_mm: float = 1000.0
    distance_spread: float = 0.15
    tilt_deg: float = 35.0  # Largest angle between the board's normal and the line of sight
    roll_deg: float = 20.0


@dataclass(frozen=True)
class HandTruth:
    """A person's hand that places the board and holds it during the recording; zeros: a script and a stand."""

    # scatter_mm, scatter_deg: Random deviation of a placement from the script, 1 sigma in each of three
    # directions.
    scatter_mm: float = 0.0
    scatter_deg: float = 0.0
    shake_mm: float = 0.0
    shake_deg: float = 0.0
    # Points (Hz, power density in any unit) of the shaking's power spectrum; linear between them, zero
    # outside.
    shake_spectrum: tuple[tuple[float, float], ...] = TREMOR

    @property
    def shakes(self) -> bool:
        """Whether the board moves during a recording."""
        return self.shake_mm > 0.0 or self.shake_deg > 0.0


@dataclass(frozen=True)
class BoardState:
    """What a person has done to the board while the bench runs."""

    number: int = 1  # Number of the placement, from 1
    move_mm: Vector = (0.0, 0.0, 0.0)
    turn_deg: Vector = (0.0, 0.0, 0.0)
    flicker: bool = True  # Whether its light flickers
    # Where somebody put a second board, from the first one; None: nobody did.
    second_mm: Vector | None = None


@dataclass(frozen=True)
class BoardTruth:
    """A flat board at finite distance in place of the collimator."""

    kind: str = ""  # One of `KINDS`; empty: there is no board
    # columns, rows, pitch_mm: Points along X and Y, and their distance; for a checkerboard inner corners. The
    # pitch of asymmetric circles is the distance of their rows, half that of the circles of a row.
    columns: int = 0
    rows: int = 0
    pitch_mm: float = 0.0
    surface: str = "print"  # ``print`` (white around the pattern), ``screen`` or ``leds`` (dark around it)
    dot_mm: float = 0.0  # Diameter of a circle or dot
    margin_mm: float = 0.0  # White border of a print, beyond the outermost squares or circles
    black: float = 0.04
    # pixel_mm, fill: Distance of a screen's pixels, 0 for none, and the share of a pixel's area that shines.
    pixel_mm: float = 0.0
    fill: float = 1.0
    # refresh_hz, frames_on, frames_off: Refresh rate of a screen that shows the board and darkness by turns,
    # for so many frames each; 0: the bench's light drives the board.
    refresh_hz: float = 0.0
    frames_on: int = 1
    frames_off: int = 1
    # Share of a refresh over which the screen is drawn from its first line to its last one.
    scan: float = 0.0
    frequencies_hz: tuple[float, ...] = ()
    phases: tuple[float, ...] = ()
    placements: tuple[Placement, ...] = ()  # The script; after the last placement comes the first one
    anywhere: Anywhere = field(default_factory=Anywhere)  # Random placements, if there is no script
    hand: HandTruth = field(default_factory=HandTruth)
    seed: int = 0  # Seed of the hand's scatter and of random placements
    # Tangents of the left, upper, right and lower edge of the camera's field, as configured: random
    # placements depend on them, and must not on the camera's temperature.
    field_tangents: tuple[float, float, float, float] = (-1.0, -1.0, 1.0, 1.0)
    state: BoardState = field(default_factory=BoardState)
    shake: tuple[float, float, float, float, float, float] = (0.0,) * 6

    @property
    def present(self) -> bool:
        """Whether there is a board."""
        return self.kind != ""

    @property
    def own_clock(self) -> bool:
        """Whether the board flickers by itself, as one light, whatever the bench's light does."""
        return self.refresh_hz > 0.0

    @property
    def blinks(self) -> bool:
        """Whether each of its dots is a light of its own."""
        return self.kind == "blinking-dots"

    @property
    def flicker_hz(self) -> float:
        """Frequency of a screen that flickers by itself."""
        return self.refresh_hz / (self.frames_on + self.frames_off)

    def in_state(self, state: BoardState) -> BoardTruth:
        """Return the board after something was done to it.

        Returns: The same object if nothing has changed.
        """
        return self if state == self.state else replace(self, state=state)
