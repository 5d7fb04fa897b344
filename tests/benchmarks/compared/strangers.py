"""Benches of the worlds of strangers that compare with the others: a 16 mm lens, read by the gimbal, no fisheye."""

from functools import lru_cache
from itertools import count

import numpy as np

from calib.model.camera import CameraModel
from calib.model.lens import OPENCV
from tests.benchmarks.worlds import stranger
from tests.benchmarks.worlds.bench import Bench, Camera

#: Terms that describe the lenses of strangers to 0.01 px; the eighth power of the radius is not among them.
_TERMS = ("k1", "k2", "p1", "p2", "k3", "s1", "s2", "s3", "s4")
_FOCAL_MM = 16.0
_ACROSS = (33, 19)


@lru_cache(maxsize=2)
def stranger_bench(number: int, images: int) -> Bench:
    """Return the number-th bench of such a kind, from 1, with some images."""
    fitting = (seed for seed in count(1) if _fits(seed))
    seed = next(seed for place, seed in enumerate(fitting, 1) if place == number)
    return stranger.draw(seed, images, 1, 0)


@lru_cache
def _fits(seed: int) -> bool:
    world = stranger.draw(seed, 2, 1, 0)
    facts = world.facts
    return bool(facts["focal_mm"] == _FOCAL_MM and not facts["by_hand"] and world.camera.family != "fisheye")


def camera_model(camera: Camera, image_size: tuple[int, int]) -> CameraModel:
    """Return the true camera as the engine describes cameras: the same fx, fy, cx, cy; other terms by least squares."""
    u, v = np.meshgrid(*(np.linspace(0, side - 1, n) for side, n in zip(image_size, _ACROSS, strict=True)))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays = camera.rays(pixels)
    pinhole = (camera.values[name] for name in ("fx", "fy", "cx", "cy"))
    plain = CameraModel(*pinhole, image_size, {name: 0.0 for name in OPENCV if name in _TERMS})
    model = plain
    for _ in range(3):
        at, _, by_parameters = model.project_with_jacobians(rays)
        columns = by_parameters[:, :, 4:].reshape(2 * len(rays), -1)
        step = np.linalg.lstsq(columns, (pixels - at).ravel(), rcond=None)[0]
        model = model.with_values(model.values + np.concatenate([np.zeros(4), step]))
    return model
