"""Collimators out of focus: a pupil off the pivot or beside the axes sees other stars, which nothing may hide in U."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from slow_cases import slow

from calib import CalibrationOptions, calibrate
from tests.benchmarks.worlds.catalogue import result as drawn_result
from tests.unit.calib.conftest import Bench, over_u

RASTER = tuple((pan, tilt) for tilt in (-2.0, 0.0, 2.0) for pan in (-5.0, 0.0, 5.0))
ROLLED = tuple((*pose, roll) for pose, roll in zip(RASTER, 4 * (0, 90, 180, 270), strict=False))
#: The beam is wider than the views, so that no rim shows where the pupil is.
WIDE = Bench(half_angle_deg=40.0)


def recorded(bench, pupil_mm, defocus, poses, seed):
    """Views of a camera whose pupil lies at (3,) in the camera's axes, from where the gimbal's axes cross."""
    centres = []
    for pose in poses:
        moved = np.array(pupil_mm) @ bench.turn(*pose) - (0.0, 0.0, pupil_mm[2])
        centres.append(np.array(bench.centre) + defocus * moved)
    return bench.views(np.random.default_rng(seed), 0.02, poses, centres)


@pytest.mark.parametrize(
    ("off_mm", "defocus"),
    [(30.0, 0.06), *(slow(*case) for case in ((-30.0, 0.06), (15.0, -0.1)))],
)
def test_a_well_corrected_collimator_may_be_out_of_focus(off_mm, defocus):
    """Nothing is stated. Field curvature explains the views too, less probably: fx was 16 px wrong at U 12 px."""
    result = calibrate(recorded(WIDE, (0.0, 0.0, off_mm), defocus, RASTER, 5), CalibrationOptions())
    assert max(over_u(result, WIDE.truth)) < 1.0
    assert 2.0 * result.sigma["fx"] < 20.0  # with errors as published prescriptions have them


@pytest.mark.parametrize(
    ("focal_px", "beside_mm"),
    [
        (3345.0, (6.0, -5.0)),
        slow(1200.0, (-3.0, 7.0)),
        slow(3345.0, (-3.0, 7.0)),
        slow(1200.0, (6.0, -5.0)),
    ],
)
def test_a_pupil_beside_the_roll_axis_does_not_pass_for_another_principal_point(focal_px, beside_mm):
    """Out of focus by 0.05, it moves the image by up to 5 px, along axes that turn with the camera."""
    bench = replace(WIDE, fx=focal_px, fy=focal_px, k=(0.02, -0.05))
    result = calibrate(recorded(bench, (*beside_mm, 20.0), 0.05, ROLLED, 6), CalibrationOptions())
    assert max(over_u(result, bench.truth)) < 1.0


@dataclass
class CurvedField(Bench):
    """A collimator with the field curvature of a mirror, and a pupil beside the axis by 2 mm that rolls with the camera."""

    half_angle_deg: float = 40.0
    curvature: float = 0.5
    beside_mm: tuple = (2.0, -1.5)

    def project(self, target_mm, turn, centre):
        x, y, z = centre
        h = (target_mm - (x, y)) / -z
        beside_mm = np.array(self.beside_mm) @ turn[:2, :2]
        return super().project(
            target_mm - self.curvature * (h**2).sum(axis=1, keepdims=True) * beside_mm, turn, centre
        )


@pytest.mark.parametrize("seed", [6, slow(7)])
def test_field_curvature_beside_a_roll_axis_does_not_pass_for_another_principal_point(seed):
    """It turns with the camera. Without a term of its own, cx was 8 U wrong, or p1 and p2."""
    bench = CurvedField()
    result = calibrate(bench.views(np.random.default_rng(seed), 0.02, ROLLED), CalibrationOptions())
    assert max(over_u(result, bench.truth)) < 1.0
    for name in ("p1", "p2"):
        assert abs(result.values[name]) < result.U[name]


@pytest.mark.parametrize("seed", [423, slow(428)])
def test_a_result_says_where_it_expects_a_pupil_that_is_neither_stated_nor_seen(seed):
    """The pupil is far before the pivot. Views alone cannot show that, and fx is several U wrong."""
    unstated, stated = (drawn_result("raytraced-far", 3, seed, known)["notes"] for known in ("0", "r"))
    assert [note for note in unstated if re.search("The pupil is expected some [78] mm from the pivot", note)]
    assert not [note for note in stated if "mm from the pivot" in note]
