"""A lens whose series goes on beyond r^6: a result states k1 to k3, which project as it does, with what they leave open."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib import CalibrationOptions, CameraModel, calibrate
from calib.joint.reported import without_r8
from calib.model.lens import distort_with_jacobians
from tests.unit.calib.conftest import Bench

# Pan, tilt and roll, degrees; the columns are rolled differently.
POSES = tuple((pan, tilt, 40.0 * pan) for tilt in (-8.0, 0.0, 8.0) for pan in (-14.0, 0.0, 14.0))
#: At the corner, 24 degrees off the axis, the term of r^8 moves a star by 2.5 px.
LENS = {"k1": -0.43, "k2": 0.06, "k3": 0.25, "r8": 0.7}
WIDE = CameraModel(1620.0, 1621.0, 645.0, 357.0, (1280, 720), LENS)


@dataclass
class LongSeries(Bench):
    """A camera with a term of r^8, projected here and not by the engine."""

    centre: tuple = (97.0, 140.1, -120.0)
    half_angle_deg: float = 50.0
    poses: tuple = POSES

    def project(self, target_mm, turn, centre):
        points = (np.column_stack([target_mm, np.zeros(len(target_mm))]) - centre) @ turn.T
        x, y = (points[:, :2] / points[:, 2:]).T
        r2, k = x * x + y * y, WIDE.distortion
        radial = 1.0 + r2 * (k["k1"] + r2 * (k["k2"] + r2 * (k["k3"] + r2 * k["r8"])))
        return np.column_stack([WIDE.fx * x * radial + WIDE.cx, WIDE.fy * y * radial + WIDE.cy])


@pytest.fixture(scope="module")
def result():
    return calibrate(LongSeries().views(np.random.default_rng(4), 0.01), CalibrationOptions())


@pytest.mark.parametrize("name", ["fx", "fy", "cx", "cy", "k1", "k2", "k3"])
def test_every_coefficient_of_a_long_series_lies_within_its_uncertainty(result, name):
    assert abs(result.values[name] - WIDE.to_dict()[name]) < result.U[name]


def away_px(camera):
    """How far a camera projects from the true one over the sensor, beside what another principal point does."""
    width, height = WIDE.image_size
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 17), np.linspace(0, height - 1, 9)), axis=-1)
    rays = WIDE.rays(grid.reshape(-1, 2))
    shift = camera.cx - WIDE.cx, camera.cy - WIDE.cy
    return np.abs(camera.project(rays) - WIDE.project(rays) - shift).max()


def test_the_camera_that_is_stated_projects_as_the_lens_does(result):
    """But for 1/32 of what the term moves there, and for what the noise leaves."""
    assert "r8" not in result.camera.distortion
    assert away_px(without_r8(WIDE)) < 2.5 / 32
    assert away_px(result.camera) < 2.5 / 32 + 0.05
    assert away_px(replace(WIDE, distortion=WIDE.distortion | {"r8": 0.0})) > 2.0


def test_the_derivatives_of_a_long_series_are_those_of_its_differences():
    points, lens = np.random.default_rng(5).normal(0.0, 0.2, (20, 2)), dict(WIDE.distortion)
    bent, by_points, by_coefficients = distort_with_jacobians(points, lens)
    step = 1e-6
    for axis in (0, 1):
        moved = distort_with_jacobians(points + step * np.eye(2)[axis], lens)[0]
        assert (moved - bent) / step == pytest.approx(by_points[:, :, axis], abs=1e-5)
    moved = distort_with_jacobians(points, lens | {"r8": lens["r8"] + step})[0]
    assert (moved - bent) / step == pytest.approx(by_coefficients[:, :, 3], abs=1e-8)
