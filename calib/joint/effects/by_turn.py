"""Errors that follow the turn of the camera: its pupil moves through the beam, and sees the glass elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import ClassVar

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.effects.collimator import POSE_ROW
from calib.joint.effects.effect import Effect, Places, RandomBlock, Row, Turned
from calib.joint.fields import COEFFICIENTS, DEGREES, both, of_degree
from calib.model import result_parts as rows

#: Defocus times how far the pupil is beside the pivot along the camera's x and y axes, as a share of the radius. The
#: image is shifted along these axes. When the camera turns, the pupil moves along the beam, which changes the radius.
ASIDE = ("aside_x", "aside_y")
#: Sizes of radial terms about a shifted axis (`FieldBasis.about_shifted_axis`) for a pupil that moves aside, as 40
#: ray-traced collimators have them: field curvature, and less astigmatism.
_CURVATURE_SIZES = (1.0, 0.25)
#: A pupil that is beside the axis at turn 0 sees the coma of `amp.SCALE_TURN_2` by turn too, so many times as large:
#: twice its place over what a turn of `amp.UNIT_TURN` moves it, with `amp.LEVER`. Visible discs show where the axis is.
_BESIDE, _BESIDE_DISC = 10.0, 2.0
#: Where the fields by turn follow a pupil that is moved by hand, what differs from pose to pose may still change
#: smoothly with the turn, in the degrees that imitate another focal length. If the poses turn by `amp.UNIT_TURN`, the
#: part of a random function that is linear in the turn is so many times as large as the rest, which the own fields are.
#: It bends: beyond, what is linear falls with the root of the turn, and its slope with the power 1.5.
_SMOOTH_PLACES, _SMOOTH = both((DEGREES > 0) & (DEGREES <= 2)), 1.8
#: Parallax by turn (`Parallax`): one size, alike along both axes but for a fifth in all ways.
PARALLAX_SHAPES = np.column_stack([np.sqrt(0.08) * np.eye(4), np.sqrt(0.96) * np.array([1.0, 0.0, 0.0, 1.0])])
_ONCE = {"turn_x": (1, 0), "turn_y": (0, 1)}
TURN_ROW = Row(rows.TURN_FIELDS, "A", "residuals that follow the turn")
_UNBOUNDED = Row(rows.UNBOUNDED_PARALLAX, "B", "not stated; its size follows from the collimator's errors")


def products(turns: Array, powers: Places) -> Array:
    """Return (n, Q) the products of (n, 2) turns to (Q, 2) powers, in units of `amp.UNIT_TURN`."""
    return np.asarray(np.prod((turns[:, None] / amp.UNIT_TURN) ** powers, axis=2))


def slopes(turns: Array, powers: Places) -> Array:
    """Return (n, 2, Q) derivatives of `products` by the turns."""
    less = np.maximum(powers - np.eye(2, dtype=np.int64)[:, None], 0)
    factors = np.prod((turns[:, None, None] / amp.UNIT_TURN) ** less, axis=3)
    return np.asarray(powers.T / amp.UNIT_TURN * factors)


class _TurnField(Effect):
    """Coefficients of a field that are multiplied by products of the turns along X and Y."""

    products_of_turns: ClassVar[Mapping[str, tuple[int, int]]] = _ONCE  # Powers by the begin of the names

    @property
    def coefficients(self) -> Places:
        """Places in a field."""
        raise NotImplementedError

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{turn}_{k}" for turn in self.products_of_turns for k in self.coefficients)

    @property
    def rows(self) -> Places:
        """(Q,) places of the coefficients in a pose's basis."""
        return np.tile(self.pose.field.start + self.coefficients, len(self.products_of_turns))

    @property
    def powers(self) -> Places:
        """(Q, 2) of the turns along X and Y."""
        return np.repeat(list(self.products_of_turns.values()), len(self.coefficients), axis=0)

    @property
    def degrees(self) -> Places:
        """(Q,) of the polynomials."""
        return np.tile(np.tile(DEGREES, 2)[self.coefficients], len(self.products_of_turns))

    def fill(self, columns: Array, poses: Turned) -> None:
        columns[:, self.rows, range(len(self.rows))] = products(self.followed(poses), self.powers)

    def followed(self, poses: Turned) -> Array:
        """Return the (n, 2) turns that the field follows."""
        return poses.pupils


class FollowsPupil(_TurnField):
    """A field that follows the pupil. If a hand moves that, its places are unknown (`calib.joint.places`)."""


class Parallax(FollowsPupil):
    """A pupil off the pivot, before a collimator out of focus: the image is shifted by turn.

    X by the turn along X, Y by it, X by the turn along Y, Y by that.
    """

    @property
    def coefficients(self) -> Places:
        return np.array([0, COEFFICIENTS // 2])

    def priors(self) -> Sequence[RandomBlock]:
        if self.bench.parallax_known:
            return ()
        return [RandomBlock(_UNBOUNDED, self.names, ((amp.PARALLAX, amp.UNIT_TURN * PARALLAX_SHAPES),))]


class GimbalParallax(Parallax):
    """The same on a gimbal: a pupil before the pivot also moves back along the beam."""

    def fill(self, columns: Array, poses: Turned) -> None:
        super().fill(columns, poses)
        back = self.pose.fields.reference[2] * (poses.cosines - 1.0) / amp.UNIT_TURN
        columns[:, self.pose.radius, [0, 3]] = 0.5 * back[:, None]


class ByTurn(FollowsPupil):
    """Aberrations that move with the pupil."""

    @property
    def coefficients(self) -> Places:
        return both((DEGREES > 0) & (self._highest >= DEGREES))

    @property
    def _highest(self) -> int:
        return amp.TURN_DEGREES[self.bench.pupil][0]

    def priors(self) -> Sequence[RandomBlock]:
        """Return a random field of each degree, field curvature, and coma of a pupil beside the axis.

        Field curvature and astigmatism, seen by a pupil that moves aside, have an amplitude of their own: they are
        30 times larger than the others, and can be exchanged against fx. So has coma, which can be exchanged against
        p1, p2 and, with these, the principal point.
        """
        basis, places = self.pose.fields, self.coefficients
        parts = [(amp.TURN[d - 1], of_degree(self.degrees, d)) for d in range(1, self._highest + 1)]
        shifted = basis.about_shifted_axis(_CURVATURE_SIZES)[places]
        parts.append((amp.CURVATURE_TURN, np.concatenate(np.hsplit(shifted, 2))))
        x, y = np.eye(2)
        coma = [
            np.concatenate([basis.shape(partial(_coma, e, turn))[places] for turn in (x, y)]) for e in (x, y)
        ]
        size = (_BESIDE_DISC if self.pose.about_disc else _BESIDE) / self.bench.far
        parts.append((amp.SCALE_TURN_2, size * np.column_stack(coma)))
        return [RandomBlock(TURN_ROW, self.names, tuple(parts))]

    def on_axis(self, turn: str, axis: int, times: float = 1.0) -> dict[str, float]:
        """Return what each coefficient by turn adds to the shift of the axis along X or Y, for a turn of 1.

        Field curvature adds to the shift elsewhere. The coefficients of degree 0 are those of `Parallax`.
        """
        basis = self.pose.fields
        values = basis.polynomials(np.array([basis.reference[:2]]))[0] * times / amp.UNIT_TURN
        return {
            f"{turn}_{axis * len(values) + k}": float(values[k])
            for k in np.flatnonzero(self._highest >= DEGREES)
        }


class ByTurnSquared(FollowsPupil):
    """Products of two small effects."""

    products_of_turns: ClassVar[Mapping[str, tuple[int, int]]] = {
        "turn_xx": (2, 0),
        "turn_xy": (1, 1),
        "turn_yy": (0, 2),
    }

    @property
    def coefficients(self) -> Places:
        return both(amp.TURN_DEGREES[self.bench.pupil][1] >= DEGREES)

    def priors(self) -> Sequence[RandomBlock]:
        """Return a random field of each degree, and the coma of round glass, |t|^2 h + 2 (t h) t."""
        parts = [(amp.TURN_2[d], of_degree(self.degrees, d)) for d in range(int(self.degrees.max()) + 1)]
        x, y = np.eye(2)
        pairs = ((x, x), (x, 2.0 * y), (y, y))  # By the products of the turns along X and Y
        coma = [self.pose.fields.shape(partial(_coma, *pair))[self.coefficients] for pair in pairs]
        parts.append((amp.SCALE_TURN_2, np.concatenate(coma)[:, None]))
        return [RandomBlock(TURN_ROW, self.names, tuple(parts))]


class OwnByTurn(_TurnField):
    """The part of the poses' own fields that changes smoothly with the turn, where a hand moves the pupil."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"own_{name}" for name in super().names)

    @property
    def coefficients(self) -> Places:
        return _SMOOTH_PLACES

    def followed(self, poses: Turned) -> Array:
        return poses.turns

    def priors(self) -> Sequence[RandomBlock]:
        """Return the part: it has the amplitudes of the own fields."""
        size = _SMOOTH * (amp.UNIT_TURN / max(self.bench.reach, amp.UNIT_TURN)) ** 1.5
        parts = [(amp.POSE[d - 1], size * of_degree(self.degrees, d)) for d in np.unique(self.degrees)]
        return [RandomBlock(POSE_ROW, self.names, tuple(parts))]


class Along(Effect):
    """An own radius of each pose: a hand also moves the pupil along the axis, before a collimator out of focus."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"along_{pose}" for pose in range(self.bench.n_poses))

    def fill(self, columns: Array, poses: Turned) -> None:
        columns[:, self.pose.radius] = self.pose.fields.reference[2] * np.eye(len(columns))

    def priors(self) -> Sequence[RandomBlock]:
        return [RandomBlock(POSE_ROW, self.names, ((amp.ALONG, np.eye(len(self.names))),))]


class Aside(Effect):
    """A pupil beside the axes about which the camera turns: it moves along the beam."""

    names = ASIDE

    def fill(self, columns: Array, poses: Turned) -> None:
        moved = (poses.axes @ poses.turns[:, :, None])[:, :, 0] * poses.cosines[:, None]
        columns[:, self.pose.radius] = self.pose.fields.reference[2] * moved

    def priors(self) -> Sequence[RandomBlock]:
        """Return what is expected; it counts together with what a station states: else U of cx would grow by that."""
        row = Row(rows.PARALLAX, "B") if self.bench.parallax_known else _UNBOUNDED
        return [RandomBlock(row, ASIDE, ((amp.ASIDE, np.eye(len(ASIDE))),))]


class GimbalAside(Aside):
    """The same on a gimbal, where the image is shifted along the camera's axes, too."""

    def fill(self, columns: Array, poses: Turned) -> None:
        super().fill(columns, poses)
        columns[:, self.pose.shifts] = -np.swapaxes(poses.axes, 1, 2)


class CurvatureAside(Effect):
    """Field curvature and astigmatism that a pupil beside the axis sees: it is beside in directions of the camera.

    If the camera rolls, they turn with it over the target. Without them cx, or p1 and p2, would take them.
    """

    names = ("curvature_x", "curvature_y", "astigmatism_x", "astigmatism_y")

    def fill(self, columns: Array, poses: Turned) -> None:
        for k, shape in enumerate((_curvature, _astigmatism)):
            for axis, e in enumerate(poses.axes.swapaxes(0, 1)):
                columns[:, self.pose.field, 2 * k + axis] = self.pose.fields.shape(partial(shape, e))

    def priors(self) -> Sequence[RandomBlock]:
        sizes = np.diag(np.repeat(_CURVATURE_SIZES, 2))
        return [RandomBlock(TURN_ROW, self.names, ((amp.CURVATURE_ASIDE, sizes),))]


def _curvature(aside: Array, h: Array) -> Array:
    """Return (n, N, 2) the fields |h|^2 e. h: (N, 2)."""
    return np.asarray((h * h).sum(axis=1, keepdims=True) * aside[:, None])


def _astigmatism(aside: Array, h: Array) -> Array:
    """Return (n, N, 2) the fields (h e) h. h: (N, 2)."""
    return np.asarray((h @ aside[:, :, None]) * h)


def _coma(aside: Array, turn: Array, h: Array) -> Array:
    """Return the field (e h) t + (e t) h + (h t) e: coma, by a turn t, for a pupil beside the axis by e. h: (N, 2)."""
    return (h @ aside)[:, None] * turn + float(aside @ turn) * h + (h @ turn)[:, None] * aside
