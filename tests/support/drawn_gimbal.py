"""Drawn gimbals before a camera: rotations seen, their stated covariance, readings, and the truth behind them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.model.rotation import euler_zxy, exp_map, log_map

AXES = ("pan_deg", "tilt_deg", "roll_deg")


@dataclass(frozen=True)
class DrawnGimbal:
    """A bench as it was drawn."""

    rotations: Any
    covariance: Any
    angles: Any
    scales: Any
    focal_sigma: float

    @property
    def readings(self) -> list[Mapping[str, float]]:
        """What the check is given: axes without motion have no reading."""
        used = [i for i in range(3) if np.ptp(self.angles[:, i]) > 0 or i < 2]
        return [{AXES[i]: float(row[i]) for i in used} for row in self.angles]


def draw_gimbal(
    seed: int,
    *,
    poses: int | None = None,
    range_deg: float | None = None,
    noise_arcsec: float | None = None,
    scale_error: float = 0.0,
    focal_error: float = 0.0,
    focal_sigma: float = 2e-4,
    bias_deg: float = 0.0,
    roll_range_deg: float = 0.0,
    slip: tuple[int, int, float] | None = None,
    wrong: tuple[int, float] | None = None,
    square_deg: float = 0.0,
    raster: bool = False,
) -> DrawnGimbal:
    """Draw a bench; `slip` is (axis, first pose after it, degrees the axis stands short of its reading)."""
    rng = np.random.default_rng(seed)
    count = poses or int(rng.integers(3, 26))
    reach = range_deg or float(10 ** rng.uniform(0.3, 1.5))
    sigma = np.deg2rad((noise_arcsec or float(10 ** rng.uniform(0, 1.8))) / 3600)
    angles = np.column_stack(
        [rng.uniform(-reach, reach, count), rng.uniform(-reach, reach, count) * 0.6, np.zeros(count)]
    )
    if raster:
        side = int(np.ceil(np.sqrt(count)))
        grid = [(x, y) for y in range(side) for x in (range(side) if y % 2 == 0 else reversed(range(side)))]
        angles[:, :2] = (np.array(grid[:count]) / (side - 1) - 0.5) * (2 * reach, reach)
    if roll_range_deg:
        angles[:, 2] = rng.uniform(-roll_range_deg, roll_range_deg, count)
    scales = 1 + scale_error * rng.standard_normal(3)
    true = angles * scales
    if slip is not None:
        true[slip[1] :, slip[0]] -= slip[2]
    mounted = exp_map(np.deg2rad(rng.uniform(-8, 8, 3))) @ euler_zxy(0, 0, rng.uniform(-180, 180))
    standing = euler_zxy(*rng.uniform(-15, 15, 2), rng.uniform(-180, 180))
    square = euler_zxy(0, 0, square_deg)
    turns = [mounted @ euler_zxy(0, t, r) @ square @ euler_zxy(p, 0) @ standing for p, t, r in true]
    rotations = np.array(turns)
    if wrong is not None:
        tipped = rng.standard_normal(3)
        axis = tipped / np.linalg.norm(tipped)
        rotations[wrong[0]] = exp_map(np.deg2rad(wrong[1]) * axis) @ rotations[wrong[0]]
    from_middle = log_map(rotations @ rotations[count // 2].T)
    rotations = exp_map(focal_error * from_middle) @ rotations
    if bias_deg:  # errors of a collimator: a smooth part, quadratic in the angles, and a part of each view
        x = angles[:, :2] / np.maximum(np.abs(angles[:, :2]).max(axis=0), 1e-9)
        bends = np.column_stack([x[:, 0] ** 2, x[:, 0] * x[:, 1], x[:, 1] ** 2]) @ rng.standard_normal((3, 3))
        own = rng.standard_normal((count, 3))
        rotations = exp_map(np.deg2rad(bias_deg) * (0.5 * bends + 0.7 * own)) @ rotations
    rotations = exp_map(sigma * rng.standard_normal((count, 3))) @ rotations
    shared = focal_sigma * from_middle.reshape(-1, 1)
    covariance = sigma**2 * np.eye(3 * count) + shared @ shared.T
    return DrawnGimbal(rotations, covariance, angles, scales, focal_sigma)
