"""Stars of a pose predicted from earlier poses and the gimbal: within the stated uncertainty, or refused."""

import numpy as np
import pytest

from calib.errors import DegenerateViews
from calib.model.homography import apply_homography, fit_homography
from calib.model.rotation import euler_zxy
from calib.stars.pointing import MAX_SIGMA_PITCHES, LabelledView, predict_grid
from calib.target import StarTarget

TARGET = StarTarget()

THREE = ({"pan": -5, "tilt": 1}, {"pan": 5, "tilt": -1}, {"pan": 0, "tilt": 3})
FAR = ({"pan": 11, "tilt": 3}, {"pan": -9, "tilt": 7}, {"pan": 0, "tilt": -8})


class Gimbal:
    """A camera mounted at an angle on a gimbal that stands at an angle in front of a collimator."""

    def __init__(self, bench, mounting=(0.0, 0.0, 0.0), standing=(0.3, -0.2, 12.0)):
        self.bench = bench
        self.mounting, self.standing = euler_zxy(*mounting), euler_zxy(*standing)

    def view(self, reading):
        head = euler_zxy(*(reading.get(axis, 0.0) for axis in ("pan", "tilt", "roll")))
        return self.bench.view("p", self.mounting @ head @ self.standing)

    def labelled_views(self, readings):
        views = [self.view(reading) for reading in readings]
        grids = [fit_homography(TARGET.node_of(v.ids).astype(float), v.points_px) for v in views]
        return [LabelledView(*pair) for pair in zip(grids, readings, strict=True)]


def off_node(expected, view):
    """Return the distances of the stars from their predicted nodes, pitches."""
    there = apply_homography(np.linalg.inv(expected.grid), view.points_px)
    return np.linalg.norm(there - TARGET.node_of(view.ids), axis=1)


@pytest.mark.parametrize("mounting", [(0, 0, 0), (1.5, -1.0, 12.0)])
@pytest.mark.parametrize("reading", FAR)
def test_poses_with_the_tag_predict_the_stars_of_others(bench, mounting, reading):
    gimbal = Gimbal(bench, mounting)
    expected = predict_grid(gimbal.labelled_views(THREE), reading, bench.size, TARGET.pitch_mm)
    assert off_node(expected, gimbal.view(reading)).max() < 3 * expected.sigma_pitches < 0.45


def test_two_poses_predict_along_the_direction_they_span_and_one_predicts_nothing(bench):
    gimbal = Gimbal(bench)
    two = gimbal.labelled_views(THREE[:2])
    expected = predict_grid(two, {"pan": 11, "tilt": -2}, bench.size, TARGET.pitch_mm)
    assert off_node(expected, gimbal.view({"pan": 11, "tilt": -2})).max() < 0.1
    for seen in ([], two[:1]):
        with pytest.raises(DegenerateViews, match="the tag in view"):
            predict_grid(seen, {"pan": 11, "tilt": -2}, bench.size, TARGET.pitch_mm)


def test_an_axis_that_has_not_moved_yet_predicts_nothing(bench):
    seen = Gimbal(bench).labelled_views(THREE)
    with pytest.raises(DegenerateViews, match="do not tell"):
        predict_grid(seen, {"tilt": -8, "roll": 90}, bench.size, TARGET.pitch_mm)


def test_readings_of_the_wrong_sign_are_refused(bench):
    labelled = Gimbal(bench).labelled_views(THREE)
    turned = [s.reading_deg | {"pan": -s.reading_deg["pan"]} for s in labelled]
    seen = [s._replace(reading_deg=of) for s, of in zip(labelled, turned, strict=True)]
    with pytest.raises(DegenerateViews, match="do not tell"):
        predict_grid(seen, {"pan": -11, "tilt": 3}, bench.size, TARGET.pitch_mm)


def test_a_reading_that_slipped_enlarges_the_uncertainty(bench):
    seen = Gimbal(bench).labelled_views((*THREE, {"pan": 4, "tilt": 3}))
    sure = predict_grid(seen, FAR[0], bench.size, TARGET.pitch_mm).sigma_pitches
    slipped = [*seen[:-1], seen[-1]._replace(reading_deg={"pan": 4.3, "tilt": 3})]
    try:
        unsure = predict_grid(slipped, FAR[0], bench.size, TARGET.pitch_mm).sigma_pitches
    except DegenerateViews:
        unsure = MAX_SIGMA_PITCHES
    assert unsure > 2 * sure
