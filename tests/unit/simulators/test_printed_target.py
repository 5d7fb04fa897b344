"""The simulated bench shows the target that its station describes: of any family, of either polarity."""

import numpy as np
import pytest

from calib.stars.detect import detect_stars
from calib.target import StarTarget
from simulators.errors import ConfigError
from simulators.optics.picture import pose_rotation, render, star_centres
from simulators.world.truth_config import truth_from_config

SMALL = {"squares": [32, 30], "pitch_mm": 4.0, "tag_square": [14, 13]}


@pytest.mark.parametrize(
    ("family", "tag", "side", "segments", "polarity"),
    [
        ("36h11", 586, 4, 16, "negative"),
        ("36h10", 2000, 5, 12, "positive"),
        ("25h9", 7, 4, 16, "positive"),
        ("16h5", 11, 3, 16, "negative"),
    ],
)
def test_every_star_of_a_target_of_its_own_is_found_with_its_id(family, tag, side, segments, polarity):
    own = {**SMALL, "tag_family": family, "tag_id": tag, "tag_squares": side, "segments": segments}
    truth = truth_from_config({"target": own, "reticle": {"polarity": polarity}})
    assert truth.target.tag_family == family
    rotation = pose_rotation({"pan": 3.0, "tilt": -2.0}, truth.optics)
    found = detect_stars(render(truth, rotation), truth.target)
    ids, points = star_centres(truth, rotation, clearance=1.0, border_px=36.0)
    assert found.named_by == "tag"
    assert len(ids) > 150
    assert set(ids) <= set(found.view.ids)
    of_found = found.view.points_px[np.searchsorted(found.view.ids, ids)]
    assert np.abs(of_found - points).max() < 0.05


@pytest.mark.parametrize("segments", [8, 12, 20, 24, 32])
def test_stars_with_other_numbers_of_segments_are_found(segments):
    """An eighth of a star may hold one colour only, or more of one than of the other."""
    truth = truth_from_config({"target": {**SMALL, "segments": segments}})
    rotation = pose_rotation({"pan": 2.0}, truth.optics)
    found = detect_stars(render(truth, rotation), truth.target).view
    ids, points = star_centres(truth, rotation, clearance=1.0, border_px=36.0)
    assert set(ids) <= set(found.ids)
    assert np.abs(found.points_px[np.searchsorted(found.ids, ids)] - points).max() < 0.06


def test_a_negative_reticle_is_dark_where_a_positive_one_is_bright():
    images = []
    for polarity in ("positive", "negative"):
        truth = truth_from_config({"reticle": {"polarity": polarity}, "optics": {"black": 0.0}})
        images.append(render(truth, pose_rotation({}, truth.optics)))
    sum_of_both = images[0] + images[1]
    assert sum_of_both.max() > 0.9
    assert np.abs(sum_of_both[330:390, 610:670] - sum_of_both[330:390, 610:670].mean()).max() < 0.02


def test_the_axis_of_the_collimator_stays_near_the_tag_unless_its_place_is_given():
    standard = truth_from_config({}).collimator
    own = truth_from_config({"target": SMALL}).collimator
    middle, own_middle = StarTarget().tag_centre_mm, truth_from_config({"target": SMALL}).target.tag_centre_mm
    assert own.x - own_middle[0] == pytest.approx(standard.x - middle[0])
    assert own.y - own_middle[1] == pytest.approx(standard.y - middle[1])
    assert truth_from_config({"target": SMALL, "collimator": {"x": 5.0}}).collimator.x == 5.0
    assert truth_from_config({"target": {"squares": [50, 72]}}).collimator == standard


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"target": 5}, "target: A mapping is expected"),
        ({"target": {"pitch": 4}}, r"target\.pitch: Unknown key"),
        ({"target": {"squares": [3]}}, r"target\.squares: 2 numbers are expected"),
        ({"target": {"tag_id": 999}}, "target: No such target can be printed: .* has tags 0 to 586"),
        ({"reticle": {"polarity": "both"}}, r"reticle\.polarity: Unknown polarity 'both'"),
    ],
)
def test_a_target_that_cannot_be_is_refused(given, said):
    with pytest.raises(ConfigError, match=said):
        truth_from_config(given)
