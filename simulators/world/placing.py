"""Where the board stands: by the script or at random, scattered by a person's hand, and shaken by it.

Frames: camera's axes at zero angles, X right, Y down, Z away, mm. A pose is the board's rotation and the place of its
middle. The same seed and number give the same placement.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.errors import ConfigError
from simulators.world.board_truth import Anywhere, BoardTruth, HandTruth, Placement
from simulators.world.truth import CameraTruth, Truth

FloatArray = NDArray[np.float64]

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


class View(NamedTuple):
    """The camera's field of view, for random placements."""

    tangents: tuple[float, float, float, float]  # Tangents of the field's left, upper, right and lower edge
    board_mm: tuple[float, float]


class BoardPose(NamedTuple):
    """Pose of the board."""

    rotation: FloatArray  # (3, 3), camera at zero angles <- board
    middle_mm: FloatArray  # (3,), middle of the board


def field_tangents(camera: CameraTruth) -> tuple[float, float, float, float]:
    """Return the tangents of the edges of a camera's field of view, without the lens's distortion."""
    return (
        (-0.5 - camera.cx) / camera.fx,
        (-0.5 - camera.cy) / camera.fy,
        (camera.width - 0.5 - camera.cx) / camera.fx,
        (camera.height - 0.5 - camera.cy) / camera.fy,
    )


def view_of(truth: Truth) -> View:
    """Return the camera's field of view, and the size of the board in it."""
    board = truth.board
    if board.kind == "stars":
        side = truth.target.pitch_mm * (truth.target.tag_squares + _AROUND_TAG)
        return View(board.field_tangents, (side, side))
    columns = 2 * board.columns - 1 if board.kind == "asymmetric-circles" else board.columns - 1
    around = 2.0 * (
        board.margin_mm + (board.pitch_mm if board.kind == "checkerboard" else 0.5 * board.dot_mm)
    )
    size = (board.pitch_mm * columns + around, board.pitch_mm * (board.rows - 1) + around)
    return View(board.field_tangents, size)


def check_placements(truth: Truth) -> None:
    """Check that the board can stand where it shall.

    Raises ConfigError: If a placement of the script reaches behind the camera, or the board does not fit into
      the picture where it is to be placed at random.
    """
    board, view = truth.board, view_of(truth)
    if not board.present:
        return
    half = 0.5 * np.asarray([*view.board_mm, 0.0]) * _CORNERS
    for index, one in enumerate(board.placements):
        depth = half @ _matrix(np.asarray(one.turn_deg))[2] + one.position_mm[2]
        if depth.min() < _NEAREST_MM:
            raise ConfigError(
                f"A corner of the board would stand {depth.min():.0f} mm in front of the lens.",
                where=f"board.placements[{index}]",
                remedy="Put the board further away, or turn it less.",
            )
    left, top, right, bottom = (_VIEW * t * board.anywhere.distance_mm for t in view.tangents)
    width, height = view.board_mm
    if not board.placements and (width > right - left or height > bottom - top):
        nearest = board.anywhere.distance_mm * max(width / (right - left), height / (bottom - top))
        raise ConfigError(
            f"The board of {width:.0f} x {height:.0f} mm does not fit into the picture.",
            where="board.anywhere.distance_mm",
            remedy=f"Give at least {math.ceil(1.2 * nearest / 10.0) * 10:.0f}, or a list of placements.",
        )


def placement(board: BoardTruth, view: View) -> Placement:
    """Return the present placement as the script has it, or as it was drawn.

    Returns: Without the scatter and the shaking of the hand.
    """
    number = board.state.number
    if board.placements:
        return board.placements[(number - 1) % len(board.placements)]
    return _drawn(board.anywhere, view, np.random.default_rng((board.seed, _ANYWHERE, number)))


def pose(board: BoardTruth, view: View) -> BoardPose:
    """Return where the board stands now.

    Own rule: the hand's scatter, what a person did since, and the shaking are rotations about the board's middle and
    displacements, all along the camera's axes at zero angles.
    """
    placed, hand, state = placement(board, view), board.hand, board.state
    drawn = np.random.default_rng((board.seed, _SCATTER, state.number)).normal(size=6)
    rotation = (
        _matrix(np.asarray(board.shake[3:]))
        @ _matrix(np.asarray(state.turn_deg))
        @ _matrix(hand.scatter_deg * drawn[3:])
        @ _matrix(np.asarray(placed.turn_deg))
    )
    middle = np.asarray(placed.position_mm) + hand.scatter_mm * drawn[:3] + state.move_mm + board.shake[:3]
    return BoardPose(rotation, np.asarray(middle, np.float64))


def flickers(board: BoardTruth, view: View) -> bool:
    """Return whether the board's light flickers.

    Returns: False if the placement or a person says so.
    """
    return board.state.flicker and placement(board, view).flicker


def second_mm(board: BoardTruth, view: View) -> FloatArray | None:
    """Return where a second board lies from the first one.

    Returns: In the camera's axes at zero angles; None if there is one board.
    """
    given = board.state.second_mm or placement(board, view).second_mm
    return None if given is None else np.asarray(given, np.float64)


def record(board: BoardTruth, view: View) -> dict[str, Any]:
    """Return the present placement as plain numbers, for ``truth.json``.

    Returns: ``number``, ``position_mm`` and ``turn_deg`` with the hand's scatter but without its shaking,
      ``flicker`` and ``second_mm``.
    """
    rotation, middle = pose(board, view)
    second = second_mm(board, view)
    return {
        "number": board.state.number,
        "position_mm": middle.tolist(),
        "turn_deg": np.degrees(np.asarray(cv2.Rodrigues(rotation)[0]).ravel()).tolist(),
        "flicker": flickers(board, view),
        "second_mm": None if second is None else second.tolist(),
    }


class HandShake:
    """The shaking of a hand during one recording: six independent motions of the same spectrum.

    Sum of waves of random frequency and phase: the spectral representation of Shinozuka and Deodatis (1991).
    """

    def __init__(self, hand: HandTruth, rng: np.random.Generator) -> None:
        self._rms = np.repeat([hand.shake_mm, hand.shake_deg], 3)
        self._hz = _drawn_frequencies(hand.shake_spectrum, rng, (6, _WAVES))
        self._phases = rng.random((6, _WAVES))

    def at(self, t_s: float) -> tuple[float, float, float, float, float, float]:
        """Return the displacement at a time.

        t_s: Time since the recording's start.
        Returns: Three mm and three degrees, as `BoardTruth.shake`.
        """
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


def _drawn(chosen: Anywhere, view: View, rng: np.random.Generator) -> Placement:
    """Draw a placement with the whole board in view; if none is found, one in the middle that faces the camera."""
    left, top, right, bottom = (_VIEW * t for t in view.tangents)
    half = 0.5 * np.asarray([*view.board_mm, 0.0])
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
    a, b, c = np.degrees(np.asarray(cv2.Rodrigues(rotation)[0]).ravel()).tolist()
    return Placement((x_mm, y_mm, z_mm), (a, b, c))


def _matrix(vector_deg: FloatArray) -> FloatArray:
    """Return the rotation matrix of a rotation vector."""
    return np.asarray(cv2.Rodrigues(np.radians(np.asarray(vector_deg, np.float64)))[0], np.float64)
