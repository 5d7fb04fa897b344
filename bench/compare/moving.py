"""Recordings of a board that moves before the simulated camera, under a steady light, and pictures made from them.

A camera that moves before a board sees the same. Each picture has its own short recording around its time.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.compare.spec import ColumnConfig, MotionConfig
from bench.simulated import virtual_camera
from calib.events.reconstruction import reconstruct

Pose = tuple[tuple[float, float, float], tuple[float, float, float]]

STEP_PX = 2.5
"""Motion of the picture in a step of the simulation, px."""
_OBLIQUE_DEG = (20.0, 70.0)
_TURN_DEG_S = 10.0


def motion_of(column: ColumnConfig) -> MotionConfig:
    """Return the motion of a column of the method ``reconstruction``.

    Returns: That of the column, or the default.
    """
    return column.motion or MotionConfig()


def reach_px(column: ColumnConfig) -> float:
    """Return how far the board moves in the picture to either side of its place.

    Returns: Half of the way of one recording, px.
    """
    return motion_of(column).way_px / 2.0


def record_moving(
    column: ColumnConfig, section: dict[str, Any], focal_px: float, seed: int, number: int
) -> dict[bool, NDArray[np.float32]]:
    """Record a board that moves evenly through its placement, and reconstruct its picture there.

    section: Section ``simulation`` of a station, with the placement at the time of the picture.
    focal_px: Focal length, px.
    number: Number of the picture, from 1.
    Returns: (H, W) float32 pictures: two-sided (True), and of the filter as published (False).
    """
    motion = motion_of(column)
    rng = np.random.default_rng((seed, 31, number))
    position, turn = np.array(section["screen"]["position_mm"]), np.array(section["screen"]["turn_deg"])
    angle = motion.angle_deg if motion.angle_deg is not None else rng.uniform(*_OBLIQUE_DEG)
    edge = _edge_direction(turn)
    direction = edge + math.radians(angle) + 0.5 * math.pi * rng.integers(4)
    way_mm = position[2] / focal_px * np.array([math.cos(direction), math.sin(direction), 0.0])
    axis = rng.normal(size=3)
    turning = _TURN_DEG_S * axis / np.linalg.norm(axis)
    duration_us = 1e6 * motion.way_px / motion.speed_px_s
    middle_us = 0.5 * duration_us

    def board_at(t_us: float) -> Pose:
        late_s = 1e-6 * (t_us - middle_us)
        x, y, z = (position + late_s * motion.speed_px_s * way_mm).tolist()
        a, b, c = (turn + late_s * turning).tolist()
        return (x, y, z), (a, b, c)

    camera = virtual_camera(section, seed)
    seen = camera.capture_moving(
        board_at, duration_us, seed=1000 * seed + number, frame_us=1e6 * STEP_PX / motion.speed_px_s
    )
    events = (seen.events.t, seen.events.x, seen.events.y, seen.events.p)
    pictures = {}
    for two_sided in (True, False):
        (picture,) = reconstruct(
            [events], seen.image_size, [middle_us], cutoff_hz=motion.cutoff_hz, two_sided=two_sided
        )
        pictures[two_sided] = picture.image
    return pictures


def _edge_direction(turn_deg: NDArray[np.float64]) -> float:
    """Return the direction of the board's rows in the picture, radians."""
    from calib.model.rotation import exp_map

    along = np.asarray(exp_map(np.radians(turn_deg)))[:, 0]
    return math.atan2(along[1], along[0])
