"""Recordings of a board that moves evenly before the simulated camera, under a steady light."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from virtual_camera import VirtualCamera

from calib.events.reconstruction import reconstruct
from calib.model.rotation import exp_map

Pose = tuple[tuple[float, float, float], tuple[float, float, float]]

#: How far the board moves in the picture, px, and in a step of the simulation.
WAY_PX, _STEP_PX = 100.0, 2.5
_SPEED_PX_S = 1000.0
_CUTOFF_HZ = 10.0
#: Between the way and the edges of the board.
_OBLIQUE_DEG = (20.0, 70.0)
_TURN_DEG_S = 10.0


def record_moving(
    section: dict[str, Any], focal_px: float, seed: int, number: int
) -> dict[bool, NDArray[np.float32]]:
    """Record a board that moves evenly through its placement, and reconstruct its picture there.

    Pictures are (H, W) float32: two-sided (True), and of the filter as published (False).
    """
    rng = np.random.default_rng((seed, 31, number))
    turn = np.array(section["screen"]["turn_deg"])
    angle = rng.uniform(*_OBLIQUE_DEG)
    rows = exp_map(np.radians(turn))[:, 0]
    direction = math.atan2(rows[1], rows[0]) + math.radians(angle) + 0.5 * math.pi * rng.integers(4)
    duration_us = 1e6 * WAY_PX / _SPEED_PX_S
    middle_us = 0.5 * duration_us
    seen = VirtualCamera(section, seed).capture_moving(
        _even_motion(section["screen"], direction, _SPEED_PX_S / focal_px, middle_us, rng),
        duration_us,
        seed=1000 * seed + number,
        frame_us=1e6 * _STEP_PX / _SPEED_PX_S,
    )
    times_us = seen.events[0]
    earlier = tuple(
        column[times_us <= middle_us] for column in seen.events
    )  # The filter as published knows no later ones
    pictures = {}
    for two_sided, events in ((True, seen.events), (False, earlier)):
        (picture,) = reconstruct([events], seen.image_size, [middle_us], cutoff_hz=_CUTOFF_HZ)
        pictures[two_sided] = picture.image if two_sided else 2.0 * picture.image
    return pictures


def _even_motion(
    placed: dict[str, Any], direction: float, tangents_s: float, middle_us: float, rng: np.random.Generator
) -> Callable[[float], Pose]:
    """Return the pose at a time: at ``middle_us`` as placed; direction in rad, speed in tangents of the image a second."""
    position, turn = np.array(placed["position_mm"]), np.array(placed["turn_deg"])
    mm_s = tangents_s * position[2] * np.array([math.cos(direction), math.sin(direction), 0.0])
    axis = rng.normal(size=3)
    turning = _TURN_DEG_S * axis / np.linalg.norm(axis)

    def at(t_us: float) -> Pose:
        late_s = 1e-6 * (t_us - middle_us)
        x, y, z = (position + late_s * mm_s).tolist()
        a, b, c = (turn + late_s * turning).tolist()
        return (x, y, z), (a, b, c)

    return at
