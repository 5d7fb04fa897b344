"""The camera with fewer lens coefficients that projects most like another one over its sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.model.camera import CameraModel

_STEPS = 20
_POINTS_ACROSS = 33


def nearest_lens(camera: CameraModel, names: Sequence[str]) -> tuple[CameraModel, float]:
    """Fit a camera with only the given coefficients; return it, and its largest difference over the sensor, px.

    Gauss-Newton over a grid of equal weights; focal lengths and principal point are free, the axes stay.
    """
    width, height = camera.image_size
    across = np.linspace(0, width - 1, _POINTS_ACROSS), np.linspace(0, height - 1, _POINTS_ACROSS)
    pixels = np.stack(np.meshgrid(*across), axis=-1).reshape(-1, 2)
    rays = camera.rays(pixels)
    seen = np.isfinite(rays).all(axis=1)
    pixels, rays = pixels[seen], rays[seen]
    lens = {name: camera.distortion.get(name, 0.0) for name in names}
    found = CameraModel(camera.fx, camera.fy, camera.cx, camera.cy, camera.image_size, lens)
    for _ in range(_STEPS):
        there, _, by_values = found.project_with_jacobians(rays)
        slope = by_values.reshape(-1, by_values.shape[2])
        scale = np.linalg.norm(slope, axis=0)
        step = np.linalg.lstsq(slope / scale, (pixels - there).ravel(), rcond=None)[0] / scale
        found = found.with_values(found.values + step)
        if np.abs(step * scale).max() < 1e-9:
            break
    return found, float(np.linalg.norm(found.project(rays) - pixels, axis=1).max())
