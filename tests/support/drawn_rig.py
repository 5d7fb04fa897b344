"""Rigs of two cameras drawn at random, and the boards that both saw."""

import numpy as np

from bench.solve.exports import camera_info
from calib import CameraModel, StarTarget, View
from calib.model.rotation import exp_map, log_map

SIZES = (1280, 720), (1920, 1200)
SIGMA = np.array([1.0, 1.0, 1.2, 1.4, 6e-3, 3e-2])
BOARD = np.array([[20.0 * c, 20.0 * r] for r in range(7) for c in range(11)])


class Drawn:
    """A rig drawn at random, and the boards that both cameras saw, with noise."""

    def __init__(self, seed, boards=8, sigma_px=0.1, sizes=SIZES):
        rng = np.random.default_rng([11, seed])
        self.cameras = []
        for size in sizes:
            f = rng.uniform(1.1, 1.6) * size[0]
            lens = {"k1": rng.normal(0, 0.1), "k2": rng.normal(0, 0.05)}
            self.cameras.append(CameraModel(f, f * 1.0004, size[0] / 2 + 4, size[1] / 2 - 6, size, lens))
        self.rotation = exp_map(np.deg2rad(rng.normal(0, 4, 3)))
        self.translation = np.array([rng.uniform(-90, 90), rng.uniform(-40, 40), rng.normal(0, 10)])
        self.views = [], []
        while len(self.views[0]) < boards:
            turn = exp_map(np.deg2rad(rng.normal(0, 22, 3)))
            centre = turn[:, :2] @ BOARD.mean(axis=0)
            place = np.array([*rng.uniform(-80, 80, 2), rng.uniform(450, 900)]) - centre
            points = BOARD @ turn[:, :2].T + place
            seen = [
                camera.project(p)
                for camera, p in zip(
                    self.cameras, (points, points @ self.rotation.T + self.translation), strict=True
                )
            ]
            if all(
                np.isfinite(s).all() and (s > 5).all() and (s < np.array(size) - 5).all()
                for s, size in zip(seen, sizes, strict=True)
            ):
                for views, s, size in zip(self.views, seen, sizes, strict=True):
                    noisy = s + sigma_px * rng.standard_normal(s.shape)
                    cov = np.tile(np.eye(2), (len(s), 1, 1))  # as of a file of points
                    views.append(View(f"board-{len(views)}", size, np.arange(len(s)), noisy, BOARD, cov))
        # Calibrations whose errors are as they state.
        self.stated = [c.with_values(c.values + SIGMA * rng.standard_normal(6)) for c in self.cameras]

    def off(self, rig):
        turned = log_map(rig.rotation @ self.rotation.T)
        return np.concatenate([turned, rig.translation_mm - self.translation])

    def write_boards(self, folder):
        """Write each camera's point files of the boards into `left` and `right`, and its intrinsics beside them."""
        for name, views, camera in zip(("left", "right"), self.views, self.cameras, strict=True):
            (folder / name).mkdir()
            for view in views:
                rows = np.column_stack([view.points_px + 0.5, view.target_mm, view.ids])
                np.savetxt(folder / name / f"{view.name}.csv", rows, delimiter=",")
            (folder / f"{name}.yaml").write_bytes(camera_info(camera, name, camera.matrix))

    def write_stars(self, *folders):
        """Write what each camera sees behind a collimator, in four poses with noise: every third star of the target."""
        rng, target = np.random.default_rng(4), StarTarget()
        plane = target.positions_mm(target.ids) - target.tag_centre_mm
        disc = (np.linalg.norm(plane, axis=1) < 255.0 * np.tan(np.deg2rad(12.0))) & (target.ids % 3 == 0)
        rays = np.column_stack([plane, np.full(len(plane), 255.0)])[disc]
        poses = [(5.0, 2.0, 0.0), (-4.0, 5.0, 30.0), (0.5, -6.0, -80.0), (6.0, -3.0, 160.0)]
        turns = np.eye(3), self.rotation
        for folder, camera, turn in zip(folders, self.cameras, turns, strict=False):
            folder.mkdir()
            for at, (pan, tilt, roll) in enumerate(poses):
                held = exp_map(np.deg2rad([tilt, pan, 0.0])) @ exp_map(np.deg2rad([0.0, 0.0, roll]))
                seen = camera.project(rays @ (turn @ held).T) + 0.05 * rng.standard_normal((len(rays), 2))
                inside = ((seen > 3) & (seen < np.array(camera.image_size) - 4)).all(axis=1)
                rows = np.column_stack([seen + 0.5, target.positions_mm(target.ids)[disc], target.ids[disc]])
                np.savetxt(folder / f"pose-{at}.csv", rows[inside], delimiter=",")
