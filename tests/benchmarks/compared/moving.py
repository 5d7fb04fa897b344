"""Recordings of a board or a sheet that moves evenly before the simulated camera, under a steady light."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sheet_scene import ShownSheet
from virtual_camera import VirtualCamera

from calib.errors import CalibrationError
from calib.events.reconstruction import reconstruct
from calib.model.camera import CameraModel
from calib.model.rotation import exp_map, log_map

from .by_lines import SeenEdges
from .columns import Column, Sheet
from .line_events import edge_points

Array = NDArray[np.float64]
Pose = tuple[tuple[float, float, float], tuple[float, float, float]]

#: Motion of the picture in a step of the simulation, px: for pictures, and for lines, whose times matter.
_STEP_PX, _LINES_STEP_PX = 2.5, 1.5
_OBLIQUE_DEG = (20.0, 70.0)
_TURN_DEG_S = 10.0
#: A person moves across all edges: the angle to each edge is this at least, if a few tries find such a direction.
_ACROSS_DEG, _DIRECTIONS = 20.0, 36
_SHORTEST_PX = 80.0
_MARGIN_PX = 12.0
_MOST_DRAWS = 2000


def reach_px(column: Column) -> float:
    """Return how far the board moves in the picture to either side of its place: half the way, px."""
    return column.motion.way_px / 2.0


def record_moving(
    column: Column, section: dict[str, Any], focal_px: float, seed: int, number: int
) -> dict[bool, NDArray[np.float32]]:
    """Record a board that moves evenly through its placement, and reconstruct its picture there.

    Pictures are (H, W) float32: two-sided (True), and of the filter as published (False).
    """
    motion = column.motion
    rng = np.random.default_rng((seed, 31, number))
    turn = np.array(section["screen"]["turn_deg"])
    angle = motion.angle_deg if motion.angle_deg is not None else rng.uniform(*_OBLIQUE_DEG)
    rows = exp_map(np.radians(turn))[:, 0]
    direction = math.atan2(rows[1], rows[0]) + math.radians(angle) + 0.5 * math.pi * rng.integers(4)
    duration_us = 1e6 * motion.way_px / motion.speed_px_s
    middle_us = 0.5 * duration_us
    seen = VirtualCamera(section, seed).capture_moving(
        _even_motion(section["screen"], direction, motion.speed_px_s / focal_px, middle_us, rng),
        duration_us,
        seed=1000 * seed + number,
        frame_us=1e6 * _STEP_PX / motion.speed_px_s,
    )
    times_us = seen.events[0]
    earlier = tuple(
        column[times_us <= middle_us] for column in seen.events
    )  # The filter as published knows no later ones
    pictures = {}
    for two_sided, events in ((True, seen.events), (False, earlier)):
        (picture,) = reconstruct([events], seen.image_size, [middle_us], cutoff_hz=motion.cutoff_hz)
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


def record_edges(column: Column, camera: CameraModel, seed: int, number: int) -> SeenEdges:
    """Record a sheet that moves past the camera, and find its edges at the middle of the time.

    A person marks the ends of each edge in a picture.
    Raises TargetNotFound: If an edge has too few events.
    """
    sheet = column.sheet
    rng = np.random.default_rng((seed, 32, number))
    placed, ends_px, ends_mm = _placed_sheet(sheet, column, camera, rng)
    duration_us = 1e6 * sheet.way_px / sheet.speed_px_s
    middle_us = 0.5 * duration_us
    section = {"noise": column.noise, "optics": {"mounting_deg": [0.0, 0.0, 0.0]}, "sheet": placed}
    seen = VirtualCamera(section, seed).capture_moving(
        _even_motion(placed, _across(ends_px, rng), sheet.speed_px_s / camera.fx, middle_us, rng),
        duration_us,
        seed=1000 * seed + number,
        frame_us=1e6 * _LINES_STEP_PX / sheet.speed_px_s,
    )
    edges = []
    for ends in ends_px:
        marked = ends + sheet.marked_px * rng.normal(size=(2, 2))
        edges.append(edge_points(tuple(seen.events), middle_us, marked, rng))
    return SeenEdges(f"pass {number}", ends_mm, tuple(edges))


def _across(ends_px: Array, rng: np.random.Generator) -> float:
    """Return a direction in the image, rad, as oblique to all edges as a person moves."""
    along = ends_px[:, 1] - ends_px[:, 0]
    edges = np.arctan2(along[:, 1], along[:, 0])
    tried = rng.uniform(0, 2 * math.pi, _DIRECTIONS)
    least = np.abs(np.sin(tried[:, None] - edges)).min(axis=1)
    enough = np.flatnonzero(least > math.sin(math.radians(_ACROSS_DEG)))
    return float(tried[enough[0] if len(enough) else np.argmax(least)])


def _placed_sheet(
    sheet: Sheet, column: Column, camera: CameraModel, rng: np.random.Generator
) -> tuple[dict[str, Any], Array, Array]:
    """Draw where the sheet stands: wholly in view, tilted and turned; no edge is short.

    Returns the fields of `sheet_scene.ShownSheet`, and the ends of the edges in px and in mm.
    """
    margin = _MARGIN_PX + 0.5 * sheet.way_px
    for _ in range(_MOST_DRAWS):
        tilt, around, roll = (
            sheet.tilt_deg * rng.random(),
            2 * math.pi * rng.random(),
            2 * math.pi * rng.random(),
        )
        turn = math.radians(tilt) * np.array([math.cos(around), math.sin(around), 0.0])
        rotation = exp_map(np.array([0.0, 0.0, roll])) @ exp_map(turn)
        distance = sheet.distance_mm * (1.0 + 0.15 * rng.uniform(-1, 1))
        middle = camera.rays(np.array([[rng.uniform(0, s - 1) for s in camera.image_size]]))[0]
        position = distance * middle / middle[2]
        placed = {
            **sheet.model_dump(include={"width_mm", "height_mm"}),
            "position_mm": tuple(position.tolist()),
            "turn_deg": tuple(np.degrees(log_map(rotation)).tolist()),
        }
        shown = ShownSheet(**placed)
        if not shown.shows_its_front():
            continue
        ends_mm = shown.edges_mm()
        ends = camera.project(ends_mm.reshape(-1, 3) @ rotation.T + position).reshape(-1, 2, 2)
        inside = (ends > margin) & (ends < np.array(camera.image_size) - 1 - margin)
        long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > _SHORTEST_PX
        if inside.all() and long.all():
            return placed, ends, ends_mm
    raise CalibrationError(
        "The sheet does not fit into the picture.",
        where=f"column {column.name}",
        remedy="Use a smaller one or a larger distance.",
    )
