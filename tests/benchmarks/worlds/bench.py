"""What a world gives: views, readings, what the station states, and apart from them the truth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .geometry import SIZE, by_names

Array = NDArray[np.float64]
Pose = tuple[float, float]

THREE: Sequence[Pose] = ((-6, 2), (6, 2), (0, -3))
NINE: Sequence[Pose] = tuple((p, t) for t in (-2.5, 0, 2.5) for p in (-6, 0, 6))
GRID: Sequence[Pose] = tuple((p, t) for t in (-2.5, -1.25, 0, 1.25, 2.5) for p in (-6, -3, 0, 3, 6))
POSES: Mapping[int, Sequence[Pose]] = {1: ((0, 0),), 3: THREE, 9: NINE, 25: GRID}


@dataclass(frozen=True)
class Seen:
    """The stars that a pose shows."""

    name: str
    ids: NDArray[np.int64]  # (N,)
    px: Array  # (N, 2)
    mm: Array  # (N, 2) nominal positions on the print
    sigma_px: Array  # (N,) stated
    recorded_s: float | None = None


@dataclass(frozen=True)
class Stated:
    """What the station states; the truth was drawn from it, unless a case says otherwise."""

    r_mm: float
    r_sigma_mm: float
    defocus: tuple[float, float]  # value and standard uncertainty, dimensionless
    off_pivot_mm: tuple[float, float]
    reading_sigma_deg: float = 0.0025
    scale_sigma: float = 2e-4
    eccentricity_deg: float = 0.001
    bounded: bool = True  # whether defocus and pupil bound the parallax; not on a mount moved by hand
    print_scale: float = 2e-5  # half width, rectangular
    print_bow_mm: float = 0.02  # half width at 40 mm, rectangular
    thermal: float = 9e-6  # standard uncertainty of the print's relative expansion
    effective_radius: float | None = None  # standard uncertainty; None if not stated
    # What r_mm is: ``radius``, the length that the camera sees, d print / d tangent; or ``focal length`` (EFL) of the glass.
    # radius = focal length + defocus * pupil_to_focus_mm.
    certifies: str = "radius"
    says_length: bool = True  # whether the certificate says which of the two it states
    # Value and standard uncertainty, mm: from the camera's pupil to the collimator's front focal plane, towards the glass.
    pupil_to_focus_mm: tuple[float, float] | None = None


@dataclass(frozen=True)
class Camera:
    """The true camera."""

    values: Mapping[str, float]  # fx, fy, cx, cy and the lens's coefficients, by the engine's names
    family: str  # k1k2, p1p2k3 or fisheye
    image_of: Callable[[Array], Array] | None = None  # own projection, if no such coefficients describe it
    exact: bool = False  # whether own projection has the coefficients as they are, and others

    def project(self, rays: Array) -> Array:
        """Image points (N, 2) px of rays (N, 3)."""
        return self.image_of(rays) if self.image_of else by_names(self.values, rays)

    def rays(self, px: Array) -> Array:
        """Rays (N, 3) of image points (N, 2), by Newton's method."""
        f = np.array([self.values["fx"], self.values["fy"]])
        at = (px - [self.values["cx"], self.values["cy"]]) / f
        step = 1e-6
        for _ in range(12):
            here, jacobian = self._image(at), np.empty((len(at), 2, 2))
            for axis in range(2):
                moved = at.copy()
                moved[:, axis] += step
                jacobian[:, :, axis] = (self._image(moved) - here) / step
            at = at - np.linalg.solve(jacobian, (here - px)[:, :, None])[:, :, 0]
        return np.column_stack([at, np.ones(len(at))])

    def _image(self, tangents: Array) -> Array:
        return self.project(np.column_stack([tangents, np.ones(len(tangents))]))


@dataclass(frozen=True)
class Bench:
    """A drawn bench."""

    world: str
    views: list[Seen]
    readings_deg: list[dict[str, float]]
    stated: Stated
    camera: Camera
    facts: dict[str, Any] = field(default_factory=dict)


def noisy_view(
    name: str,
    stars: tuple[NDArray[np.int64], Array, Array],
    star_px: float,
    stated_px: float,
    bad_share: float,
    rng: np.random.Generator,
    border_px: float = 14.0,
) -> Seen:
    """The stars inside of the image with noise; a share of them is bad and has five times the noise.

    stars: ids (N,), nominal positions (N, 2) mm, image points (N, 2) px.
    """
    ids, mm, px = stars
    size = np.array(SIZE)
    inside = ((px > border_px) & (px < size - 1 - border_px)).all(axis=1)
    ids, mm, px = ids[inside], mm[inside], px[inside]
    bad = rng.random(len(ids)) < bad_share
    noise = star_px * rng.normal(size=px.shape) * np.where(bad, 5.0, 1.0)[:, None]
    return Seen(name, ids, px + noise, mm, np.full(len(ids), stated_px))


def named_poses(poses: Sequence[Pose], times: int) -> list[tuple[str, Pose, int]]:
    """Name, angles and round of each recording; all poses are recorded once before any is repeated."""
    return [
        (f"pose {i + 1}" + (f" round {j + 1}" if j else ""), pose, j)
        for j in range(times)
        for i, pose in enumerate(poses)
    ]


def pose_key(pose: Pose) -> tuple[int, int]:
    """Whole numbers above zero that tell poses apart, to seed what a pose draws, whatever poses are beside it."""
    return round(1000 * pose[0]) + 10**6, round(1000 * pose[1]) + 10**6
