"""The lists of checks before and after an adjustment, as an engine calls them."""

from dataclasses import replace

import numpy as np
import pytest

from calib.calibration import CalibrationOptions
from calib.diagnosis.checks import check_adjustment, check_views
from calib.errors import InputMismatch
from calib.fit import fit_model
from tests.unit.calib.conftest import TARGET, Bench


@pytest.fixture
def views():
    return Bench().views(np.random.default_rng(1), 0.02)


def after(views):
    fitted = fit_model(views, CalibrationOptions(), "spherical")
    sigma = dict(zip(fitted.uncertainty.names, np.sqrt(np.diag(fitted.uncertainty.covariance)), strict=True))
    return check_adjustment(views, fitted.bundle, fitted.parameters, sigma)


def test_sound_views_give_no_note(views):
    assert check_views(views, known_r_mm=255.0) == ()
    assert after(views) == ()


def test_every_doubt_before_the_adjustment_is_a_note(views):
    wrong = [replace(view, target_mm=view.target_mm / 1000.0) for view in views]
    notes = check_views([*wrong, replace(wrong[0], name="again")])
    assert len(notes) == 2
    assert "pose-001 and again" in notes[0]
    assert "look like metres" in notes[1]


def test_points_outside_of_the_image_are_refused(views):
    with pytest.raises(InputMismatch, match="outside of the stated image size"):
        check_views([replace(view, image_size=(640, 480)) for view in views])


def test_every_doubt_after_the_adjustment_is_a_note(views):
    wrong = [replace(view, image_size=(1920, 1080)) for view in views]
    wrong[1] = replace(wrong[1], target_mm=wrong[1].target_mm + np.array([TARGET.pitch_mm, 0.0]))
    first, second = after(wrong)
    assert "shift the ids of view pose-002 by -1 column" in first
    assert "probably 1280 x 720" in second


def test_stars_that_cannot_be_projected_are_not_compared(views):
    fitted = fit_model(views, CalibrationOptions(), "spherical")
    turned = np.array(fitted.parameters.rotations)
    turned[1] = np.diag([1.0, -1.0, -1.0]) @ turned[1]  # the target is behind the camera
    behind = replace(fitted.parameters, rotations=turned)
    assert check_adjustment(views, fitted.bundle, behind, {}) == ()


def test_another_origin_is_a_note():
    poses = (
        (-5, 2),
        (0.5, -2.5, 10),
        (5, 2.5, -20),
        (0, 0, 45),
        (-5, -2, 90),
        (5, -2, 0),
        (0, 2.5, -60),
        (-3, 2, 20),
    )
    views = Bench().views(np.random.default_rng(4), 0.005, poses=poses)
    for place in (1, 4):
        views[place] = replace(views[place], points_px=views[place].points_px + 0.5)
    (note,) = after(views)
    assert "views pose-002, pose-005 lie" in note


def test_views_of_few_stars_are_not_judged(views):
    few = []
    for view in views:
        corners = [
            np.argmin(a * view.points_px[:, 0] + b * view.points_px[:, 1])
            for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
        ]
        few.append(
            replace(
                view,
                ids=view.ids[corners],
                points_px=view.points_px[corners],
                target_mm=view.target_mm[corners],
                covariances_px2=view.covariances_px2[corners],
            )
        )
    assert check_views(few) == ()
    assert after(few) == ()


@pytest.mark.parametrize("length", [25.4, 1000.0])
def test_another_unit_than_the_known_radius_shows_is_refused(views, length):
    wrong = [replace(view, target_mm=view.target_mm / length) for view in views]
    with pytest.raises(InputMismatch, match=r"target positions: .* Give them in mm\."):
        check_views(wrong, known_r_mm=255.0)
