"""Photographs of printed circles: 100 rays through each pixel near a circle, blur, a gamma, and noise; OpenCV's lens."""

import cv2
import numpy as np

DARK, LIGHT = 20.0, 235.0
RAYS = 10


def photograph(board, radius_mm, camera, placed, size, *, light_on_dark=False, blur_px=0.0, gamma=1.0):
    """What a camera sees of a board of circles, from 0 to 255, not rounded.

    camera: OpenCV's matrix and coefficients. placed: rotation vector and translation, mm, of the board.
    """
    (matrix, lens), (turn, shift) = camera, placed
    width, height = size
    covered = np.zeros((height, width))
    angles = np.linspace(0, 2 * np.pi, 24)
    around = 1.3 * radius_mm * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    for x, y in board.points_mm:
        shown = cv2.projectPoints(around + np.array([x, y, 0]), turn, shift, matrix, lens)[0].reshape(-1, 2)
        left, top = np.floor(shown.min(axis=0)).astype(int)
        right, bottom = np.ceil(shown.max(axis=0)).astype(int) + 1
        assert min(left, top, width - right, height - bottom) > 0, "the board leaves the image"
        steps = (np.arange(RAYS) + 0.5) / RAYS - 0.5
        u = (np.arange(left, right)[:, None] + steps).ravel()
        v = (np.arange(top, bottom)[:, None] + steps).ravel()
        px = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
        rays = cv2.undistortPoints(px, matrix, lens, criteria=(3, 60, 1e-10)).reshape(-1, 2)
        rays = np.column_stack([rays, np.ones(len(rays))])
        rotation = cv2.Rodrigues(np.asarray(turn, float))[0]
        meets = rays * ((rotation[:, 2] @ shift) / (rays @ rotation[:, 2]))[:, None]
        from_centre_mm = np.hypot(*((meets - shift) @ rotation[:, :2] - [x, y]).T)
        cells = (from_centre_mm < radius_mm).reshape(bottom - top, RAYS, right - left, RAYS)
        covered[top:bottom, left:right] += cells.mean(axis=(1, 3))
    first, second = (DARK, LIGHT) if light_on_dark else (LIGHT, DARK)
    picture = first + (second - first) * covered
    if blur_px:
        picture = cv2.GaussianBlur(picture, (0, 0), blur_px)
    return 255 * (picture / 255) ** (1 / gamma)
