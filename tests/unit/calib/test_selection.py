"""The model is chosen by views it has not seen."""

from dataclasses import replace

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from calib.errors import DegenerateViews
from simulators.world.truth import COLLIMATORS
from tests.support.drawn_benches import NINE, draw_bench

AUTO = CalibrationOptions(model="auto", loss="l2")
POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60), (3, 0, 130), (0, 1, 75))


def by_model(result):
    return {candidate.model: candidate for candidate in result.candidates}


FLAT = CalibrationOptions(model="auto", radial_sigma=1e-4)


def test_an_ideal_collimator_with_a_target_known_to_be_flat_is_spherical(bench):
    result = calibrate(bench.views(np.random.default_rng(41), 0.05, poses=POSES), FLAT)
    assert result.model == "spherical"
    spherical, planar = by_model(result)["spherical"], by_model(result)["planar"]
    assert spherical.left_out_rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.15)
    assert spherical.left_out_rms_px == result.left_out_rms_px
    assert spherical.left_out_rms_px < planar.left_out_rms_px
    assert spherical.bic < planar.bic
    assert (spherical.parameters, planar.parameters) == (9 + 18, 6 + 36)
    assert any("spherical model was chosen" in note for note in result.notes)


def test_a_target_that_nobody_states_to_be_flat_keeps_its_radial_terms(bench):
    views = bench.views(np.random.default_rng(41), 0.05, poses=POSES)
    result = calibrate(views, AUTO)
    assert result.model == "radial"
    assert "spherical model would be chosen" in result.notes[-1]
    assert "cannot exclude a bow" in result.notes[-1]
    assert result.sigma["fx"] > 1.3 * calibrate(views, FLAT).sigma["fx"]


def test_a_collimator_out_of_focus_is_recognised_and_its_camera_found(defocused):
    bench, views = defocused
    result = calibrate(views, AUTO)
    assert result.model == "pupil"
    assert result.collimator.aberrations["pupil_shift"] == pytest.approx(0.15, abs=0.02)
    assert result.camera.fx == pytest.approx(bench.fx, abs=4 * result.sigma["fx"])
    spherical = calibrate(views, CalibrationOptions(loss="l2"))
    assert spherical.birge_ratio > 3
    assert abs(spherical.camera.fx - bench.fx) > 100


def test_a_moving_centre_is_worse_for_the_spherical_model(bench):
    rng = np.random.default_rng(42)
    centres = np.array(bench.centre) + rng.normal(scale=[4.0, 4.0, 8.0], size=(6, 3))
    result = calibrate(bench.views(rng, 0.05, poses=POSES, centres=centres), AUTO)
    spherical, planar = by_model(result)["spherical"], by_model(result)["planar"]
    assert planar.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    assert spherical.rms_px > 5 * planar.rms_px
    assert planar.bic < spherical.bic


@pytest.mark.parametrize("count", [2, 3])
def test_few_views_of_an_ideal_collimator_are_spherical_by_their_information_criterion(bench, count):
    result = calibrate(bench.views(np.random.default_rng(43), 0.05)[:count], FLAT)
    assert result.model == "spherical"
    assert "information criterion" in result.notes[-1]


def test_few_views_show_a_collimator_out_of_focus_too(defocused):
    bench, views = defocused
    result = calibrate(views[:4], AUTO)
    assert result.model == "pupil"
    assert result.camera.fx == pytest.approx(bench.fx, abs=4 * result.sigma["fx"])


def out_of_focus(bench, poses, seed, scale=0.15):
    """Views of a reticle out of focus by so much, the camera elsewhere in the pupil at each pose."""
    rng, views = np.random.default_rng(seed), []
    for i, pose in enumerate(poses):
        disc = np.array(bench.centre[:2]) + rng.uniform(-8, 8, 2)
        centre = np.array(bench.centre) - np.append(scale * (disc - bench.centre[:2]), 0.0)
        views.append(bench.view(f"pose-{i}", bench.turn(*pose), rng, 0.02, centre, disc=disc))
    return views


def test_views_that_show_a_part_of_the_beam_climb_the_ladder_with_those_that_show_it_whole(make_bench):
    bench = make_bench(half_angle_deg=4.8, centre=(97.0, 100.0, -255.0), size=(800, 700), cx=402.0, cy=353.0)
    poses = ((-2, 1), (1.5, -1, 10), (2, 1, -20), (-1, -1, 60), (1, 0.5, 130), (0, 0.5, 75), (6, 3), (-6, 3))
    result = calibrate(out_of_focus(bench, poses, 46), AUTO)
    assert result.model == "pupil"
    assert result.collimator.aberrations["pupil_shift"] == pytest.approx(0.15, abs=0.03)
    assert result.camera.fx == pytest.approx(bench.fx, abs=3 * result.sigma["fx"])
    assert any("out of view in pose-6, pose-7" in note for note in result.notes)


def test_rungs_that_need_a_rim_nobody_sees_are_left_out_and_named(make_bench):
    bench = make_bench(half_angle_deg=20.0)
    result = calibrate(bench.views(np.random.default_rng(47), 0.05, poses=POSES), FLAT)
    assert result.model == "spherical"
    assert [one.model for one in result.candidates] == ["spherical", "radial", "drift", "planar"]
    assert any(
        note.startswith("Not compared: pupil, rim, field, coma. The rim of the beam is out of view in 6 of 6")
        for note in result.notes
    )
    with pytest.raises(DegenerateViews, match=r"out of view in 3 of 3 views.*drift model"):
        calibrate(bench.views(), CalibrationOptions(model="pupil"))


def test_few_views_without_a_rim_let_the_centre_drift_where_it_does(make_bench):
    bench, rng = make_bench(half_angle_deg=20.0), np.random.default_rng(48)
    still = calibrate(bench.views(rng, 0.05), FLAT)
    assert still.model == "spherical"
    centres = np.array(bench.centre) + rng.normal(scale=0.3, size=(3, 3))
    moving = calibrate(bench.views(rng, 0.05, centres=centres), AUTO)
    assert moving.model == "drift"
    assert "the next best is the " in moving.notes[-1]


def test_a_model_that_predicts_worse_never_replaces_one_that_leaves_the_focal_length_open():
    glass = COLLIMATORS["like-bench"]
    drawn = draw_bench(replace(glass, rim_roll_mm=-glass.rim_roll_mm), NINE, 200)
    result = calibrate(drawn.views, CalibrationOptions(model="auto"))
    assert result.model == min(result.candidates, key=lambda one: one.left_out_rms_px).model == "radial"
    assert abs(result.camera.fx - drawn.truth.camera.fx) < result.coverage_factor * result.sigma["fx"]
    assert any("radial model explains the views, but does not determine fx" in note for note in result.notes)


def test_when_no_model_fits_the_first_reason_is_given(bench):
    with pytest.raises(DegenerateViews, match="same pose"):
        calibrate(bench.views(poses=((1, 1),) * 3), AUTO)


def test_a_missing_lens_term_is_not_blamed_on_the_collimator(make_bench):
    bench = make_bench(k=(0.06, -0.9, 0.004, -0.003))
    views = bench.views(np.random.default_rng(52), 0.02, poses=POSES)
    result = calibrate(views, CalibrationOptions(model="spherical"))
    assert any("support the lens model k1k2p1p2" in note for note in result.notes)
    assert not any("centre moves" in note for note in result.notes)
    chosen = calibrate(views, CalibrationOptions(model="spherical", distortion="auto"))
    assert set(chosen.camera.distortion) == {"k1", "k2", "p1", "p2"}
    assert chosen.camera.distortion["p1"] == pytest.approx(0.004, abs=4 * chosen.sigma["p1"])
    assert chosen.rms_px < 0.25 * result.rms_px


def test_an_adequate_lens_is_kept(bench):
    views = bench.views(np.random.default_rng(53), 0.02, poses=POSES)
    result = calibrate(views, CalibrationOptions(model="spherical", distortion="auto"))
    assert set(result.camera.distortion) == {"k1", "k2"}
    assert any("k1k2 was kept" in note for note in result.notes)
