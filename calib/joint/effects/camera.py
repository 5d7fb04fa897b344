"""Errors that turn with the camera: its lens, and what a decentred one leaves; a focal length that changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.effects.effect import Effect, RandomBlock, Row, Turned
from calib.model import result_parts as rows
from calib.model.camera import PINHOLE
from calib.model.lens import R8, distort_with_jacobians

#: Errors |x|^2 e of the image that turn with the camera: thin prism distortion of the lens (Weng et al., 1992), or what
#: misaligned collimators do to a pupil that turns. Without them p1 and p2 would take these, and move cx and cy.
PRISM = ("prism_x", "prism_y")
#: Errors (x e) x of the image: with the prism terms the decentring of a lens whose family has no p1 and p2, a fisheye.
DECENTRING = ("decentring_x", "decentring_y")
#: Change of the focal length, or of the radius, from the first pose to the last, as a share.
DRIFT = "drift"
#: Radial terms of a lens: how far each moves a point at the corner of the sensor, as a share of what the first does;
#: and the power of the tangent, or angle, that it has.
_LENS_RATIOS = {"k1": (1.0, 2), "k2": (0.4, 4), "k3": (0.15, 6), R8: (0.05, 8)}
_LENS_RATIOS |= {f"kb{n}": (ratio, 2 * n) for n, ratio in enumerate((1.0, 0.4, 0.15, 0.05), start=1)}
#: Cosine of the largest angle to the axis (73 degrees) at which a field follows an error of the image. Beyond, tangents
#: would grow without bound, and a field is one polynomial: what no camera sees there would spoil what it sees.
_LEAST_COSINE = 0.3
_ROW = Row(rows.LENS, "B", "expected sizes of lens coefficients")


class Lens(Effect):
    """The camera itself: focal lengths, principal point, distortion."""

    @property
    def names(self) -> tuple[str, ...]:
        return self.pose.camera

    def fill(self, columns: Array, poses: Turned) -> None:
        columns[:, range(len(self.names)), range(len(self.names))] = 1.0

    def priors(self) -> Sequence[RandomBlock]:
        decentred = tuple(name for name in self.names if name in ("p1", "p2"))
        blocks = [_alike(decentred, amp.TANGENTIAL)] if decentred else []
        return [*blocks, self._distortion()]

    def _distortion(self) -> RandomBlock:
        """Return the radial terms: powers of the tangent, or of the angle for a fisheye lens."""
        names = tuple(name for name in self.names if name in _LENS_RATIOS)
        corner = self.bench.corner if "k1" in names else float(np.arctan(self.bench.corner))
        sizes = [_LENS_RATIOS[name][0] * corner ** -_LENS_RATIOS[name][1] for name in names]
        return RandomBlock(_ROW, names, ((amp.DISTORTION, np.diag(sizes)),))


class TurningErrors(Effect):
    """Errors of the image beyond the family of the lens that turn with the camera."""

    @property
    def names(self) -> tuple[str, ...]:
        return PRISM if "p1" in self.pose.camera else (*PRISM, *DECENTRING)

    def fill(self, columns: Array, poses: Turned) -> None:
        errors = [partial(error, axis) for error in (_prism, _decentring) for axis in np.eye(2)]
        errors = errors[: len(self.names)]
        fields = self.pose.fields.shape(partial(_on_target, poses, self.pose.camera, errors))
        columns[:, self.pose.field] = fields.transpose(1, 2, 0)

    def priors(self) -> Sequence[RandomBlock]:
        decentred = self.names[len(PRISM) :]
        blocks = [_alike(decentred, amp.TANGENTIAL)] if decentred else []
        return [*blocks, _alike(PRISM, amp.PRISM)]


class Drift(Effect):
    """A focal length, or a radius, that changes while the poses are recorded."""

    names = (DRIFT,)

    def fill(self, columns: Array, poses: Turned) -> None:
        from_axis = partial(_on_target, poses, self.pose.camera, [lambda x: x])
        columns[:, self.pose.field] = (poses.order[:, None] * self.pose.fields.shape(from_axis)[0])[
            :, :, None
        ]


def _alike(names: tuple[str, ...], amplitude: str) -> RandomBlock:
    """Return lens coefficients of one amplitude."""
    return RandomBlock(_ROW, names, ((amplitude, np.eye(len(names))),))


def _on_target(
    poses: Turned, camera: Sequence[str], errors: Sequence[Callable[[Array], Array]], h: Array
) -> Array:
    """Return (K, n, N, 2) the fields on the target that displace the image by each of K errors. h: (N, 2)."""
    turned = poses.rotations
    inside = np.column_stack([h, np.ones(len(h))]) @ turned.transpose(0, 2, 1)
    depth = np.maximum(inside[:, :, 2:], _LEAST_COSINE)
    x = inside[:, :, :2] / depth
    slopes = (turned[:, None, :2, :2] - x[..., None] * turned[:, None, 2:, :2]) / depth[..., None]
    image, by_x, _ = distort_with_jacobians(x.reshape(-1, 2), dict.fromkeys(camera[len(PINHOLE) :], 0.0))
    back = np.linalg.inv(by_x.reshape(slopes.shape) @ slopes)
    image = image.reshape(x.shape)
    return np.array([(back @ error(image)[..., None])[..., 0] for error in errors])


def _prism(axis: Array, x: Array) -> Array:
    """Return |x|^2 e at places x of the image (..., 2)."""
    return np.asarray((x * x).sum(axis=-1, keepdims=True) * axis)


def _decentring(axis: Array, x: Array) -> Array:
    """Return 2 (x e) x at places x of the image (..., 2)."""
    return np.asarray(2.0 * (x @ axis)[..., None] * x)
