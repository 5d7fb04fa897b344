"""Photographs of a checkerboard: each pixel asks where its rays meet the board."""

import numpy as np

from calib.model.rotation import exp_map

SQUARE_MM = 20.0


def photograph(camera, corners, turn_deg, place_mm, *, dark=30.0, bright=220.0):
    """What a camera sees of a board of so many inner corners; the middle of the board is at ``place_mm``.

    A pixel is the mean of 16 rays through it, each within 1e-4 px of its place.
    """
    steps = (np.arange(4) + 0.5) / 4 - 0.5
    width, height = camera.image_size
    v, u = np.mgrid[:height, :width]
    rotation, picture = exp_map(np.radians(np.array(turn_deg, float))), np.zeros((height, width))
    middle = SQUARE_MM * np.array([corners[0] - 1, corners[1] - 1, 0.0]) / 2
    centre = middle - rotation.T @ np.array(place_mm, float)
    rays = (camera.rays(np.column_stack([u.ravel(), v.ravel()])) @ rotation).reshape(height, width, 3)
    down, right = np.gradient(rays, axis=(0, 1))
    for du, dv in np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2):
        x, y, z = np.moveaxis(rays + du * right + dv * down, -1, 0)
        column, row = ((centre[i] - at_mm * centre[2] / z) / SQUARE_MM for i, at_mm in ((0, x), (1, y)))
        inside = (column > -1) & (column < corners[0]) & (row > -1) & (row < corners[1])
        is_dark = inside & ((np.floor(column) + np.floor(row)) % 2 == 0)
        picture += np.where(is_dark, dark, bright) / 16
    return picture
