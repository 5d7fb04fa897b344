"""The board at finite distance that may replace the collimator: what it shows, its light, and where a person puts it.

By the script or at random, scattered by a person's hand, and shaken by it. Frames: camera's axes at zero angles, X
right, Y down, Z away, mm. A pose is the board's rotation and the place of its middle. The same seed and number give the
same placement. ``optics`` draws the board; blinking dots and the lines of a screen are lights of their own, those of
``pixels.sensor_stream``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, SkipValidation

from calib.target import StarTarget
from simulators.errors import ConfigError
from simulators.reading import (
    COMPUTED,
    Count,
    NotNegative,
    Number,
    Section,
    Share,
    Vector,
    Wrong,
    keys_of,
    number,
    one_of,
    refused,
)

FloatArray = NDArray[np.float64]

Shake = tuple[float, float, float, float, float, float]
STILL: Final[Shake] = (0.0,) * 6
"""No displacement: three mm and three degrees."""

BOARD_KINDS: Final = ("checkerboard", "circles", "asymmetric-circles", "blinking-dots", "stars")
"""What a board shows. ``stars`` is the printed star target itself, of section ``target``."""

SURFACES: Final = ("print", "screen", "leds")

TREMOR: Final = ((0.2, 1.0), (1.0, 0.5), (3.0, 0.03), (7.0, 0.01), (9.5, 0.04), (12.0, 0.01), (15.0, 0.0))
"""Power density of a hand that holds a board, at frequencies in Hz: slow sway, and the tremor of 8 to 12 Hz."""


_NOT_IN_FRONT: Final = "The board is not in front of the camera."
_IN_FRONT: Final = "Give a positive third number."


def _flicker(value: object) -> object:
    if not isinstance(value, bool):
        raise Wrong("True or false is expected.")
    return value


def _placements(given: object) -> object:
    if not isinstance(given, (list, tuple)):
        raise Wrong("A list of placements is expected.")
    for index, one in enumerate(given):
        if isinstance(one, Mapping) and "position_mm" not in one and not set(one) - set(keys_of(Placement)):
            raise Wrong("The placement has no position_mm.", "Give three numbers.", f"[{index}]")
    return tuple(given)


def _spectrum(given: object) -> tuple[tuple[float, float], ...]:
    """Check the points of a power spectrum."""
    if not isinstance(given, (list, tuple)) or len(given) < 2:
        raise Wrong("At least two points are expected.", "Give a list of [Hz, density].")
    points = []
    for index, one in enumerate(given):
        if not isinstance(one, (list, tuple)) or len(one) != 2:
            raise Wrong("A pair is expected.", "Give [Hz, density].", f"[{index}]")
        points.append((number(one[0], f"[{index}]"), number(one[1], f"[{index}]")))
    hz, density = zip(*points, strict=True)
    if not (all(a < b for a, b in pairwise(hz)) and hz[0] >= 0.0 and hz[-1] <= 500.0):
        raise Wrong("The frequencies must rise, from at least 0 to at most 500 Hz.")
    if min(density) < 0.0 or max(density) == 0.0:
        raise Wrong("The densities must be positive.")
    return tuple(points)


@dataclass(frozen=True)
class Placement(Section):
    """A place of the board, and what is wrong with it."""

    # Middle of the board's points, from the camera's centre, in the camera's axes at zero angles (X right, Y
    # down, Z away).
    position_mm: Annotated[Vector, refused(lambda at: at[2] <= 0.0, _NOT_IN_FRONT, _IN_FRONT)]
    turn_deg: Vector = (0.0, 0.0, 0.0)
    flicker: Annotated[bool, BeforeValidator(_flicker)] = (
        True  # Whether the board flickers; false: its light is steady
    )
    # Where the middle of a second, equal board lies from that of the first; None: there is one board.
    second_mm: Vector | None = None


@dataclass(frozen=True)
class Anywhere(Section):
    """Places that are drawn at random, wholly in view, in place of a list."""

    # distance_mm, distance_spread: Mean distance of the board's middle, and its largest relative deviation.
    distance_mm: Annotated[Number, refused(lambda mm: mm <= 0.0, _NOT_IN_FRONT)] = 1000.0
    distance_spread: Annotated[
        Number, refused(lambda share: not 0.0 <= share < 1.0, "A share below 1 is expected.")
    ] = 0.15
    tilt_deg: Annotated[
        Number, refused(lambda deg: not 0.0 <= deg <= 80.0, "Give an angle from 0 to 80 degrees.")
    ] = 35.0  # Largest angle between the board's normal and the line of sight
    roll_deg: Number = 20.0


@dataclass(frozen=True)
class HandTruth(Section):
    """A person's hand that places the board and holds it during the recording; zeros: a script and a stand."""

    # scatter_mm, scatter_deg: Random deviation of a placement from the script, 1 sigma in each of three
    # directions.
    scatter_mm: NotNegative = 0.0
    scatter_deg: NotNegative = 0.0
    shake_mm: NotNegative = 0.0
    shake_deg: NotNegative = 0.0
    # Points (Hz, power density in any unit) of the shaking's power spectrum; linear between them, zero
    # outside.
    shake_spectrum: Annotated[tuple[tuple[float, float], ...], BeforeValidator(_spectrum)] = TREMOR

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
class BoardTruth(Section):
    """A flat board at finite distance in place of the collimator."""

    kind: Annotated[str, one_of(BOARD_KINDS)] = ""  # One of `BOARD_KINDS`; empty: there is no board
    # columns, rows, pitch_mm: Points along X and Y, and their distance; for a checkerboard inner corners. The
    # pitch of asymmetric circles is the distance of their rows, half that of the circles of a row.
    columns: Count = 0
    rows: Count = 0
    pitch_mm: NotNegative = 0.0
    surface: Annotated[str, one_of(SURFACES)] = (
        "print"  # ``print`` (white around the pattern), ``screen`` or ``leds`` (dark around it)
    )
    dot_mm: NotNegative = 0.0  # Diameter of a circle or dot
    margin_mm: NotNegative = 0.0  # White border of a print, beyond the outermost squares or circles
    black: Share = 0.04
    # pixel_mm, fill: Distance of a screen's pixels, 0 for none, and the share of a pixel's area that shines.
    pixel_mm: NotNegative = 0.0
    fill: Share = 1.0
    # refresh_hz, frames_on, frames_off: Refresh rate of a screen that shows the board and darkness by turns,
    # for so many frames each; 0: the bench's light drives the board.
    refresh_hz: NotNegative = 0.0
    frames_on: Count = 1
    frames_off: Count = 1
    # Share of a refresh over which the screen is drawn from its first line to its last one.
    scan: Share = 0.0
    frequencies_hz: Annotated[tuple[float, ...], SkipValidation] = ()
    phases: Annotated[tuple[float, ...], SkipValidation] = ()
    placements: Annotated[
        tuple[Placement, ...], BeforeValidator(_placements)
    ] = ()  # The script; after the last placement comes the first one
    anywhere: Anywhere = field(default_factory=Anywhere)  # Random placements, if there is no script
    hand: HandTruth = field(default_factory=HandTruth)
    seed: int = field(default=0, metadata=COMPUTED)  # Seed of the hand's scatter and of random placements
    # Tangents of the left, upper, right and lower edge of the camera's field, as configured: random
    # placements depend on them, and must not on the camera's temperature.
    field_tangents: tuple[float, float, float, float] = field(
        default=(-1.0, -1.0, 1.0, 1.0), metadata=COMPUTED
    )
    size_mm: tuple[float, float] = field(default=(0.0, 0.0), metadata=COMPUTED)  # See `size_of`
    state: BoardState = field(default_factory=BoardState, metadata=COMPUTED)
    shake: Shake = field(default=STILL, metadata=COMPUTED)

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
        """Return the board after something was done to it; the same object if nothing has changed."""
        return self if state == self.state else replace(self, state=state)


_SCATTER, _ANYWHERE = 41, 42
_WAVES: Final = 48
"""Waves of which the shaking in one direction is the sum."""
_MOST_DRAWS: Final = 400
_VIEW: Final = 0.92
"""Share of the image, about its middle, in which a random placement keeps the board."""
_AROUND_TAG: Final = 12
"""Squares of a star target around its tag that a random placement keeps in view."""
_NEAREST_MM: Final = 5.0
_CORNERS: Final = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])


class BoardPose(NamedTuple):
    """Pose of the board."""

    rotation: FloatArray  # (3, 3), camera at zero angles <- board
    middle_mm: FloatArray  # (3,), middle of the board


def size_of(board: BoardTruth, target: StarTarget) -> tuple[float, float]:
    """Return width and height of a board; of a star target, of what a random placement keeps in view."""
    if board.kind == "stars":
        side = target.pitch_mm * (target.tag_squares + _AROUND_TAG)
        return side, side
    columns = 2 * board.columns - 1 if board.kind == "asymmetric-circles" else board.columns - 1
    around = 2.0 * (
        board.margin_mm + (board.pitch_mm if board.kind == "checkerboard" else 0.5 * board.dot_mm)
    )
    return board.pitch_mm * columns + around, board.pitch_mm * (board.rows - 1) + around


def check_placements(board: BoardTruth) -> None:
    """Check that the board stands wholly before the camera, and fits into the picture where it is placed at random."""
    half = 0.5 * np.asarray([*board.size_mm, 0.0]) * _CORNERS
    for index, one in enumerate(board.placements):
        depth = half @ _matrix(np.asarray(one.turn_deg))[2] + one.position_mm[2]
        if depth.min() < _NEAREST_MM:
            raise ConfigError(
                f"A corner of the board would stand {depth.min():.0f} mm in front of the lens.",
                where=f"board.placements[{index}]",
                remedy="Put the board further away, or turn it less.",
            )
    left, top, right, bottom = (_VIEW * t * board.anywhere.distance_mm for t in board.field_tangents)
    width, height = board.size_mm
    if not board.placements and (width > right - left or height > bottom - top):
        nearest = board.anywhere.distance_mm * max(width / (right - left), height / (bottom - top))
        raise ConfigError(
            f"The board of {width:.0f} x {height:.0f} mm does not fit into the picture.",
            where="board.anywhere.distance_mm",
            remedy=f"Give at least {math.ceil(1.2 * nearest / 10.0) * 10:.0f}, or a list of placements.",
        )


def placement(board: BoardTruth) -> Placement:
    """Return the present placement as the script has it, or as drawn, without the hand's scatter and shaking."""
    number = board.state.number
    if board.placements:
        return board.placements[(number - 1) % len(board.placements)]
    return _drawn(board, np.random.default_rng((board.seed, _ANYWHERE, number)))


def pose(board: BoardTruth) -> BoardPose:
    """Return where the board stands now.

    Own rule: the hand's scatter, what a person did since, and the shaking are rotations about the board's middle and
    displacements, all along the camera's axes at zero angles.
    """
    placed, hand, state = placement(board), board.hand, board.state
    drawn = np.random.default_rng((board.seed, _SCATTER, state.number)).normal(size=6)
    rotation = (
        _matrix(np.asarray(board.shake[3:]))
        @ _matrix(np.asarray(state.turn_deg))
        @ _matrix(hand.scatter_deg * drawn[3:])
        @ _matrix(np.asarray(placed.turn_deg))
    )
    middle = np.asarray(placed.position_mm) + hand.scatter_mm * drawn[:3] + state.move_mm + board.shake[:3]
    return BoardPose(rotation, np.asarray(middle, np.float64))


def is_flickering(board: BoardTruth) -> bool:
    """Return whether the board's light flickers, which the placement or a person may deny."""
    return board.state.flicker and placement(board).flicker


def second_mm(board: BoardTruth) -> FloatArray | None:
    """Return where a second board lies from the first one, in the camera's axes at zero angles; None if it is alone."""
    given = board.state.second_mm or placement(board).second_mm
    return None if given is None else np.asarray(given, np.float64)


def placement_record(board: BoardTruth) -> dict[str, Any]:
    """Return the present placement as plain numbers, for ``truth.json``.

    These are ``number``, ``position_mm`` and ``turn_deg`` with the hand's scatter but without its shaking, ``flicker``
    and ``second_mm``.
    """
    rotation, middle = pose(board)
    second = second_mm(board)
    return {
        "number": board.state.number,
        "position_mm": middle.tolist(),
        "turn_deg": _vector_deg(rotation),
        "flicker": is_flickering(board),
        "second_mm": None if second is None else second.tolist(),
    }


class HandShake:
    """The shaking of a hand in a recording: six motions by spectral representation (Shinozuka and Deodatis, 1991)."""

    def __init__(self, hand: HandTruth, rng: np.random.Generator) -> None:
        self._rms = np.repeat([hand.shake_mm, hand.shake_deg], 3)
        self._hz = _drawn_frequencies(hand.shake_spectrum, rng, (6, _WAVES))
        self._phases = rng.random((6, _WAVES))

    def at(self, t_s: float) -> Shake:
        """Return the displacement at a time: three mm and three degrees, as `BoardTruth.shake`."""
        waves = np.sin(2.0 * math.pi * (self._hz * t_s + self._phases)).sum(axis=1) * math.sqrt(2.0 / _WAVES)
        x, y, z, a, b, c = (self._rms * waves).tolist()
        return x, y, z, a, b, c


def _drawn_frequencies(
    spectrum: tuple[tuple[float, float], ...], rng: np.random.Generator, shape: tuple[int, int]
) -> FloatArray:
    """Draw frequencies whose density is the spectrum's power density, one from each of equal shares of the power."""
    hz, density = np.asarray(spectrum, np.float64).T
    fine = np.unique(np.concatenate([np.linspace(hz[0], hz[-1], 2001), hz]))
    power = np.interp(fine, hz, density)
    below = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(fine))])
    shares = (np.arange(shape[1]) + rng.random(shape)) / shape[1]
    return np.asarray(np.interp(shares * below[-1], below, fine))


def _drawn(board: BoardTruth, rng: np.random.Generator) -> Placement:
    """Draw a placement with the whole board in view; if none is found, one in the middle that faces the camera."""
    chosen = board.anywhere
    left, top, right, bottom = (_VIEW * t for t in board.field_tangents)
    half = 0.5 * np.asarray([*board.size_mm, 0.0])
    corners = half * _CORNERS
    for _ in range(_MOST_DRAWS):
        distance = chosen.distance_mm * (1.0 + chosen.distance_spread * rng.uniform(-1.0, 1.0))
        around, tilt = 2.0 * math.pi * rng.random(), chosen.tilt_deg * math.sqrt(rng.random())
        roll = _matrix(np.array([0.0, 0.0, chosen.roll_deg * rng.uniform(-1.0, 1.0)]))
        rotation = _matrix(tilt * np.array([math.cos(around), math.sin(around), 0.0])) @ roll
        tangents = np.array([rng.uniform(left, right), rng.uniform(top, bottom), 1.0])
        middle = distance * tangents
        seen = corners @ rotation.T + middle
        x, y = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
        if x.min() > left and x.max() < right and y.min() > top and y.max() < bottom and seen[:, 2].min() > 0:
            break
    else:
        middle, rotation = np.array([0.5 * (left + right), 0.5 * (top + bottom), 1.0]) * distance, np.eye(3)
    x_mm, y_mm, z_mm = middle.tolist()
    a, b, c = _vector_deg(rotation)
    return Placement((x_mm, y_mm, z_mm), (a, b, c))


def _matrix(vector_deg: FloatArray) -> FloatArray:
    """Return the rotation matrix of a rotation vector."""
    import cv2  # a plan, which only reads the configuration, needs none

    return np.asarray(cv2.Rodrigues(np.radians(np.asarray(vector_deg, np.float64)))[0], np.float64)


def _vector_deg(rotation: FloatArray) -> list[float]:
    """Return the rotation vector of a rotation matrix."""
    import cv2

    found: list[float] = np.degrees(np.asarray(cv2.Rodrigues(rotation)[0]).ravel()).tolist()
    return found
