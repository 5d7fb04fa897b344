"""All effects of camera, glass, print and pupil as rows of the table (`table`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from calib.arrays import Array, Ints
from calib.model import result_parts as parts
from calib.model.cause import PARALLAX
from calib.model.lens import R8
from calib.model.type_b_terms import RADII, SCALES, TypeBTerm

from . import amplitudes as amp
from . import knowledge as stated
from .camera import PINHOLE, Camera
from .fields import DEGREE, DEGREES, Fields, K, along, coma, of_degrees, square
from .knowledge import Known
from .passport import add_passport, stated_names
from .pupils import Moved, Places
from .shapes import (
    CENTRE,
    FIELD,
    LARGER,
    RADIAL,
    RADIAL_RATIO,
    about_shifted_axis,
    radial_shapes,
    shift,
)
from .table import POWERS, Row, Statement, Table

#: Change of scale that comes with radial errors, as a share of what they do at the edge of the field.
_RADIAL_SCALE = 0.06
#: Radial terms of a lens: how far each moves a point at the corner of the sensor, as a share of what the first does;
#: and the power of the tangent, or angle, that it has.
_LENS_RATIOS = {"k1": (1.0, 2), "k2": (0.4, 4), "k3": (0.15, 6), R8: (0.05, 8)}
_LENS_RATIOS |= {f"kb{n}": (ratio, 2 * n) for n, ratio in enumerate((1.0, 0.4, 0.15, 0.05), start=1)}
#: 1-sigma of the coefficients of a denominator: the share of the distance from the axis by which they move a point at
#: the corner of the sensor; and of the skew, px.
_DENOMINATOR, _SKEW_PX = {"k4": (0.1, 2), "k5": (0.05, 4), "k6": (0.01, 6)}, 5.0
#: Parallax is alike along both axes but for these shares: one size, and a fifth in all ways.
_ALIKE, _UNLIKE = 0.96**0.5, 0.08**0.5
#: Expected defocus times the place of a pupil beside the axes, over r; counts beside what a station states.
_EXPECTED_ASIDE = 3e-4
#: Astigmatism over field curvature, as 40 ray-traced collimators have them for a pupil that moves aside.
_ASTIGMATISM = 0.25
#: A pupil that is beside the axis at turn 0 sees coma by turn, too, so many times as large: twice its place over what a
#: turn of `amp.UNIT_TURN` moves it. Visible discs show where the axis is.
_BESIDE, _BESIDE_DISC = 10.0, 2.0
#: Displacements rho^4 and rho^10 about a disc: sizes at unit amplitude.
RIM_SIZES = np.array([1.0, 0.3])
#: Where the fields by turn follow a pupil that is moved by hand, what differs from pose to pose may still change
#: smoothly with the turn, in the degrees that imitate another focal length. If the poses turn by `amp.UNIT_TURN`, the
#: part of a random function that is linear in the turn is so many times as large as the rest, which the own fields are.
#: It bends: beyond, what is linear falls with the root of the turn, and its slope with the power 1.5.
_SMOOTH_DEGREES, _SMOOTH = (1, 2), 1.8
#: Odds beforehand (docs/adjustment.md, "What may be otherwise").
NOT_SQUARE, UNSTEADY = 1e-3, 0.1 / 0.9

_PRIORS = Row(parts.PRIORS, "B", "square pixels, and limits of the unknowns")
_LENS = Row(parts.LENS, "B", "expected sizes of lens coefficients")
_COMMON = Row(parts.COMMON_FIELD, "A", "residuals that all poses share")
_TURN = Row(parts.TURN_FIELDS, "A", "residuals that follow the turn")
_UNBOUNDED = Row(parts.UNBOUNDED_PARALLAX, "B", "not stated; its size follows from the collimator's errors")
BOUNDED = Row(parts.PARALLAX, "B", "station: pupil_off_pivot_mm and defocus")
_X, _Y = np.eye(2)


@dataclass(frozen=True)
class Poses:
    """How the camera is turned at n poses: data, which no step of a search changes."""

    tangents: Array  # (n, 2) where its axis meets the target, from the foot, over r
    axes: Array  # (n, 2, 2) its x and y axes on the target

    @classmethod
    def of(cls, rotations: Array) -> Poses:
        """Return how (n, 3, 3) rotations, camera <- target, turn the camera."""
        return cls(rotations[:, 2, :2] / rotations[:, 2, 2:], rotations[:, :2, :2])

    @cached_property
    def cosines(self) -> Array:
        """(n,) of the turns."""
        return np.asarray(1.0 / np.sqrt(1.0 + (self.tangents**2).sum(axis=1)))

    @property
    def places(self) -> Array:
        """(n, 2) of a pupil that follows the turn: sines, in units of `amp.UNIT_TURN`."""
        return np.asarray(self.tangents * self.cosines[:, None] / amp.UNIT_TURN)

    @property
    def times(self) -> Array:
        """(n,) when the poses were recorded, from -1/2 to 1/2."""
        n = len(self.tangents)
        return np.linspace(-0.5, 0.5, n) if n > 1 else np.zeros(1)


@dataclass(frozen=True)
class Glass:
    """What the table reads of a bench."""

    camera: Camera
    fields: Fields
    poses: Poses
    known: Known
    moved: Moved
    places: Places | None  # Of a pupil that a hand moves
    far: float = 1.0  # How many times as far as expected the pupil moves

    def table(self) -> Table:
        """Return the table of all effects but those of a gimbal."""
        table = Table(len(self.poses.tangents), len(self.camera.names), bool(self.moved.of_poses))
        _camera(table, self)
        _centre(table, self)
        stated_by = stated_names(self.known.passport)
        if RADIAL[0] not in stated_by:
            _radial(table, self)
        if f"{FIELD}1" not in stated_by:
            _common(table, self)
        _print(table, self.known.terms_of((*SCALES, "print_bow", *RADII)), self.fields)
        _parallax(table, self)
        _curvature(table, self)
        _by_turn(table, self)
        _drift(table, self)
        if table.about_disc:
            _rim(table)
        if self.places is not None:
            _by_hand(table, self, self.places)
        return table


def sizes_by_degree(names: Sequence[str], degrees: Ints) -> tuple[Array, list[str]]:
    """Return 1-sigmas of coefficients, so that each degree has the mean square of its amplitude, and its name.

    ``names``: the amplitudes of the degrees, from the lowest of ``degrees`` on.
    """
    first = int(degrees.min())
    return 1.0 / np.sqrt(degrees + 1.0), [names[int(d) - first] for d in degrees]


def _camera(table: Table, glass: Glass) -> None:
    camera, diagonal = glass.camera, float(np.hypot(*glass.camera.image_size))
    middle = stated.MIDDLE_SHARE * diagonal / camera.f0_px
    known = {
        "log f": 1.0,
        "aspect": stated.ASPECT_SIGMA,
        "centre x": middle,
        "centre y": middle,
        "skew": _SKEW_PX,
    }
    known |= {name: share * camera.corner**-power for name, (share, power) in _DENOMINATOR.items()}
    amplitudes = dict.fromkeys(("p1", "p2", "decentring x", "decentring y"), amp.TANGENTIAL)
    amplitudes |= dict.fromkeys(("prism x", "prism y"), amp.PRISM) | dict.fromkeys(
        _LENS_RATIOS, amp.DISTORTION
    )
    for k, name in enumerate(camera.names):
        ratio, power = _LENS_RATIOS.get(name, (1.0, 0))
        columns = np.zeros((table.n, table.basis, 1))
        columns[:, k] = 1.0
        size = known.get(name, ratio * camera.corner**-power)
        row = _PRIORS if name in PINHOLE else _LENS
        at = table.add(name, row, size, amplitude=amplitudes.get(name, ""), columns=columns)
        if name == "aspect":
            square_pixels = Row(parts.PRIORS, "B", "pixels are square")
            free = np.array([stated.FREE_ASPECT])
            table.statements.append(Statement(stated.ASPECT, at, free, NOT_SQUARE, square_pixels))


def _centre(table: Table, glass: Glass) -> None:
    """Foot x, y of the perpendicular, in units of r0 from the start, and the logarithm of its length r."""
    known, stated_by = glass.known, stated_names(glass.known.passport)
    if known.passport is not None:
        add_passport(table, glass.fields, known.passport, known.passport_source)
    if "x" not in stated_by:
        at = table.field("x y", _PRIORS, shift(glass.fields), 1.0)
        for name, k in zip(CENTRE, at, strict=False):
            table.follows(name, np.array([k]), glass.fields.r0)
    if "r" in stated_by:
        return
    certificate = known.certificate
    if certificate is None:
        table.follows("log r", table.add("r", _PRIORS, 1.0, log_r=1.0))
        return
    row = Row(parts.PASSPORT, "B", certificate.source)
    mean = np.log(certificate.r_mm / glass.fields.r0)
    at = table.add("r", row, certificate.sigma, mean=mean, log_r=1.0)
    table.follows("log r", at)
    free = np.array([max(stated.FREE_CERTIFICATE, certificate.sigma)])
    table.statements.append(
        Statement(
            stated.CERTIFICATE,
            at,
            free,
            LARGER,
            row,
            "mm",
            certificate.r_mm,
            certificate.r_mm,
            focal=certificate.focal_sigma,
        )
    )


def _radial(table: Table, glass: Glass) -> None:
    """Distortion of the collimator, and a bow of the print that nobody states."""
    radial, sigma = radial_shapes(glass.fields), glass.known.radial_sigma
    sizes = np.array([1.0, RADIAL_RATIO])
    if sigma is None:
        at = table.field("radial", _COMMON, radial, sizes, amp.RADIAL)
    else:
        station = Row(parts.PRIORS, "B", "station: bow and distortion")
        at = table.field("radial", station, radial, sigma * sizes)
    for name, k in zip(RADIAL, at, strict=True):
        table.follows(name, np.array([k]))


def _common(table: Table, glass: Glass) -> None:
    """Errors that all poses share: irregular ones, radial ones about a shifted axis, a scale that comes with these."""
    fields, known = glass.fields, glass.known
    unit, degrees = of_degrees(range(1, DEGREE + 1))
    size, names = sizes_by_degree(amp.COMMON, degrees)
    groups = [(table.field("common", _COMMON, unit, size, names), unit)]
    if known.wavefront:
        waves = known.wavefront / np.sqrt(DEGREE * (degrees + 1.0))
        groups.append((table.field("wavefront", _COMMON, unit, waves), unit))
    shifted = about_shifted_axis(fields)
    groups.append((table.field("shifted", _COMMON, shifted, 1.0, amp.SHIFTED), shifted))
    edge = _RADIAL_SCALE * (fields.radius_mm / fields.r0) ** 2 * fields.shapes([lambda h: h])
    groups.append((table.field("scale of radial", _COMMON, edge, 1.0, amp.RADIAL), edge))
    # A scale that all poses see is another radius: r is the length that the camera sees.
    unit_scale = fields.shapes([lambda h: h])[:, 0]
    for at, shapes in groups:
        scales = unit_scale @ shapes / (unit_scale @ unit_scale)
        table.follows("log r", at, -scales)
        left = shapes - np.outer(unit_scale, scales)
        for k in np.flatnonzero(np.tile(DEGREES, 2) > 0).tolist():
            table.follows(f"{FIELD}{k}", at, left[k])


def _print(table: Table, terms: Sequence[TypeBTerm], fields: Fields) -> None:
    """Errors of the print and of the radius that a station states."""
    radial = radial_shapes(fields)[:, :1]
    for term in terms:
        row, size = Row(term.name, "B", term.source), max(term.standard_uncertainty, 1e-12)
        if term.kind in RADII:
            # A certificate says what the radius is together with its errors.
            at = table.add(term.name, row, size, log_r=-1.0)
            table.follows("log r", at, -1.0)
        elif term.kind == "print_bow":
            assert term.radius_mm is not None
            height = (fields.r0 / term.radius_mm) ** 2 / fields.r0
            at = table.field(term.name, row, -height * radial, size)
        else:
            scale = fields.shapes([lambda h: h + fields.middle / fields.r0])
            at = table.field(term.name, row, scale, size)
        # The free 1-sigma of a term without one is its own: such a statement is no witness, but has a row.
        free = stated.FREE_TERMS.get(term.kind, 0.0)
        table.statements.append(Statement(term.name, at, np.array([free]), LARGER, row, term.unit, term=term))


def _parallax(table: Table, glass: Glass) -> None:
    """A pupil off the pivot, before a collimator out of focus, shifts the image; on a gimbal it also moves back."""
    shifts, r0, poses, bound = shift(glass.fields), glass.fields.r0, glass.poses, glass.known.bound
    back = np.zeros((table.n, table.basis, 1))
    if glass.places is None:
        back[:, table.depth, 0] = r0 * (poses.cosines - 1.0)
    turned = np.zeros((len(POWERS), 2 * K, 1))
    turned[:2, :, 0] = -amp.UNIT_TURN * shifts.T
    unlike = np.zeros((len(POWERS), 2 * K, 4))
    unlike[0, :, :2], unlike[1, :, 2:] = -amp.UNIT_TURN * shifts, -amp.UNIT_TURN * shifts
    if bound is None:
        table.add("parallax", _UNBOUNDED, _ALIKE, amplitude=amp.PARALLAX, columns=back, by_place=turned)
        table.add("parallax unlike", _UNBOUNDED, _UNLIKE, count=4, amplitude=amp.PARALLAX, by_place=unlike)
    else:
        value, sigma = bound.mean_and_sigma(r0)
        sigma = max(sigma, 1e-9)
        at = table.add("parallax", BOUNDED, sigma, mean=value, columns=back, by_place=turned)
        free = np.array([max(stated.FREE_PARALLAX, 5.0 * sigma)])
        table.statements.append(Statement(PARALLAX, at, free, LARGER, BOUNDED, "1", value))
        apart = np.stack([unlike[:, :, 0] - unlike[:, :, 3], unlike[:, :, 1], unlike[:, :, 2]], axis=2)
        table.add("parallax unlike", BOUNDED, 0.2 * sigma + 2e-5, count=3, by_place=apart)
    _aside(table, glass)


def _aside(table: Table, glass: Glass) -> None:
    """A pupil beside the axes about which the camera turns: it shifts the image, and moves along the beam."""
    r0, poses, bound = glass.fields.r0, glass.poses, glass.known.bound
    aside = np.zeros((table.n, table.basis, 2))
    turned = (poses.axes @ poses.tangents[:, :, None])[:, :, 0]
    aside[:, table.depth] = r0 * turned * poses.cosines[:, None]
    if glass.places is None:
        aside[:, table.field_slice] = shift(glass.fields) @ np.swapaxes(poses.axes, 1, 2)
    if bound is None:
        table.add("aside", _UNBOUNDED, 1.0, count=2, amplitude=amp.ASIDE, columns=aside)
    else:  # both what is stated and what is expected hold: informations add
        own = max(bound.aside_sigma(r0), 1e-9)
        size = 1.0 / np.hypot(1.0 / own, 1.0 / _EXPECTED_ASIDE)
        table.add("aside", BOUNDED, size, count=2, columns=aside)


def _curvature(table: Table, glass: Glass) -> None:
    """Field curvature and astigmatism, seen by a pupil that the turn moves, and by one beside the axes."""
    fields, axes = glass.fields, glass.poses.axes
    for name, shape, size in (
        ("curvature", lambda h, e: square(h) * e, 1.0),
        ("astigmatism", lambda h, e: along(h, e) * h, _ASTIGMATISM),
    ):
        one = fields.shapes([partial(shape, e=_X), partial(shape, e=_Y)])
        by_place = np.zeros((len(POWERS), 2 * K, 1))
        by_place[:2, :, 0] = one.T
        table.add(f"{name} by turn", _TURN, size, amplitude=amp.CURVATURE_TURN, by_place=by_place)
        table.turning(
            f"{name} aside", _TURN, partial(lambda p, s: s @ axes[p].T, s=one), size, amp.CURVATURE_ASIDE
        )


def _by_turn(table: Table, glass: Glass) -> None:
    """Aberrations that move with the pupil; those of degree 0 are the parallax, so they vanish on the axis."""
    fields, (first, second) = glass.fields, glass.moved.turn_degrees
    unit, degrees = of_degrees(range(1, first + 1))
    on_axis = np.kron(np.eye(2), fields.polynomials(fields.middle[None]))
    unit = unit - np.kron(np.eye(2), np.eye(K)[:, :1]) @ on_axis @ unit
    size, names = sizes_by_degree(amp.TURN, degrees)
    for k in range(2):
        _follow_place(table, "by turn", {k: unit}, size, names)
    beside = (_BESIDE_DISC if table.about_disc else _BESIDE) / glass.far
    for e in (_X, _Y):
        shapes = {k: fields.shapes([partial(coma, e, t)]) for k, t in enumerate((_X, _Y))}
        _follow_place(table, "coma aside", shapes, beside, [amp.SCALE_TURN_2])
    unit, degrees = of_degrees(range(second + 1))
    size, names = sizes_by_degree(amp.TURN_2, degrees)
    for k in range(2, 5):
        _follow_place(table, "by turn squared", {k: unit}, size, names)
    pairs = {2: (_X, _X), 3: (_X, 2.0 * _Y), 4: (_Y, _Y)}
    round_glass = {k: fields.shapes([partial(coma, *pair)]) for k, pair in pairs.items()}
    _follow_place(table, "coma", round_glass, 1.0, [amp.SCALE_TURN_2])


def _follow_place(
    table: Table, name: str, shapes: dict[int, Array], size: Array | float, amplitudes: Sequence[str]
) -> None:
    """Add unknowns that displace the stars by (2 K, q) shapes, each times one of the products of the pupil's place."""
    count = len(amplitudes)
    by_place = np.zeros((len(POWERS), 2 * K, count))
    for k, shape in shapes.items():
        by_place[k] = shape
    table.add(name, _TURN, size, count=count, amplitude=amplitudes, by_place=by_place)


def _drift(table: Table, glass: Glass) -> None:
    """A focal length, or a radius, that changes while the poses are recorded."""
    times, tangents = glass.poses.times, glass.poses.tangents

    def shapes(pose: int) -> Array:
        return times[pose] * glass.fields.shapes([lambda h: h - tangents[pose]])

    still = Row(parts.PRIORS, "B", "nothing changes while the poses are recorded")
    at = table.turning("drift", still, shapes, stated.DRIFT_SIGMA, "")
    table.statements.append(Statement(stated.STEADY, at, np.array([stated.FREE_DRIFT]), UNSTEADY, still))


def _rim(table: Table) -> None:
    """Displacements about the visible disc of each view: there, the beam fills the pupil only partly."""
    columns = np.zeros((table.n, table.basis, 2))
    columns[:, table.rim] = np.eye(2)
    table.add("rim", _TURN, RIM_SIZES, count=2, amplitude=amp.RIM, columns=columns)


def _by_hand(table: Table, glass: Glass, places: Places) -> None:
    """A mount moved by hand: places of the pupil, also along the beam, and own fields that follow the turn."""
    n, tangents = table.n, glass.poses.tangents
    middles = np.zeros((n, table.basis, 2 * n))
    middles[:, table.middle] = places.root
    discs = Row(parts.PUPILS, "A", "visible discs")
    table.add("place", discs, 1.0, count=2 * n, amplitude=amp.DISCS, columns=middles)
    along = np.zeros((n, table.basis, n))
    along[:, table.depth] = glass.fields.r0 * np.eye(n)
    own = Row(parts.POSE_FIELDS, "A", "residuals that differ from pose to pose")
    table.add("along", own, 1.0, count=n, amplitude=amp.ALONG, columns=along)
    reach = float(np.hypot(*(tangents - tangents.mean(axis=0)).T).max())
    unit, degrees = of_degrees(_SMOOTH_DEGREES)
    size, names = sizes_by_degree(amp.POSE, degrees)
    size = size * _SMOOTH * (amp.UNIT_TURN / max(reach, amp.UNIT_TURN)) ** 1.5
    for factors in tangents.T / amp.UNIT_TURN:
        table.field("own by turn", own, unit, size, names, factors)
