"""One camera in numbers, and OpenCV's projection as the oracle of what a reader made of a file of it."""

import cv2
import numpy as np

SIZE = (1280, 720)
K = [[1050.3, 0.0, 644.2], [0.0, 1049.1, 357.9], [0.0, 0.0, 1.0]]
FLAT_K = [number for row in K for number in row]
FOCAL_AND_CENTRE = [1050.3, 1049.1, 644.2, 357.9]
D14 = [-0.12, 0.08, 5e-4, -7e-4, -0.02, 0.01, -0.02, 0.005, 0.004, -0.003, 0.006, 0.002, 0.02, -0.015]
D5, FISHEYE = D14[:5], [-0.03, 0.011, -0.006, 0.002]
POINTS = np.array([(x, y) for x in np.linspace(0, 1279, 9) for y in np.linspace(0, 719, 7)])


def off_px(camera, coefficients, *, fisheye=False, matrix=K, skew_px=0.0):
    """Return how far from the pixels OpenCV projects the rays of a camera, px."""
    rays = camera.rays(POINTS)
    matrix, still = np.array(matrix), np.zeros(3)
    if fisheye:
        alpha = skew_px / matrix[0, 0]
        lens = np.array(coefficients)
        seen = cv2.fisheye.projectPoints(rays[:, None], still, still, matrix, lens, alpha=alpha)[0]
    else:
        seen = cv2.projectPoints(rays, still, still, matrix, np.array(coefficients))[0]
    return np.abs(seen.reshape(-1, 2) - POINTS).max()
