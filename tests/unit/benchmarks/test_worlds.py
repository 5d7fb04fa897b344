"""The worlds that judge the engine are what they claim to be."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import calib
from tests.benchmarks.worlds import geometry, judge, polynomial
from tests.benchmarks.worlds.bench import NINE
from tests.benchmarks.worlds.knowledge import Answer


def without_noise(world):
    glass = replace(world.glass, print_scale=np.zeros(2))
    gimbal = replace(world.gimbal, scales=np.ones(2), squareness=0.0, eccentricity_deg=0.0, wobble_deg=0.0)
    return replace(world, glass=glass, gimbal=gimbal, star_px=0.0, pose_field_px=0.0, bad_share=0.0)


def test_the_worlds_print_has_the_ids_and_positions_of_the_target():
    ids, mm = geometry.printed_stars()
    target = calib.StarTarget()
    assert ids.tolist() == target.ids.tolist()
    assert mm == pytest.approx(target.positions_mm(ids), abs=1e-9)


def test_an_ideal_collimator_is_a_pinhole_before_a_sphere_as_opencv_projects_it():
    world = without_noise(polynomial.draw_world(5, "ideal"))
    values = {**world.camera.values, "p1": 4e-4, "p2": -3e-4, "k3": 2.0}
    world = replace(world, camera=replace(world.camera, values=values))
    for view, (pan, tilt) in zip(polynomial.record(world, 5, NINE).views, NINE, strict=True):
        rotation = world.gimbal.rotation(np.array([pan, tilt]), _noise(5, (pan, tilt)))
        foot = np.array([*world.glass.foot_mm, -world.glass.r])
        k = np.array([[values["fx"], 0, values["cx"]], [0, values["fy"], values["cy"]], [0, 0, 1]])
        lens = np.array([values[name] for name in ("k1", "k2", "p1", "p2", "k3")])
        solid = np.column_stack([view.mm, np.zeros(len(view.mm))])
        exact, _ = cv2.projectPoints(solid, cv2.Rodrigues(rotation)[0], -rotation @ foot, k, lens)
        assert len(view.ids) > 100
        assert np.abs(exact[:, 0] - view.px).max() < 1e-9


def _noise(seed, pose):
    lasting = np.random.default_rng((seed, 3, 0, *polynomial.pose_key(pose)))
    return 0.002 * lasting.normal(size=2)


@pytest.mark.parametrize("family", ["p1p2k3", "fisheye"])
def test_the_judges_corner_is_that_of_the_projection_map(family):
    camera = polynomial.draw_camera(np.random.default_rng(3), family)
    lens = {name: value for name, value in camera.values.items() if name not in judge.CENTRE}
    centre = [camera.values[name] for name in judge.CENTRE]
    model = calib.CameraModel(*centre, geometry.SIZE, lens)
    spread = np.random.default_rng(4).normal(size=(len(camera.values), len(camera.values)))
    sizes = np.diag([1.0 if name in judge.CENTRE else 1e-3 for name in model.parameter_names])
    covariance = sizes @ spread @ spread.T @ sizes
    values = {name: camera.values[name] for name in model.parameter_names}
    answer = Answer(values, covariance, 2.0, {}, (), "", 0.0, None, None)
    error, sigma = judge.corner(answer, camera)
    mapped = calib.projection_uncertainty(model, covariance).sigma_px[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert sigma == pytest.approx(mapped.max(), rel=0.02)
    assert error == pytest.approx(0.0, abs=1e-6)
    turned = replace(camera, image_of=lambda rays: camera.project(rays @ geometry.turn([1e-4, 2e-4, 3e-4]).T))
    assert judge.corner(answer, turned)[0] == pytest.approx(0.0, abs=1e-3)
