"""The shared unknowns: their names, what each does to a pose's image, and which of them have an amplitude.

A pose sees the shared unknowns b through its own basis: camera, radius and the coefficients of one field,
c_i = T_i b. The field of pose i is common + turn x field by turn + turn^2 x field by turn squared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.fields import COEFFICIENTS, DEGREE, DEGREES, FieldBasis, both
from calib.model import result_parts as rows

Places = NDArray[np.int64]

CENTRE = ("x", "y", "r")
#: Begin of the names of the coefficients of the common field.
FIELD = "common_"
RADIAL = ("radial", "radial_4")
#: Errors |x|^2 e of the image that turn with the camera: thin prism distortion of the lens (Weng et al., 1992), or what
#: misaligned collimators do to a pupil that turns. Without them p1 and p2 would take these, and move cx and cy.
PRISM = ("prism_x", "prism_y")
#: Errors (x e) x of the image: with the prism terms the decentring of a lens whose family has no p1 and p2, a fisheye.
DECENTRING = ("decentring_x", "decentring_y")
#: Displacements rho^4 g and rho^10 g from the middle of a view's visible disc, if it is not where the turn says: g in
#: units of r, rho in radii of the disc. At the rim, the beam fills the camera's pupil only partly.
RIM, RIM_POWERS = ("rim_4", "rim_10"), np.array([4, 10])
#: rim_10 is typically this share of rim_4.
_RIM_RATIO = 0.3
#: They differ from pose to pose by these shares of the amplitude of rim_4.
RIM_OWN = 0.2 * np.array([1.0, _RIM_RATIO])
#: Radial terms of a lens: how far each moves a point at the corner of the sensor, as a share of what the first does.
_LENS_RATIOS = {"k1": 1.0, "k2": 0.4, "k3": 0.15, "kb1": 1.0, "kb2": 0.4, "kb3": 0.15, "kb4": 0.05}
#: Change of the focal length, or of the radius, from the first pose to the last, as a share.
DRIFT = "drift"
#: Defocus times how far the pupil is beside the pivot along the camera's x and y axes, as a share of the radius. The
#: image is shifted along these axes. When the camera turns, the pupil moves along the beam, which changes the radius.
ASIDE = ("aside_x", "aside_y")
#: radial_4 is typically so many times radial.
RADIAL_RATIO = 20.0
#: Typical sizes of what radial terms become about a shifted axis (`FieldBasis.shifted`).
SHIFTED_SIZES = (1.0, 1.0, RADIAL_RATIO, RADIAL_RATIO)
#: The same for a pupil that moves aside, as 40 ray-traced collimators have it: field curvature, and less astigmatism.
_CURVATURE_SIZES = (1.0, 0.25)
#: A pupil that is beside the axis at turn 0 sees the coma of `amp.SCALE_TURN_2` by turn too, so many times as large:
#: twice its place over what a turn of `amp.UNIT_TURN` moves it, with `amp.LEVER`. Visible discs show where the axis is.
_BESIDE, _BESIDE_DISC = 10.0, 2.0
#: Change of scale that comes with radial errors, as a share of what they do at the edge of the field.
_RADIAL_SCALE = 0.06
ECCENTRICITY = tuple(
    f"eccentricity_{axis}_{part}" for axis in ("pan", "tilt", "roll") for part in ("sin", "cos")
)
#: What an unknown of the collimator has become since its passport, less what that states.
CHANGE = "change of {}"
#: Begin of the names of `Layout.encoders`.
ENCODER = "encoder"
#: Products of the turns along X and Y, with the highest degree of their fields.
_TURNS = {"turn_x": (1, 0), "turn_y": (0, 1)}
_TURNS_2 = {"turn_xx": (2, 0), "turn_xy": (1, 1), "turn_yy": (0, 2)}
#: The degrees of a pose's own field.
POSE_DEGREES = (1, amp.POSE_DEGREE)
POSE_PLACES = both((POSE_DEGREES[0] <= DEGREES) & (POSE_DEGREES[1] >= DEGREES))
#: Where the fields by turn follow a pupil that is moved by hand, what differs from pose to pose may still change
#: smoothly with the turn, in the degrees that imitate another focal length. If the poses turn by `amp.UNIT_TURN`, the
#: part of a random function that is linear in the turn is so many times as large as the rest, which the own fields are.
#: It bends: beyond, what is linear falls with the root of the turn, and its slope with the power 1.5.
_SMOOTH_PLACES, _SMOOTH = both((DEGREES > 0) & (DEGREES <= 2)), 1.8


@dataclass(frozen=True)
class RandomBlock:
    """Unknowns with the prior covariance diag(stated) + sum_j a_j^2 U_j U_j^T."""

    group: str  # The row of the budget that it belongs to
    places: Places  # (K,) of the shared unknowns
    parts: tuple[tuple[int, Array], ...]  # For each amplitude its place and (K, M) its U_j
    stated: Array | float = 0.0  # (K,) variances that a station states


@dataclass(frozen=True)
class TurnFields:
    """The coefficients of the Q fields that follow the turn."""

    rows: Places  # (Q,) places in a pose's basis
    columns: Places  # (Q,) of the shared unknowns
    powers: Places  # (Q, 2) of the turns along X and Y

    def sizes(self, turns: Array) -> Array:
        """Return (n, Q) factors of the fields at (n, 2) turns."""
        return np.asarray(np.prod((turns[:, None] / amp.UNIT_TURN) ** self.powers, axis=2))

    def slopes(self, turns: Array) -> Array:
        """Return (n, 2, Q) derivatives of the factors by the (n, 2) turns."""
        less = np.maximum(self.powers - np.eye(2, dtype=np.int64)[:, None], 0)
        factors = np.prod((turns[:, None, None] / amp.UNIT_TURN) ** less, axis=3)
        return np.asarray(self.powers.T / amp.UNIT_TURN * factors)


@dataclass(frozen=True)
class Layout:
    """Names and places of the S shared unknowns."""

    camera: tuple[str, ...]
    basis: FieldBasis
    terms: Mapping[str, Array]  # Type B terms by name: (2 K,) field of a unit
    gimbal: tuple[str, ...]  # Names of the gimbal's unknowns; empty without readings
    wavefront: float = 0.0  # RMS slope of the collimator's wavefront that a station states, rad
    pupil: amp.Pupil = amp.Pupil.HELD
    n_poses: int = 1  # Each has its own radius if a hand moves the camera
    passport: tuple[str, ...] = ()  # Names of the shared unknowns that a passport states

    @property
    def rim(self) -> tuple[str, ...]:
        """Names of the displacements about the visible discs."""
        return () if self.pupil is amp.Pupil.HELD else RIM

    @property
    def by_hand(self) -> bool:
        """Whether the fields by turn follow a pupil that is moved by hand."""
        return self.pupil is amp.Pupil.BY_HAND

    @property
    def along(self) -> tuple[str, ...]:
        """Names of the own radii of the poses, as shares of r. A hand also moves the pupil along the axis."""
        return tuple(f"along_{pose}" for pose in range(self.n_poses)) if self.by_hand else ()

    @property
    def encoders(self) -> tuple[str, ...]:
        """Names of what an encoder is off at an angle that several views have."""
        return tuple(name for name in self.gimbal if name.startswith(ENCODER))

    @cached_property
    def common(self) -> Places:
        """Places in a field of the coefficients that all poses share: all but those of degree 0, a shift."""
        return both(DEGREES > 0)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all shared unknowns."""
        fields = [f"{FIELD}{k}" for k in self.common]
        for turns, degree in zip((_TURNS, _TURNS_2), amp.TURN_DEGREES[self.pupil], strict=True):
            fields += [f"{name}_{k}" for name in turns for k in both(degree >= DEGREES)]
        if self.by_hand:
            fields += [f"own_{name}_{k}" for name in _TURNS for k in _SMOOTH_PLACES]
        errors = (*RADIAL, *self.turning, DRIFT, *ASIDE, *self.rim, *self.along, *fields, *self.terms)
        errors += tuple(CHANGE.format(name) for name in self.passport)
        return (*self.camera, *CENTRE, *errors, *self.gimbal)

    @cached_property
    def turning(self) -> tuple[str, ...]:
        """Names of the errors that turn with the camera."""
        return PRISM if "p1" in self.camera else (*PRISM, *DECENTRING)

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Place of each name."""
        return {name: k for k, name in enumerate(self.names)}

    def places(self, names: Sequence[str]) -> Places:
        """Return the places of names."""
        return np.array([self.index[name] for name in names], np.int64)

    @property
    def size(self) -> int:
        """Number of entries of a pose's basis: camera, radius, rim, one field, and the middle of the disc."""
        return self.middle + 2 * bool(self.rim)

    @property
    def middle(self) -> int:
        """Place of the disc's middle in a pose's basis."""
        return self.field + COEFFICIENTS

    @property
    def field(self) -> int:
        """Place of the field in a pose's basis."""
        return len(self.camera) + 1 + len(self.rim)

    @cached_property
    def pose_places(self) -> Places:
        """Places of a pose's own field in its basis, its rim, its disc's middle."""
        rims = np.arange(self.field - len(self.rim), self.field)
        return np.concatenate([POSE_PLACES + self.field, rims, np.arange(self.middle, self.size)])

    def maps(self, turns: Array, axes: Array, pupils: Array) -> Array:
        """Return (n, B, S) what the shared unknowns do to the bases of n poses.

        turns: (n, 2) tangents of the turns along X and Y. axes: (n, 2, 2) the camera's x and y axes on the target.
        pupils: (n, 2) what the fields by turn follow: the sines of the turns, or the places of a pupil that is moved by
          hand.
        """
        k, r_mm = len(self.camera), self.basis.reference[2]
        cosines = 1.0 / np.sqrt(1.0 + (turns**2).sum(axis=1))
        found = np.zeros((len(turns), self.size, len(self.names)))
        found[:, range(k), range(k)] = 1.0
        found[:, k, self.index["r"]] = 1.0
        aside = self.places(ASIDE)
        found[:, k, aside] = r_mm * (axes @ turns[:, :, None])[:, :, 0] * cosines[:, None]
        if self.by_hand:
            found[:, k, self.places(self.along)] = r_mm * np.eye(len(turns))
        found[:, range(k + 1, self.field), self.places(self.rim)] = 1.0
        field, half = self.field, COEFFICIENTS // 2
        if not self.by_hand:
            found[:, field, aside], found[:, field + half, aside] = -axes[:, :, 0], -axes[:, :, 1]
        found[:, field, self.index["x"]] = found[:, field + half, self.index["y"]] = -1.0 / r_mm
        found[:, field : self.middle, self.places(RADIAL)] = self.basis.radial
        found[:, field + self.common, self.places([f"{FIELD}{j}" for j in self.common])] = 1.0
        by_turn = self.by_turn
        found[:, by_turn.rows, by_turn.columns] = by_turn.sizes(pupils)
        if not self.by_hand:  # a pupil before the pivot also moves back along the beam
            back = r_mm * (cosines - 1.0) / amp.UNIT_TURN
            found[:, k, self.parallax[[0, 3]]] = 0.5 * back[:, None]
        if self.by_hand:
            found[:, self.own_by_turn.rows, self.own_by_turn.columns] = self.own_by_turn.sizes(turns)
        times = np.linspace(-0.5, 0.5, len(turns)) if len(turns) > 1 else np.zeros(1)
        for pose, (turn, across) in enumerate(zip(turns, axes, strict=True)):
            found[pose, field : self.middle, self.index[DRIFT]] = times[pose] * self.basis.shape(
                partial(_scale, turn)
            )
            for name in self.turning:
                own = _prism if name in PRISM else _decentring
                axis = across[0] if name.endswith("x") else across[1]
                found[pose, field : self.middle, self.index[name]] = self.basis.shape(
                    partial(own, turn, axis)
                )
        for name, shape in self.terms.items():
            found[:, field : self.middle, self.index[name]] = shape
        return found

    @cached_property
    def by_turn(self) -> TurnFields:
        """The fields that follow the turn."""
        parts = []
        for names, degree in zip((_TURNS, _TURNS_2), amp.TURN_DEGREES[self.pupil], strict=True):
            places = both(degree >= DEGREES)
            parts += [self._turned(name, powers, places) for name, powers in names.items()]
        return TurnFields(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    @cached_property
    def own_by_turn(self) -> TurnFields:
        """The part of the poses' own fields that changes smoothly with the turn."""
        parts = [self._turned(f"own_{name}", powers, _SMOOTH_PLACES) for name, powers in _TURNS.items()]
        return TurnFields(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def _turned(self, name: str, powers: tuple[int, int], places: Places) -> tuple[Places, Places, Places]:
        """Return rows, columns and powers of one field, as `TurnFields`."""
        columns = self.places([f"{name}_{j}" for j in places])
        return self.field + places, columns, np.tile(powers, (len(places), 1))

    def random_blocks(
        self,
        hyper: amp.Hyperprior,
        corner: float,
        reach: float,
        reading_rad: float,
        *,
        parallax_known: bool,
    ) -> list[RandomBlock]:
        """Return the unknowns that have an amplitude.

        ``corner`` is the tangent of the angle between the axis and the sensor's corner. ``reach`` is the largest
        distance of a turn from the mean turn, as a tangent. ``reading_rad`` is the standard uncertainty of a reading.
        """
        decentred = [name for name in ("p1", "p2", *DECENTRING) if name in self.index]
        blocks = [
            RandomBlock(rows.LENS, self.places(names), ((hyper.at(amplitude), np.eye(len(names))),))
            for names, amplitude in ((decentred, amp.TANGENTIAL), (PRISM, amp.PRISM))
        ]
        blocks.append(self._distortion(hyper, corner))
        if not set(self.passport) & set(RADIAL):
            blocks.append(self._radial(hyper))
        if self.rim:
            shape = np.diag([1.0, _RIM_RATIO])
            blocks.append(RandomBlock(rows.TURN_FIELDS, self.places(self.rim), ((hyper.at(amp.RIM), shape),)))
        blocks.append(self._changes(hyper) if self._stated_fields else self._common(hyper))
        if self.encoders:
            own = ((hyper.at(amp.ENCODER), reading_rad * np.eye(len(self.encoders))),)
            blocks.append(RandomBlock(rows.READINGS, self.places(self.encoders), own))
        if not parallax_known:
            blocks.append(self._parallax(hyper))
        # It counts together with what a station states: if that replaced it, U of cx would grow.
        aside = ((hyper.at(amp.ASIDE), np.eye(len(ASIDE))),)
        group = rows.PARALLAX if parallax_known else rows.UNBOUNDED_PARALLAX
        blocks.append(RandomBlock(group, self.places(ASIDE), aside))
        if self.by_hand:
            blocks.append(self._own_by_turn(hyper, reach))
            own = ((hyper.at(amp.ALONG), np.eye(self.n_poses)),)
            blocks.append(RandomBlock(rows.POSE_FIELDS, self.places(self.along), own))
        return [*blocks, self._turn(hyper), self._turn_2(hyper)]

    def _own_by_turn(self, hyper: amp.Hyperprior, reach: float) -> RandomBlock:
        """Return the smooth part of the own fields: it has their amplitudes."""
        size = _SMOOTH * (amp.UNIT_TURN / max(reach, amp.UNIT_TURN)) ** 1.5
        degrees = np.tile(np.tile(DEGREES, 2)[_SMOOTH_PLACES], len(_TURNS))
        names = [f"own_{turn}_{k}" for turn in _TURNS for k in _SMOOTH_PLACES]
        parts = [(hyper.at(amp.POSE[d - 1]), size * _of_degree(degrees, d)) for d in np.unique(degrees)]
        return RandomBlock(rows.POSE_FIELDS, self.places(names), tuple(parts))

    def _distortion(self, hyper: amp.Hyperprior, corner: float) -> RandomBlock:
        """Return the radial terms of the lens: powers of the tangent, or of the angle for a fisheye lens."""
        names = [name for name in self.camera if name in _LENS_RATIOS]
        at_corner = corner if "k1" in names else float(np.arctan(corner))
        sizes = [_LENS_RATIOS[name] * at_corner ** (-2.0 * int(name[-1])) for name in names]
        return RandomBlock(rows.LENS, self.places(names), ((hyper.at(amp.DISTORTION), np.diag(sizes)),))

    def _radial(self, hyper: amp.Hyperprior) -> RandomBlock:
        return RandomBlock(
            rows.COMMON_FIELD, self.places(RADIAL), ((hyper.at(amp.RADIAL), np.diag([1.0, RADIAL_RATIO])),)
        )

    def _common(self, hyper: amp.Hyperprior) -> RandomBlock:
        """Return the common field: a random field of each degree, and radial terms about a shifted axis.

        Radial errors that are no polynomials of the third and fifth order leave a change of scale.
        """
        degrees = np.tile(DEGREES, 2)[self.common]
        shifted = np.column_stack([self.basis.shifted(e, SHIFTED_SIZES) for e in ((1.0, 0.0), (0.0, 1.0))])[
            self.common
        ]
        parts = [(hyper.at(name), _of_degree(degrees, d)) for d, name in enumerate(amp.COMMON, start=1)]
        edge = (self.basis.radius_mm / self.basis.reference[2]) ** 2
        scale = _RADIAL_SCALE * edge * self.basis.shape(np.asarray)[self.common, None]
        names = [f"{FIELD}{k}" for k in self.common]
        waves = self.wavefront**2 / (DEGREE * (degrees + 1.0))
        return RandomBlock(
            rows.COMMON_FIELD,
            self.places(names),
            (*parts, (hyper.at(amp.SHIFTED), shifted), (hyper.at(amp.RADIAL), scale)),
            waves,
        )

    @property
    def _stated_fields(self) -> list[str]:
        """Names of the coefficients of the common field that a passport states."""
        return [name for name in self.passport if name.startswith(FIELD)]

    def _changes(self, hyper: amp.Hyperprior) -> RandomBlock:
        """Return what the common field differs from that of a passport, with one amplitude."""
        names = [CHANGE.format(name) for name in self._stated_fields]
        degrees = np.tile(DEGREES, 2)[self.common]
        sizes = np.array(amp.smooth(1.0, DEGREE))[degrees - 1] / np.sqrt(degrees + 1.0)
        return RandomBlock(rows.PASSPORT, self.places(names), ((hyper.at(amp.CHANGE), np.diag(sizes)),))

    def _parallax(self, hyper: amp.Hyperprior) -> RandomBlock:
        """Return the parallax: alike along X and Y but for a fifth."""
        return RandomBlock(
            rows.UNBOUNDED_PARALLAX,
            self.parallax,
            ((hyper.at(amp.PARALLAX), amp.UNIT_TURN * PARALLAX_SHAPES),),
        )

    @cached_property
    def parallax(self) -> Places:
        """Places of the shift by turn: X by turn_x, Y by turn_x, X by turn_y, Y by turn_y."""
        half = COEFFICIENTS // 2
        return self.places([f"{turn}_{k}" for turn in _TURNS for k in (0, half)])

    def on_axis(self, turn: str, axis: int, times: float = 1.0) -> dict[str, float]:
        """Return what each coefficient of a field by turn adds to the shift of the axis along X or Y, for a turn of 1.

        Field curvature adds to the shift elsewhere.
        """
        values = self.basis.polynomials(np.array([self.basis.reference[:2]]))[0] * times / amp.UNIT_TURN
        named = {f"{turn}_{axis * len(values) + k}": float(value) for k, value in enumerate(values)}
        return {name: value for name, value in named.items() if name in self.index}

    def _turn(self, hyper: amp.Hyperprior) -> RandomBlock:
        """Return the fields by turn of degree 1 and above.

        Field curvature and astigmatism, seen by a pupil that moves aside, have an amplitude of their own: they are
        30 times larger than the others, and can be exchanged against fx. So has coma, which can be exchanged against
        p1, p2 and, with these, the principal point.
        """
        highest = amp.TURN_DEGREES[self.pupil][0]
        places = both((DEGREES > 0) & (highest >= DEGREES))
        degrees = np.tile(np.tile(DEGREES, 2)[places], 2)
        shifted = np.concatenate(
            [self.basis.shifted(e, _CURVATURE_SIZES)[places] for e in ((1.0, 0.0), (0.0, 1.0))]
        )
        parts = [(hyper.at(amp.TURN[d - 1]), _of_degree(degrees, d)) for d in range(1, highest + 1)]
        parts.append((hyper.at(amp.CURVATURE_TURN), shifted))
        beside = [
            np.concatenate([self.basis.shape(partial(_coma, e, turn))[places] for turn in np.eye(2)])
            for e in np.eye(2)
        ]
        size = (_BESIDE_DISC if self.rim else _BESIDE) / hyper.far
        parts.append((hyper.at(amp.SCALE_TURN_2), size * np.column_stack(beside)))
        names = [f"{turn}_{k}" for turn in _TURNS for k in places]
        return RandomBlock(rows.TURN_FIELDS, self.places(names), tuple(parts))

    def _turn_2(self, hyper: amp.Hyperprior) -> RandomBlock:
        """Return the fields by turn squared; the coma of round glass has an amplitude of its own, as in `_turn`."""
        highest = amp.TURN_DEGREES[self.pupil][1]
        places = both(highest >= DEGREES)
        degrees = np.tile(np.tile(DEGREES, 2)[places], len(_TURNS_2))
        parts = [(hyper.at(amp.TURN_2[d]), _of_degree(degrees, d)) for d in range(highest + 1)]
        names = [f"{turn}_{k}" for turn in _TURNS_2 for k in places]
        x, y = np.eye(2)
        # |t|^2 h + 2 (t h) t, by the products of the turns along X and Y
        pairs = ((x, x), (x, 2.0 * y), (y, y))
        coma = [self.basis.shape(partial(_coma, *pair))[places] for pair in pairs]
        parts.append((hyper.at(amp.SCALE_TURN_2), np.concatenate(coma)[:, None]))
        return RandomBlock(rows.TURN_FIELDS, self.places(names), tuple(parts))


#: Parallax by turn (`Layout.parallax`): one size, alike along both axes but for a fifth in all ways.
PARALLAX_SHAPES = np.column_stack([np.sqrt(0.08) * np.eye(4), np.sqrt(0.96) * np.array([1.0, 0.0, 0.0, 1.0])])


def _coma(beside: Array, turn: Array, h: Array) -> Array:
    """Return the field (e h) t + (e t) h + (h t) e: coma, by a turn t, for a pupil beside the axis by e. h: (N, 2)."""
    return (h @ beside)[:, None] * turn + float(beside @ turn) * h + (h @ turn)[:, None] * beside


def _prism(turn: Array, axis: Array, h: Array) -> Array:
    """Return the field |x|^2 e of an image that is turned, on the target. h: (N, 2)."""
    away = h - turn
    return np.asarray((away * away).sum(axis=1, keepdims=True) * axis)


def _scale(turn: Array, h: Array) -> Array:
    """Return the field x of an image that is turned, on the target. h: (N, 2)."""
    return np.asarray(h - turn)


def _decentring(turn: Array, axis: Array, h: Array) -> Array:
    """Return the field 2 (x e) x of an image that is turned, on the target. h: (N, 2)."""
    away = h - turn
    return np.asarray(2.0 * (away @ axis)[:, None] * away)


def _of_degree(degrees: Places, degree: int) -> Array:
    """Return the unit vectors of the coefficients of one degree, scaled so that the field's mean square is 1."""
    own = np.flatnonzero(degrees == degree)
    return np.eye(len(degrees))[:, own] / np.sqrt(degree + 1.0)
