"""Stars beside the tag and at the border of the pattern are where they are, whether the paper there is bright or dark."""

import numpy as np
import pytest

from calib.stars.detect import detect_stars
from calib.stars.printed_star import MIN_REACH, cell_reach, open_sides
from calib.target import StarTarget
from simulators.optics.picture import pose_rotation, project, render
from simulators.world.truth import Truth
from simulators.world.truth_config import truth_from_config

OWN = {"squares": [40, 44], "pitch_mm": 4.5, "tag_square": [18, 20]}
NARROW = {"squares": [16, 14], "pitch_mm": 4.5, "tag_square": [6, 5]}
CAMERA = {"width": 640, "height": 360, "fx": 1672.0, "fy": 1672.0, "cx": 320.0, "cy": 180.0}
POSES = ({"pan": -6.0, "tilt": 2.0, "roll": 9.0}, {"pan": 0.0, "tilt": -3.0, "roll": 24.0})


def bench(polarity: str, target: dict, segments: int) -> Truth:
    own = {**target, "segments": segments}
    return truth_from_config({"target": own, "reticle": {"polarity": polarity}, "camera": CAMERA})


def black_and_white(share: np.ndarray, seed: int) -> np.ndarray:
    """About the image of a bright square flicker: a pixel fires at a small share of the light."""
    thresholds = 0.04 * np.exp(0.12 * np.random.default_rng(seed).standard_normal(share.shape))
    return (share > thresholds).astype(np.float32)


def away_px(truth: Truth, *, grey: bool) -> np.ndarray:
    """How far open stars lie from the paper next to them, px: positive away from it."""
    shifts_px = []
    for seed, pose in enumerate(POSES):
        rotation = pose_rotation(pose, truth.optics)
        share = render(truth, rotation)
        view = detect_stars(share if grey else black_and_white(share, seed), truth.target).view
        nodes = truth.target.node_of(view.ids)
        off = view.points_px - project(np.asarray(view.target_mm), rotation, truth)
        steps = truth.target.pitch_mm * np.array([[1.0, 0.0], [0.0, 1.0]])
        for axis, step in enumerate(np.eye(2, dtype=np.int64)):
            along = project(view.target_mm + steps[axis], rotation, truth) - view.points_px
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            for sign in (1, -1):
                beyond = nodes + sign * step
                alone = (truth.target.id_at(beyond[:, 0], beyond[:, 1]) < 0) & (_lit(view, truth))
                shifts_px.append(-sign * (off * along).sum(axis=1)[alone])
    return np.concatenate(shifts_px)


def _lit(view, truth):
    """Whether a star is well inside the beam."""
    c = truth.collimator
    radius = c.r * np.tan(np.radians(c.half_angle_deg))
    return np.hypot(*(view.target_mm - (c.x, c.y)).T) < 0.75 * radius


@pytest.mark.parametrize("polarity", ["positive", "negative"])
@pytest.mark.parametrize(("target", "segments"), [(OWN, 12), (OWN, 16), (NARROW, 16)])
def test_open_stars_are_not_drawn_towards_the_paper_nor_pushed_away(polarity, target, segments):
    shifts_px = away_px(bench(polarity, target, segments), grey=False)
    assert len(shifts_px) > 30
    assert abs(shifts_px.mean()) < 0.012


@pytest.mark.parametrize("polarity", ["positive", "negative"])
def test_the_same_in_a_grey_image(polarity):
    shifts_px = away_px(bench(polarity, OWN, 12), grey=True)
    assert abs(shifts_px.mean()) < 0.004


def test_open_are_the_stars_around_the_tag_and_at_the_border():
    target = StarTarget(squares_x=16, squares_y=14, tag_square=(6, 5), tag_squares=4)
    nodes = target.node_of(target.ids)
    pairs = zip(nodes.tolist(), open_sides(target, nodes), strict=True)
    sides_of = {tuple(node): tuple(sides) for node, sides in pairs}
    assert sides_of[0, 3] == sides_of[14, 8] == (True, False)
    assert sides_of[7, 0] == sides_of[7, 12] == (False, True)
    assert sides_of[0, 0] == (True, True)
    assert sides_of[2, 2] == (False, False)
    # The tag stands in squares 6 to 9 and 5 to 8; the nodes 5 to 9 and 4 to 8 hold no star.
    assert sides_of[4, 6] == sides_of[10, 6] == (True, False)
    assert sides_of[7, 3] == sides_of[7, 9] == (False, True)
    assert sides_of[4, 3] == sides_of[10, 9] == (True, False)  # touches the paper with a corner
    assert sides_of[3, 6] == sides_of[7, 2] == (False, False)
    assert not open_sides(target, np.array([[7, 6], [-1, 3]])).any()  # no stars


def test_some_of_the_cell_is_left_however_wide_the_blur_is():
    assert cell_reach(np.array([[True, False]]), 0.49, 0.4).tolist() == [[MIN_REACH, 0.49]]
