"""Views that cannot be right: what each check says of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.calibration import CalibrationOptions
from calib.diagnosis.checks import check_adjustment, check_views
from calib.diagnosis.duplicate_views import find_duplicates
from calib.diagnosis.image_origin import find_other_origins
from calib.diagnosis.image_size import check_image_size, require_points_inside
from calib.diagnosis.target_units import check_target_units, closed_form_radius
from calib.errors import InputMismatch
from calib.fit import fit_model, initialize
from calib.model.camera import CameraModel
from tests.unit.calib.conftest import TARGET, Bench, rotation


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


# ---------------------------------------------------------------- image size


def of_size(views, size):
    return [replace(view, image_size=size) for view in views]


def camera(size, cx=642.0, cy=363.0):
    return CameraModel(3345.0, 3345.0, cx, cy, size)


@pytest.mark.parametrize("size", [(640, 480), (720, 1280), (1279, 600)])
def test_points_outside_are_refused_with_a_size_that_holds_them(views, size):
    with pytest.raises(InputMismatch, match=r"view pose-001: .*The points fit into 1280 x 720") as raised:
        require_points_inside(of_size(views, size))
    assert f"{size[0]} x {size[1]}" in raised.value.what


def test_points_with_a_corner_origin_may_lie_at_the_border(views):
    points = views[0].points_px.copy()
    points[0], points[1] = (-0.5, -1.0), (1280.0, 719.5)
    require_points_inside([replace(views[0], points_px=points)])
    points[2] = (-1.2, 100.0)
    with pytest.raises(InputMismatch, match=r"outermost at \(-1.2, 100.0\)"):
        require_points_inside([replace(views[0], points_px=points)])


@pytest.mark.parametrize("size", [(1920, 1080), (2048, 1536), (1280, 1280), (2448, 2048)])
def test_a_size_that_is_too_large_is_named_with_a_plausible_one(views, size):
    doubt = check_image_size(of_size(views, size), camera(size), (1.0, 1.0))
    assert doubt.plausible == (1280, 720)
    assert doubt.sentence.endswith("The image size is probably 1280 x 720.")


def test_a_principal_point_far_off_without_a_known_size_is_only_a_doubt(views):
    doubt = check_image_size(views, camera((1280, 720), cx=900.0), (1.0, 1.0))
    assert doubt.plausible is None
    assert "lies 261 px from the middle" in doubt.sentence
    assert doubt.sentence.endswith(
        "Check the image size, and whether the points come from a part of the image."
    )


@pytest.mark.parametrize(("cx", "sigma"), [(642.0, 1.0), (500.0, 1.0), (900.0, 50.0)])
def test_a_plausible_or_uncertain_principal_point_is_no_doubt(views, cx, sigma):
    assert check_image_size(views, camera((1280, 720), cx=cx), (sigma, sigma)) is None


# ---------------------------------------------------------------- views that are there twice


def part(view, kept):
    return replace(
        view,
        name=f"{view.name}-part",
        ids=view.ids[kept],
        points_px=view.points_px[kept],
        target_mm=view.target_mm[kept],
        covariances_px2=view.covariances_px2[kept],
    )


def test_one_recording_under_two_names_is_named():
    views = Bench().views(np.random.default_rng(1), 0.02)
    (found,) = find_duplicates([*views, replace(views[1], name="again")])
    assert found.identical
    assert (found.first, found.second, found.stars) == ("pose-002", "again", len(views[1]))
    assert found.sentence.startswith("Views pose-002 and again are the same measurement")


def test_a_part_of_a_view_in_another_order_is_a_duplicate():
    view = Bench().views(np.random.default_rng(2), 0.02)[0]
    order = np.random.default_rng(3).permutation(len(view))[:50]
    (found,) = find_duplicates([view, part(view, order)])
    assert found.identical
    assert found.stars == 50


def test_a_copy_with_rounded_points_is_nearly_the_same():
    view = Bench().views(np.random.default_rng(4), 0.02)[0]
    rounded = replace(view, name="rounded", points_px=np.round(view.points_px, 2))
    (found,) = find_duplicates([view, rounded])
    assert not found.identical
    assert found.rms_px == pytest.approx(0.01 / np.sqrt(6), rel=0.1)
    assert "nearly the same measurement" in found.sentence


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 999), sigma=st.sampled_from([0.005, 0.02, 0.2]))
def test_two_recordings_of_one_pose_are_no_duplicates(seed, sigma):
    rng, bench, turn = np.random.default_rng(seed), Bench(), rotation(1, 2, 3)
    assert not find_duplicates([bench.view(name, turn, rng, sigma) for name in ("one", "two", "three")])


def test_views_without_common_stars_are_not_compared():
    view = Bench().views(np.random.default_rng(5), 0.02)[0]
    first, second = (part(view, slice(60)), replace(part(view, slice(60, None)), name="rest"))
    assert not find_duplicates([first, second])


# ---------------------------------------------------------------- units of the target

UNITS = [("metres", 1000.0), ("centimetres", 10.0), ("inches", 25.4), ("micrometres", 0.001)]


def in_unit(views, length_mm):
    return [replace(view, target_mm=view.target_mm / length_mm) for view in views]


@pytest.mark.parametrize(("unit", "length"), UNITS)
def test_a_known_radius_names_the_unit(views, unit, length):
    found = check_target_units(in_unit(views, length), known_r_mm=255.0)
    assert found.unit == unit
    assert f"The target positions look like {unit}; give them in mm." in found.sentence


@pytest.mark.parametrize(("unit", "length"), [("metres", 1000.0), ("micrometres", 0.001)])
def test_an_implausible_pitch_needs_no_known_radius(views, unit, length):
    assert check_target_units(in_unit(views, length)).unit == unit


@pytest.mark.parametrize("length", [25.4, 10.0])
def test_inches_without_a_known_radius_cannot_be_noticed(views, length):
    assert check_target_units(in_unit(views, length)) is None


def test_an_implausible_radius_is_noticed(views):
    found = check_target_units(in_unit(views, 60.0), known_r_mm=300.0)
    assert found.unit == ""
    assert found.why == "The views give a collimator radius of 4.21 mm, which is implausible."
    assert found.sentence.endswith("Check that the target positions are in mm.")


@pytest.mark.parametrize("known", [None, 255.0, 200.0, 300.0])
def test_millimetres_are_not_doubted(views, known):
    assert check_target_units(views, known_r_mm=known) is None


def test_one_view_has_no_closed_form_and_no_doubt(views):
    assert closed_form_radius(views[:1]) is None
    assert check_target_units(views[:1], known_r_mm=255.0) is None


# ---------------------------------------------------------------- origin of the image

POSES = (
    (-5, 2),
    (0.5, -2.5, 10),
    (5, 2.5, -20),
    (0, 0, 45),
    (-5, -2, 90),
    (5, -2, 0),
    (0, 2.5, -60),
    (-3, 2, 20),
)

BENCH = Bench()


def views_of(seed, sigma=0.02, poses=POSES):
    return BENCH.views(np.random.default_rng(seed), sigma, poses=poses)


def moved(view, by):
    return replace(view, points_px=view.points_px + by)


def others(views):
    bundle, start = initialize(views, CalibrationOptions(), "spherical")
    return find_other_origins(views, bundle, refine(bundle, start, Loss("l2"), 60).parameters)


@pytest.mark.parametrize("by", [0.5, -0.5])
def test_a_few_views_with_another_origin_are_named(by):
    views = views_of(4, 0.005)
    for place in (1, 4):
        views[place] = moved(views[place], by)
    found = others(views)
    assert found.views == ("pose-002", "pose-005")
    assert found.offset_px == pytest.approx([by, by], abs=4 * found.sigma_px)
    assert "The points of views pose-002, pose-005 lie" in found.sentence


@pytest.mark.parametrize(("noise_px", "named"), [(0.02, True), (0.05, False)])
def test_an_offset_that_noise_could_explain_is_not_named(noise_px, named):
    """In the noisier views, half a pixel is less than 3 standard uncertainties."""
    views = views_of(0, noise_px)
    for place in (1, 4):
        views[place] = moved(views[place], 0.5)
    assert (others(views) is not None) == named


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 999), count=st.integers(2, 8))
def test_views_of_one_origin_are_not_doubted(seed, count):
    assert others([moved(view, 0.5) for view in views_of(seed, poses=POSES[:count])]) is None
