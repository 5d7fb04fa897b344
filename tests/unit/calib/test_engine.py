"""From views to a calibrated camera."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_views import shifted
from slow_cases import first_quick, slow

from calib import CalibrationOptions, Passport, View, calibrate
from calib.errors import DegenerateViews, InputMismatch, NotConverged
from calib.joint import solve
from calib.model.gimbal_readings import GimbalReadings
from tests.unit.calib.conftest import Bench, FisheyeBench, over_u


@pytest.fixture(scope="module")
def noisy():
    """Three noisy views of the paper's camera, and their calibration."""
    views = Bench().views(np.random.default_rng(9), 0.05)
    return views, calibrate(views)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda view: replace(view, ids=np.arange(len(view))), r"point 0 is at .* in view .*, and at "),
        (lambda view: replace(view, points_px=view.target_mm, target_mm=view.points_px), "exchanged"),
        (lambda view: replace(view, points_px=view.points_px / view.image_size), "shares of the image"),
    ],
    ids=["numbers counted in each view", "image and target exchanged", "shares of the image"],
)
def test_points_that_are_not_what_they_are_given_as_are_refused(noisy, change, says):
    with pytest.raises(InputMismatch, match=says):
        calibrate([change(view) for view in noisy[0]])


def thinned(views, step):
    """Every step-th star of each view."""
    return [view.part(np.arange(len(view)) % step == 0) for view in views]


@pytest.mark.parametrize("model", ["spherical", "planar"])
def test_ideal_views_give_the_truth_back(bench, model):
    result = calibrate(bench.views(), CalibrationOptions(model=model))
    assert result.converged
    assert result.values == pytest.approx({n: bench.truth[n] for n in result.parameter_names}, rel=1e-6)
    assert np.allclose(result.rotations, bench.rotations, atol=1e-7)
    assert np.allclose(result.centres, bench.centre, atol=1e-3)
    assert result.rms_px < 1e-8


@pytest.mark.parametrize("count", first_quick([3, 2]))
def test_noisy_views_give_it_within_the_stated_uncertainty(bench, noisy, count):
    views, result = noisy
    if count < len(views):
        result = calibrate(views := views[:count])
    for name, sigma in result.sigma.items():
        value = result.values[name]
        assert abs(value - bench.truth.get(name, 0.0)) < 4 * sigma
    assert result.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    assert result.mean_px == pytest.approx(0.05 * np.sqrt(np.pi / 2), rel=0.1)
    assert [view.n for view in result.views] == [len(view) for view in views]


def test_a_fisheye_lens_can_be_asked_for():
    poses = ((-25, 10), (10, -15, 60), (30, 5, 20), (0, 0))
    bench = FisheyeBench(fx=700.0, fy=701.0, half_angle_deg=20.0, poses=poses)
    result = calibrate(thinned(bench.views(), 8), CalibrationOptions("spherical", distortion="fisheye"))
    assert result.camera.fx == pytest.approx(700.0, rel=1e-5)
    assert result.camera.distortion["kb1"] == pytest.approx(-0.03, abs=1e-4)
    assert result.to_dict()["camera"]["kb2"] == pytest.approx(0.02, abs=1e-3)


def _inside(result, views, bench):
    """The weights of the stars of each view that are not near the rim of the beam."""
    far = 0.8 * np.tan(np.radians(bench.half_angle_deg)) * bench.truth["r"]
    centre = np.array(bench.centre[:2])
    pairs = zip(result.weights, views, strict=True)
    return [w[np.hypot(*(view.target_mm - centre).T) < far] for w, view in pairs]


def test_residuals_are_found_minus_projected(bench):
    views = bench.views(np.random.default_rng(22), 0.02)
    views[1] = shifted(views[1], 7, [5.0, 0.0])
    result = calibrate(views)
    assert result.residuals_px[1][7] == pytest.approx([5.0, 0.0], abs=0.1)
    assert result.weights[1][7] < 0.1
    assert min(_inside(result, views, bench)[v].min() for v in (0, 2)) > 0.3


def test_the_result_is_plain_json_with_sigmas_under_the_same_names(noisy):
    _, result = noisy
    shape = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert set(shape["sigma"]) == {*shape["camera"], *shape["collimator"]}
    assert shape["covariance"]["names"] == list(shape["sigma"])
    assert np.sqrt(shape["covariance"]["matrix"][0][0]) == pytest.approx(shape["sigma"]["fx"])
    assert {"rms_px", "mean_px", "views", "model", "converged"} <= set(shape)
    assert np.allclose(np.diag(result.correlation), 1.0)
    at = [result.parameter_names.index(name) for name in ("fx", "r")]
    assert result.correlation[at[0], at[1]] > 0.9  # nearly one parameter


def test_the_planar_result_has_no_collimator_and_no_passport_to_give(bench):
    planar = calibrate(bench.views(np.random.default_rng(25), 0.05), CalibrationOptions(model="planar"))
    shape = planar.to_dict()
    assert shape["collimator"] is None
    assert set(shape["sigma"]) == set(shape["camera"])
    with pytest.raises(InputMismatch, match="planar"):
        planar.passport()


def test_views_of_two_image_sizes_are_refused(bench):
    views = bench.views()
    with pytest.raises(InputMismatch, match="640 x 480, 1280 x 720"):
        calibrate([replace(views[0], image_size=(640, 480)), *views[1:]])


def test_views_may_hold_lists_as_a_file_gives_them_and_come_from_a_generator(bench):
    views, options = bench.views(np.random.default_rng(9), 0.05), CalibrationOptions("spherical")
    arrays = ("ids", "points_px", "target_mm", "covariances_px2")
    lists = ([getattr(view, name).tolist() for name in arrays] for view in views)
    pairs = zip(views, lists, strict=True)
    read = (View(view.name, list(view.image_size), *given) for view, given in pairs)
    assert calibrate(read, options).values == calibrate(views, options).values


def test_two_views_of_one_name_are_refused(bench):
    views = bench.views()
    with pytest.raises(InputMismatch, match="pose-001"):
        calibrate([views[0], replace(views[1], name="pose-001")])


def test_a_search_cut_short_says_so(bench, monkeypatch):
    monkeypatch.setattr(solve, "ROUNDS", 2)
    with pytest.raises(NotConverged, match="2 steps"):
        calibrate(bench.views(np.random.default_rng(26), 0.05))


@pytest.mark.parametrize(
    "option",
    [
        {"model": "cubic"},
        {"loss": "tukey"},
        {"huber_px": 0.0},
        {"distortion": "k7"},
        {"radial_sigma": np.inf},
    ],
)
def test_an_option_without_meaning_is_refused(option):
    with pytest.raises(InputMismatch):
        CalibrationOptions(**option)


@pytest.mark.parametrize(
    ("model", "option", "ignored"),
    [
        ("joint", {"loss": "l2", "huber_px": 0.3}, "the loss, the limit of the loss"),
        ("joint", {"model": "auto", "loss": "cauchy"}, "the loss"),
        ("joint", {"loss": "huber"}, "the loss"),
        ("joint", {"radial_sigma": 0.1}, ""),
        ("joint", {}, ""),
        ("spherical", {"radial_sigma": 0.1}, "the prior of the radial term"),
        ("spherical", {"loss": "l2"}, ""),
    ],
)
def test_what_a_model_does_not_use_is_said(model, option, ignored):
    unused = CalibrationOptions(**{"model": model, **option}).unused
    assert unused == (ignored and f"The {model} model does not use: {ignored}.")


def test_what_the_model_of_a_calibration_does_not_use_is_a_note_and_a_remark(bench):
    options = CalibrationOptions(model="spherical", radial_sigma=0.1)
    result = calibrate(bench.views(np.random.default_rng(5), 0.05), options)
    for sentences in (result.notes, result.remarks):
        assert [text for text in sentences if "does not use" in text] == [options.unused]


def test_a_method_of_reference_says_that_readings_and_budget_are_not_used():
    readings = GimbalReadings(({"pan_deg": 1.0},), 0.002, 0.0, 0.0, None, "test")
    unused = CalibrationOptions("planar", gimbal=readings, budget=(object(),)).unused
    assert "readings of the gimbal, " in unused
    assert "budget" in unused


@pytest.mark.parametrize(("r_mm", "sigma_mm"), [(0.0, 0.05), (-250.0, 0.05), (250.0, -0.05), (250.0, np.nan)])
def test_a_certificate_without_meaning_is_refused(r_mm, sigma_mm):
    with pytest.raises(InputMismatch, match="passport"):
        Passport.of_radius(r_mm, sigma_mm)


def test_readings_of_other_views_are_refused(bench):
    views = bench.views(np.random.default_rng(5), 0.05)
    with pytest.raises(InputMismatch, match=r"1 readings .* 3 views"):
        calibrate(views, CalibrationOptions(gimbal=GimbalReadings(({"pan_deg": 1.0},), 0.002)))


def test_the_data_choose_the_lens_beside_a_certificate_too():
    views = FisheyeBench().views(np.random.default_rng(7), 0.02)
    options = CalibrationOptions(distortion="auto", passport=Passport.of_radius(255.0, 0.05))
    assert replace(options, model="joint").compares_lenses
    assert any("model fisheye." in note for note in calibrate(views, options).notes)


WIDE = {"fx": 420.0, "fy": 420.4, "poses": tuple((p, t) for t in (-20, 20) for p in (-38, 0, 38))}


@pytest.mark.parametrize(
    ("lens", "distortion", "named"),
    [slow(FisheyeBench, "k1k2", "fisheye"), slow(FisheyeBench, "fisheye", ""), (Bench, "k1k2", "")],
)
def test_in_a_wide_field_the_other_family_of_lenses_is_named_if_it_is_the_right_one(lens, distortion, named):
    views = thinned(lens(**WIDE, k=(-0.05, 0.01)).views(np.random.default_rng(9), 0.03), 3)
    try:
        text = " ".join(calibrate(views, CalibrationOptions(distortion=distortion)).notes)
    except DegenerateViews as error:  # so wrong a lens may leave the focal length undetermined
        text = str(error)
    assert ("lens is of another" in text) == bool(named)
    assert f"the distortion {named} explains" in text or not named
    assert "Add views" not in text


def test_sigmas_of_stars_in_another_unit_change_the_result_little(noisy):
    views, plain = noisy
    small = [replace(view, covariances_px2=view.covariances_px2 * 1e-6) for view in views]
    other = calibrate(small)
    for name in ("fx", "cx", "cy"):
        values = (getattr(result.camera, name) for result in (other, plain))
        assert abs(np.subtract(*values)) < plain.sigma[name]
        assert other.sigma[name] == pytest.approx(plain.sigma[name], rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("stretched", [slow(0.95), 1.1])
def test_pixels_that_are_not_square_are_named_and_the_focal_lengths_are_right(bench, stretched):
    """Images that a program has stretched along one direction."""
    views = [
        replace(view, image_size=(1280, 792), points_px=view.points_px * (1.0, stretched))
        for view in bench.views(np.random.default_rng(6), 0.02)
    ]
    result = calibrate(views)
    assert any("'square pixels'" in note for note in result.notes)
    assert max(over_u(result, {"fx": bench.fx, "fy": stretched * bench.fy}, ("fx", "fy"))) < 1.0


def test_a_mirror_off_its_axis_does_not_make_pixels_oblong(make_bench):
    """It enlarges one direction more than the other. Without a roll, only a prior tells this from oblong pixels."""
    poses = tuple((pan, tilt) for tilt in (-2.0, 0.0, 2.0) for pan in (-5.0, 0.0, 5.0))
    bench = make_bench(poses=poses, half_angle_deg=40.0)
    foot = np.array(bench.centre[:2])
    views = [
        replace(view, target_mm=foot + (view.target_mm - foot) * (1.001, 0.999))
        for view in bench.views(np.random.default_rng(71), 0.05)
    ]
    result = calibrate(views, CalibrationOptions(passport=Passport.of_radius(255.0, 0.05, length="seen")))
    assert not [note for note in result.notes if "'square pixels'" in note]
    assert max(over_u(result, bench.truth, ("fx", "fy"))) < 1.0


@pytest.mark.slow
def test_a_true_certificate_is_not_refused_for_poses_that_only_roll(make_bench):
    """They hardly show the collimator's radius, so they do not contradict its unit."""
    rolled = make_bench(poses=((0, 0), (0, 0, 40), (0, 0, 90), (0, 0, 135)))
    for seed in range(3):
        views = rolled.views(np.random.default_rng(seed), 0.05)
        result = calibrate(views, CalibrationOptions(passport=Passport.of_radius(255.0, 0.05)))
        assert max(over_u(result, rolled.truth, ["fx"])) < 2.0


def test_views_that_hardly_determine_the_focal_length_are_named_weak(make_bench, noisy):
    narrow = make_bench(half_angle_deg=4.0, poses=((-4, 0), (4, 0.3, 20)))
    result = calibrate(narrow.views(np.random.default_rng(27), 0.05))
    assert result.sigma["fx"] > 0.01 * result.camera.fx
    (note,) = [note for note in result.notes if "Weak geometry" in note]
    assert note.startswith("Weak geometry: f")
    assert "poses turned farther" in note
    _, strong = noisy
    assert not [note for note in strong.notes if "Weak" in note]


def test_a_target_whose_origin_is_far_away_is_calibrated_alike(noisy):
    views, here = noisy
    far = [replace(view, target_mm=view.target_mm + np.array([5000.0, -3000.0])) for view in views]
    there = calibrate(far)
    assert there.camera.fx == pytest.approx(here.camera.fx, abs=0.1 * here.sigma["fx"])
