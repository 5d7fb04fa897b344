"""The images of one repetition: poses before the collimator, or placements of a board, recorded by a simulated camera.

All randomness follows from the repetition's seed: columns that ask for the same images get the same ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from virtual_camera import VirtualCamera

from calib import CalibrationError, CameraModel, StarTarget, View, detect_view, make_images
from calib.boards.board import Board
from calib.boards.detect import detect_board
from calib.events.flicker import Flicker
from calib.model.rotation import exp_map, log_map
from calib.stars.rim import downweight_vignetted
from tests.benchmarks.worlds.bench import Bench
from tests.benchmarks.worlds.knowledge import views_of

from .columns import STAR_METHODS, Column
from .moving import WAY_PX, record_moving
from .strangers import camera_model, stranger_bench

#: Largest angles of the poses, degrees: as those of the included sequences.
_PAN_DEG, _TILT_DEG = 6.0, 2.5
_THREE = ((-6.0, 2.0), (6.0, 2.0), (0.0, -3.0))
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
_MARGIN_PX = 12.0
_MOST_DRAWS = 200
#: Images of the other camera that calibrates the collimator, and what is added to its seeds.
_REFERENCE_IMAGES, _OTHER_CAMERA = 9, 500_000


@dataclass(frozen=True)
class Images:
    """Views of one repetition, and what is true."""

    views: tuple[View, ...]
    # For each view the readings of the gimbal, degrees; empty for a board.
    readings_deg: tuple[Mapping[str, float], ...]
    camera: CameraModel  # The true camera, focused as before the collimator
    truth: Mapping[str, Any]  # True parameters by part
    missed: tuple[str, ...]  # For each image without a view, the reason
    # Views of another camera before the same collimator, for its passport; None if they were not asked for.
    reference: Images | None = None
    bench: Bench | None = None  # A stranger's


def recordings_key(column: Column) -> tuple[Any, ...]:
    """Return what the recordings of a column depend on; columns with the same key share their recordings."""
    if column.method in STAR_METHODS:
        key = ("stars", column.collimator, column.noise, column.images)
        return (*key, "reference") if column.known_collimator else key
    board = ("board", column.noise, column.images, *column.board.model_dump().values())
    return ("moving", *board) if column.method == "reconstruction" else board


def finding_key(column: Column) -> tuple[Any, ...]:
    """Return what the search for the target depends on, besides the recordings."""
    return (column.method == "reconstruction" and column.two_sided,)


@dataclass(frozen=True)
class Recordings:
    """Event images of one repetition."""

    images: Sequence[NDArray[np.float32]]  # (H, W) float32 event images
    names: Sequence[str]
    # For each image the readings of the gimbal, degrees; empty for a board.
    readings_deg: Sequence[Mapping[str, float]]
    # True parameters by part; those of the camera are focused as before the collimator.
    truth: Mapping[str, Any]
    # Images of another camera before the same collimator; None if they were not asked for.
    reference: Recordings | None = None
    # For a moving board the pictures of the filter as published; else empty.
    one_sided: Sequence[NDArray[np.float32]] = ()
    bench: Bench | None = None  # A stranger's, which has its stars already


def record(column: Column, seed: int) -> Recordings:
    """Record the images of one repetition, which all columns with the same `recordings_key` share."""
    if column.method not in STAR_METHODS:
        return _record_boards(column, seed)
    if column.collimator == "stranger":
        return Recordings((), (), (), {}, bench=stranger_bench(seed, column.images))
    own = _record_stars(column, seed, seed)
    if not column.known_collimator:
        return own
    other = column.model_copy(update={"images": _REFERENCE_IMAGES})
    return replace(own, reference=_record_stars(other, seed, seed + _OTHER_CAMERA))


def find_targets(column: Column, recorded: Recordings) -> Images:
    """Find the targets of recorded images, as a column asks."""
    if recorded.bench is not None:
        views = tuple(views_of(recorded.bench))
        camera = camera_model(recorded.bench.camera, views[0].image_size)
        return Images(views, tuple(recorded.bench.readings_deg), camera, {}, (), bench=recorded.bench)
    chosen = column.board
    board = Board("checkerboard", chosen.columns, chosen.rows, chosen.square_mm)
    target, stars = StarTarget(), column.method in STAR_METHODS
    published = column.method == "reconstruction" and not column.two_sided
    shown = recorded.one_sided if published else recorded.images
    views, kept, missed = [], [], []
    for number, (image, name) in enumerate(zip(shown, recorded.names, strict=True)):
        try:
            if stars:
                views.append(downweight_vignetted(detect_view(image, target, name=name), target))
            else:
                views.append(detect_board(image, board, name=name))
        except CalibrationError as error:
            missed.append(str(error))
            continue
        kept.append(number)
    readings = tuple(recorded.readings_deg[i] for i in kept) if recorded.readings_deg else ()
    truth = recorded.truth
    reference = None if recorded.reference is None else find_targets(column, recorded.reference)
    return Images(tuple(views), readings, true_camera(truth["camera"]), truth, tuple(missed), reference)


def star_poses(count: int) -> list[tuple[float, float]]:
    """Return poses, pan and tilt, degrees: three of ``three_pose``, others on a sunflower spiral (Vogel, 1979)."""
    if count == len(_THREE):
        return list(_THREE)
    radii = [math.sqrt((i + 0.5) / count) for i in range(count)]
    return [
        (_PAN_DEG * radius * math.cos(i * _GOLDEN_ANGLE), _TILT_DEG * radius * math.sin(i * _GOLDEN_ANGLE))
        for i, radius in enumerate(radii)
    ]


def gimbal_section(seed: int) -> dict[str, Any]:
    """Return section ``gimbal`` of a simulation: errors as the station states them in `methods`."""
    rng = np.random.default_rng((seed, 11))
    return {
        "wobble_deg": 0.001,
        "eccentricity_deg": 0.001,
        "scale": dict(zip(("pan", "tilt", "roll"), (2e-4 * rng.normal(size=3)).tolist(), strict=True)),
        "nonorthogonality_deg": float(abs(0.02 * rng.normal())),
        "reading_sigma_deg": 0.002,
        "seed": seed,
    }


def _record_stars(column: Column, seed: int, camera_seed: int) -> Recordings:
    section = {
        "collimator": {"profile": column.collimator, "glass_seed": 1000 + seed},
        "gimbal": gimbal_section(seed),
        "noise": column.noise,
    }
    camera = VirtualCamera(section, camera_seed)
    poses = [{"pan": pan, "tilt": tilt} for pan, tilt in star_poses(column.images)]
    images = [_event_image(camera, pose, 1000 * camera_seed + number) for number, pose in enumerate(poses, 1)]
    names = [f"pose {number}" for number in range(1, len(poses) + 1)]
    readings = [{f"{axis}_deg": angle for axis, angle in pose.items()} for pose in poses]
    return Recordings(images, names, readings, camera.truth())


def _record_boards(column: Column, seed: int) -> Recordings:
    rng = np.random.default_rng((seed, 21))
    truth = VirtualCamera({}, seed).truth()
    camera = true_camera(truth["camera"])
    moving = column.method == "reconstruction"
    margin_px = _MARGIN_PX + (WAY_PX / 2.0 if moving else 0.0)
    images, one_sided, names = [], [], []
    for number in range(1, column.images + 1):
        placed = _placement(column, camera, rng, margin_px)
        section = {"noise": column.noise, **_lens_section(column), "screen": placed}
        section["optics"] = {"mounting_deg": [0.0, 0.0, 0.0]}
        if moving:
            pictures = record_moving(section, camera.fx, seed, number)
            images.append(pictures[True])
            one_sided.append(pictures[False])
        else:
            images.append(_event_image(VirtualCamera(section, seed), {}, 1000 * seed + number))
        names.append(f"placement {number}")
    return Recordings(images, names, (), truth, one_sided=one_sided)


def _lens_section(column: Column) -> dict[str, Any]:
    """Return the lens of a board: sharp everywhere, focused at infinity, or focused on the board."""
    board = column.board
    if board.focus == "sharp":
        return {}
    distance = "infinity" if board.focus == "infinity" else 1e-3 * board.distance_mm
    return {"lens": {"focus_distance_m": distance, "f_number": board.f_number}}


def _placement(
    column: Column, camera: CameraModel, rng: np.random.Generator, margin_px: float
) -> dict[str, Any]:
    """Draw where a person holds the screen: wholly in view, tilted, turned and off the middle."""
    board = column.board
    size = np.array([board.columns + 1, board.rows + 1]) * board.square_mm
    corners = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * [*size, 1.0]
    for _ in range(_MOST_DRAWS):
        tilt, around, roll = board.tilt_deg * rng.random(), 2 * math.pi * rng.random(), 180.0 * rng.random()
        turn = np.radians(tilt) * np.array([math.cos(around), math.sin(around), 0.0])
        rotation = exp_map(turn) @ exp_map(np.radians([0.0, 0.0, roll]))
        distance = board.distance_mm * (1.0 + 0.15 * rng.uniform(-1, 1))
        middle = camera.rays(np.array([[rng.uniform(0, s - 1) for s in camera.image_size]]))[0]
        position = distance * middle / middle[2]
        points = camera.project(corners @ rotation.T + position)
        inside = (points > margin_px) & (points < np.array(camera.image_size) - 1 - margin_px)
        if inside.all():
            return {
                "columns": board.columns,
                "rows": board.rows,
                "pitch_mm": board.square_mm,
                "position_mm": position.tolist(),
                "turn_deg": np.degrees(log_map(rotation)).tolist(),
            }
    raise CalibrationError(
        "The board does not fit into the picture.",
        where=f"column {column.name}",
        remedy="Use a smaller board or a larger distance.",
    )


def _event_image(camera: Any, angles_deg: Mapping[str, float], seed: int) -> NDArray[np.float32]:
    """Record and gather two periods of the light in the best event image."""
    seen = camera.capture(angles_deg, seed=seed)
    period_us = 1e6 / seen.light_hz
    flicker = Flicker(period_us, seen.first_edge_us, 0.5, 0.0, 0, "triggers")
    t, x, y, p = seen.events
    images = make_images(t, x, y, p, seen.image_size, flicker, window_us=(0.0, seen.duration_us))
    return images.best().image


def true_camera(truth: Mapping[str, Any]) -> CameraModel:
    """Return the true camera (section ``camera`` of the truth) as the engine describes it: k1, k2, p1, p2 and k3."""
    lens = {name: float(truth[name]) for name in ("k1", "k2", "p1", "p2", "k3")}
    fx, fy, cx, cy = (float(truth[name]) for name in ("fx", "fy", "cx", "cy"))
    return CameraModel(fx, fy, cx, cy, (int(truth["width"]), int(truth["height"])), lens)
