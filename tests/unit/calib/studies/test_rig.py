"""Two cameras on one rig, against the truth of drawn rigs."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from drawn_rig import BOARD as CORNERS
from drawn_rig import SIGMA, Drawn
from slow_cases import slow

from calib.boards.board import Board
from calib.engine import CalibrationOptions, calibrate
from calib.errors import DegenerateViews, InputMismatch
from calib.model.rotation import exp_map, log_map
from calib.studies.rig import stated_cameras, through_collimator
from calib.studies.rig_boards import with_boards
from tests.unit.calib.conftest import Bench

TURN = exp_map(np.deg2rad([0.5, -1.0, 3.0]))


@cache
def two_cameras(seed, model="spherical"):
    bench, rng = Bench(), np.random.default_rng(seed)
    first = bench.views(rng, 0.05)
    second = [bench.view(v.name, TURN @ r, rng, 0.05) for v, r in zip(first, bench.rotations, strict=True)]
    return tuple(calibrate(views, CalibrationOptions(model)) for views in (first, second))


def test_the_relative_rotation_is_found_within_its_uncertainty():
    rigs = [through_collimator(*two_cameras(i)) for i in range(12)]
    z = np.array([log_map(rig.rotation @ TURN.T) / np.sqrt(np.diag(rig.pose_covariance)) for rig in rigs])
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.3)
    assert rigs[0].views == ("pose-001", "pose-002", "pose-003")
    assert sum(rig.rigid for rig in rigs) >= 11
    assert rigs[0].sigma_arcsec.max() < 60


@pytest.mark.slow
def test_what_both_cameras_say_about_one_collimator_counts_together():
    first, second = two_cameras(5, "joint")
    errors = second.rotation_errors
    other = replace(errors, names=tuple(f"other {name}" for name in errors.names))
    rig = through_collimator(first, second)
    apart = through_collimator(first, replace(second, rotation_errors=other))
    assert (rig.sigma_arcsec <= apart.sigma_arcsec).all()
    assert (rig.sigma_arcsec < 140).all()
    assert (np.abs(206265 * log_map(rig.rotation @ TURN.T)) < 2.0 * rig.sigma_arcsec).all()


def test_intrinsics_from_other_views_count_with_their_uncertainty(bench):
    z, sharper = [], []
    for seed in range(8):
        pair = two_cameras(seed)
        rng, stated = np.random.default_rng([3, seed]), []
        for calibration in pair:
            sigma = 0.3 * np.sqrt(np.diag(calibration.camera_covariance))
            true = [bench.truth[name] for name in calibration.camera.parameter_names]
            values = np.array(true) + sigma * rng.standard_normal(len(sigma))
            stated.append((calibration.camera.with_values(values), np.diag(sigma**2)))
        rig, alone = through_collimator(*pair, stated), through_collimator(*pair)
        z.append(log_map(rig.rotation @ TURN.T) / np.sqrt(np.diag(rig.pose_covariance)))
        sharper.append(rig.sigma_arcsec <= alone.sigma_arcsec)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.35)
    assert np.all(sharper)


def test_intrinsics_that_contradict_the_views_or_are_of_another_camera_are_refused():
    first, second = two_cameras(1)
    camera = first.camera
    longer = camera.with_values(camera.values * np.where(np.arange(len(camera.values)) < 2, 1.05, 1.0))
    with pytest.raises(InputMismatch, match="contradicts its views"):
        through_collimator(first, second, ((longer, first.camera_covariance), None))
    with pytest.raises(InputMismatch, match="another sensor"):
        through_collimator(first, second, (None, (replace(camera, image_size=(640, 480)), None)))


def test_a_rig_that_flexed_is_recognised():
    first, second = two_cameras(3)
    bent = second.rotations.copy()
    bent[1] = exp_map(np.deg2rad([0.0, 0.0, 0.05])) @ bent[1]
    rig_found = through_collimator(first, replace(second, rotations=bent))
    assert not rig_found.rigid
    assert np.linalg.norm(rig_found.residuals_arcsec, axis=1).argmax() == 1


def test_cameras_that_share_no_pose_have_no_relative_rotation():
    first, second = two_cameras(4)
    renamed = tuple(replace(view, name=f"other {view.name}") for view in second.views)
    with pytest.raises(DegenerateViews, match="share no pose"):
        through_collimator(first, replace(second, views=renamed))


@pytest.mark.slow
@pytest.mark.parametrize(("count", "least", "off_by"), [(12, 0.88, 3.0), slow(40, 0.92, 1.5)])
def test_drawn_rigs_lie_within_their_uncertainty_in_19_of_20_cases(count, least, off_by):
    inside, squares = [], []
    for seed in range(count):
        drawn = Drawn(seed)
        rig = with_boards(stated_cameras(*drawn.stated, [np.diag(SIGMA**2)] * 2), *drawn.views)
        off = drawn.off(rig)
        inside.append(np.abs(off) < 1.96 * np.sqrt(np.diag(rig.pose_covariance)))
        squares.append(off @ np.linalg.solve(rig.pose_covariance, off))
    assert least <= np.mean(inside) <= 0.98
    assert np.mean(squares) == pytest.approx(6.0, abs=off_by)


@pytest.mark.slow
def test_intrinsics_may_be_adjusted_with_the_rig():
    inside = []
    for seed in range(6):
        drawn = Drawn(seed, boards=14)
        rig = with_boards(stated_cameras(*drawn.stated), *drawn.views, free=True)
        inside.append(np.abs(drawn.off(rig)) < 1.96 * np.sqrt(np.diag(rig.pose_covariance)))
        assert abs(rig.first.fx - drawn.cameras[0].fx) < 4.0 * np.sqrt(rig.covariance[0, 0])
    assert np.mean(inside) >= 0.88


def test_the_collimator_turns_and_the_boards_place():
    drawn = Drawn(6)
    cameras = stated_cameras(*drawn.stated, [np.diag(SIGMA**2)] * 2)
    sigma = 2e-5
    known = np.zeros((15, 15))
    known[:12, :12], known[12:, 12:] = cameras.covariance, sigma**2 * np.eye(3)
    turned = replace(cameras, rotation=exp_map(np.full(3, 1e-5)) @ drawn.rotation, covariance=known)
    alone, both = with_boards(cameras, *drawn.views), with_boards(turned, *drawn.views)
    assert (both.sigma_arcsec < 206265 * 1.01 * sigma).all()
    assert (both.sigma_mm <= alone.sigma_mm).all()
    assert (np.abs(drawn.off(both)) < 4.0 * np.sqrt(np.diag(both.pose_covariance))).all()


def test_a_board_that_moved_between_the_recordings_is_refused():
    drawn = Drawn(1)
    first, second = drawn.views
    with pytest.raises(InputMismatch, match="do not fit one rig: at board-2"):
        with_boards(
            stated_cameras(*drawn.cameras),
            first,
            [*second[:2], replace(second[2], points_px=second[2].points_px + 30.0), *second[3:]],
        )


def test_a_camera_of_another_size_is_refused():
    drawn = Drawn(1)
    with pytest.raises(InputMismatch, match=r"camera has 1920 x 1200 px, the view .* has 1280 x 720 px"):
        with_boards(stated_cameras(*drawn.cameras[::-1]), *drawn.views)


def from_the_other_end(view):
    """Return a view of drawn boards, numbered from the other end."""
    return replace(view, ids=len(CORNERS) - 1 - view.ids, target_mm=CORNERS[-1] - view.target_mm)


@pytest.mark.parametrize("ends", [(1,) * 8, slow((0, 1, 1, 0, 0, 1, 0, 0)), (1, 1, 0, 1, 1, 0, 1, 1)])
def test_boards_that_one_camera_numbered_from_the_other_end_give_the_same_rig(ends):
    drawn, board = Drawn(4), Board("checkerboard", 11, 7, 20.0)
    first, second = drawn.views
    turned = [from_the_other_end(view) if end else view for view, end in zip(second, ends, strict=True)]
    right = with_boards(stated_cameras(*drawn.cameras), first, second)
    rig_found = with_boards(stated_cameras(*drawn.cameras), first, turned, board)
    assert rig_found.half_turned == tuple(view.name for view, end in zip(second, ends, strict=True) if end)
    assert rig_found.rotation == pytest.approx(right.rotation, abs=1e-9)
    assert rig_found.translation_mm == pytest.approx(right.translation_mm, abs=1e-6)
    with pytest.raises(InputMismatch):
        with_boards(stated_cameras(*drawn.cameras), first, turned, Board("checkerboard", 11, 8, 20.0))


def test_boards_that_are_numbered_alike_stay_so():
    drawn = Drawn(5)
    rig = with_boards(stated_cameras(*drawn.cameras), *drawn.views, Board("checkerboard", 11, 7, 20.0))
    assert rig.half_turned == ()
    assert np.linalg.norm(drawn.off(rig)[3:]) < 0.5
