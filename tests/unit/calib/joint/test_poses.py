"""Which views are one pose: by their stars."""

from dataclasses import replace

import numpy as np
import pytest

from calib import CameraModel, Collimator
from calib.adjustment.parameters import AdjustmentParameters
from calib.joint.poses import seen_poses
from calib.model.rotation import exp_map
from tests.benchmarks.worlds.catalogue import WORLDS
from tests.benchmarks.worlds.knowledge import views_of

NOISE_PX = 0.02


def turned_alike(smooth_px, *, bad_px=0.0, kept=slice(None), copies=False):
    """Views of one pose, each turned by some 0.02 degrees, with noise and so large a smooth difference at the corner."""
    bench = WORLDS["polynomial"](3, 9, 1, 0)
    view, camera = views_of(bench)[4], CameraModel(**_named(bench.camera.values), image_size=(1280, 720))
    rng, rays, views = np.random.default_rng(2), camera.rays(view.points_px), []
    for k, size in enumerate(smooth_px):
        px = camera.project(rays @ exp_map(np.radians(rng.normal(0.0, 0.02, 3))).T)
        along = (view.points_px - [640.0, 360.0]) / 640.0
        px = px + size * np.column_stack([along[:, 0] ** 2, along[:, 0] * along[:, 1]])
        px += rng.normal(0.0, NOISE_PX, px.shape)
        px[:3] += bad_px * (k % 2)
        own = replace(view, name=str(k), points_px=views[0].points_px if copies and k else px)
        views.append(own.part(np.isin(np.arange(len(px)), np.arange(len(px))[kept])))
    return views, camera


def _named(values):
    pinhole = {name: values[name] for name in ("fx", "fy", "cx", "cy")}
    return {**pinhole, "distortion": {name: value for name, value in values.items() if name not in pinhole}}


def poses(views, camera):
    alike = np.tile(np.eye(3), (len(views), 1, 1))
    start = AdjustmentParameters(camera, Collimator(100.0, 100.0, 250.0), alike, np.zeros((len(views), 3)))
    return seen_poses(views, start).of_views.tolist()


@pytest.mark.parametrize("bad_px", [0.0, 8.0])
def test_views_turned_alike_are_one_pose_if_they_differ_by_a_turn_and_noise(bad_px):
    assert poses(*turned_alike([0.0] * 6, bad_px=bad_px)) == [0] * 6


def test_copies_of_a_view_are_one_pose():
    assert poses(*turned_alike([0.0] * 3, copies=True)) == [0] * 3


def test_a_difference_much_smaller_than_the_noise_makes_no_new_pose():
    """A focal length that drifts from repeat to repeat does so."""
    assert poses(*turned_alike([0.0, 0.03, 0.0])) == [0, 0, 0]


@pytest.mark.parametrize("bad_px", [0.0, 8.0])
def test_a_camera_that_a_hand_moved_and_turned_back_shows_another_pose(bad_px):
    views, camera = turned_alike([0.0, 0.2, -0.2, 0.0, 0.2, -0.2], bad_px=bad_px)
    assert poses(views, camera) == [0, 1, 2, 0, 1, 2]


def test_few_stars_in_common_do_not_make_a_new_pose():
    assert poses(*turned_alike([0.0, 0.2], kept=slice(0, 240, 40))) == [0, 0]
