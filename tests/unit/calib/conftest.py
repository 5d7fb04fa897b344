"""A camera in front of a collimator, imagined with OpenCV's projection: nothing of the engine takes part."""

from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest

from calib import StarTarget, View

TARGET = StarTarget()


def rotation(pan_deg, tilt_deg, roll_deg=0.0):
    """Rz(roll) Rx(tilt) Ry(pan)."""
    pan, tilt, roll = np.deg2rad([pan_deg, tilt_deg, roll_deg])
    return (
        cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
        @ cv2.Rodrigues(np.array([tilt, 0.0, 0.0]))[0]
        @ cv2.Rodrigues(np.array([0.0, pan, 0.0]))[0]
    )


@dataclass
class Bench:
    """The paper's camera behind a collimator whose disc spans 24 degrees."""

    fx: float = 3345.06
    fy: float = 3345.27
    cx: float = 642.10
    cy: float = 363.32
    k: tuple = (0.06, -0.90)
    size: tuple = (1280, 720)
    centre: tuple = (97.0, 140.1, -255.0)
    half_angle_deg: float = 12.0
    poses: tuple = field(default=((-5.0, 2.0), (0.5, -2.5, 10.0), (5.0, 2.5, -20.0)))

    @property
    def truth(self):
        x, y, z = self.centre
        pinhole = dict(zip(("fx", "fy", "cx", "cy"), (self.fx, self.fy, self.cx, self.cy), strict=True))
        pinhole |= {"k1": self.k[0], "k2": self.k[1]}
        return {**pinhole, "x": x, "y": y, "r": -z}

    @property
    def rotations(self):
        return np.array([rotation(*pose) for pose in self.poses])

    def project(self, target_mm, turn, centre):
        matrix = np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])
        world = np.column_stack([target_mm, np.zeros(len(target_mm))])
        shift = -turn @ centre
        coefficients = np.array([*self.k, 0.0, 0.0][:4])
        return cv2.projectPoints(world, cv2.Rodrigues(turn)[0], shift, matrix, coefficients)[0][:, 0]

    turn = staticmethod(rotation)

    def view(self, name, turn, rng=None, sigma_px=0.0, centre=None, disc=None):
        """The stars inside the disc (about the centre, unless told) and the frame, with noise of sigma_px."""
        centre = np.asarray(self.centre if centre is None else centre)
        ids = TARGET.ids
        target = TARGET.positions_mm(ids)
        radius = np.linalg.norm(target - (centre[:2] if disc is None else disc), axis=1)
        pixels = self.project(target, turn, centre)
        inside = (pixels > 8).all(axis=1) & (pixels < np.array(self.size) - 9).all(axis=1)
        seen = inside & (radius < -centre[2] * np.tan(np.deg2rad(self.half_angle_deg)))
        points_px = pixels[seen]
        if rng is not None:
            points_px = points_px + sigma_px * rng.standard_normal(points_px.shape)
        covariances = np.tile(np.eye(2) * max(sigma_px, 1e-2) ** 2, (len(points_px), 1, 1))
        return View(name, self.size, ids[seen], points_px, target[seen], covariances)

    def views(self, rng=None, sigma_px=0.0, poses=None, centres=None):
        poses = self.poses if poses is None else poses
        centres = [None] * len(poses) if centres is None else centres
        return [
            self.view(f"pose-{i + 1:03d}", rotation(*pose), rng, sigma_px, centre)
            for i, (pose, centre) in enumerate(zip(poses, centres, strict=True))
        ]


class FisheyeBench(Bench):
    """The same through a fisheye lens, OpenCV's."""

    bent: tuple = (-0.03, 0.02, 0.0, 0.0)

    def project(self, target_mm, turn, centre):
        matrix = np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])
        points = (np.column_stack([target_mm, np.zeros(len(target_mm))]) - centre)[:, None]
        vector, bent = cv2.Rodrigues(turn)[0], np.array(self.bent)
        return cv2.fisheye.projectPoints(points, vector, np.zeros(3), matrix, bent)[0][:, 0]


def over_u(result, truth, names=("fx", "fy", "cx", "cy")):
    """The error of each of these values over its U; ``truth`` has the true ones by name."""
    return [abs(result.values[name] - truth[name]) / result.U[name] for name in names]


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def make_bench():
    return Bench


@pytest.fixture
def defocused():
    """A bench whose camera stands elsewhere in the pupil at each pose, behind a reticle out of focus.

    The disc moves with the camera, and the centre moves the other way by 0.15 of that.
    """
    bench, rng = Bench(half_angle_deg=4.8, centre=(97.0, 100.0, -255.0)), np.random.default_rng(45)
    poses = ((-3, 1), (0.5, -1, 10), (3, 1, -20), (-2, -1, 60), (2, 0.5, 130), (0, 0.5, 75))
    views = []
    for i, pose in enumerate(poses):
        disc = np.array(bench.centre[:2]) + rng.uniform(-12, 12, 2)
        centre = np.array(bench.centre) - np.append(0.15 * (disc - bench.centre[:2]), 0.0)
        views.append(bench.view(f"pose-{i}", rotation(*pose), rng, 0.02, centre, disc=disc))
    return bench, views
