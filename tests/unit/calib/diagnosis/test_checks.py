"""Views that cannot be right: what each check says of them."""

import re
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib import CalibrationOptions, CameraModel, View, calibrate
from calib.diagnosis.checks import (
    check_image_size,
    check_target_units,
    check_views,
    closed_form_radius,
    find_duplicates,
    require_points_inside,
)
from calib.errors import DegenerateViews, InputMismatch
from tests.unit.calib.conftest import TARGET, Bench, rotation


@pytest.fixture
def views():
    return Bench().views(np.random.default_rng(1), 0.02)


def after(views):
    return calibrate(views, CalibrationOptions()).notes


def test_sound_views_give_no_note(views):
    assert check_views(views, known_r_mm=255.0) == ()
    # Nothing is stated of this collimator: that alone may be said.
    assert [note for note in after(views) if not note.startswith("What is stated of collimator")] == []


def test_every_doubt_before_the_adjustment_is_a_note(views):
    wrong = [replace(view, target_mm=view.target_mm / 1000.0) for view in views]
    notes = check_views([*wrong, replace(wrong[0], name="again")])
    assert len(notes) == 2
    assert "pose-001 and again" in notes[0]
    assert "look like metres" in notes[1]


@pytest.mark.slow
def test_every_doubt_after_the_adjustment_is_a_note():
    poses = [(pan, tilt, 20 * pan) for tilt in (-2, 0, 2) for pan in (-5, 1, 5)]
    views = Bench().views(np.random.default_rng(1), 0.02, poses)
    wrong = [replace(view, image_size=(1920, 1080)) for view in views]
    wrong[1] = replace(wrong[1], target_mm=wrong[1].target_mm + np.array([TARGET.pitch_mm, 0.0]))
    first, second = (note for note in after(wrong) if "ids" in note or "image size" in note)
    assert "view pose-002 by -1 column" in first
    assert "probably 1280 x 720" in second


@pytest.mark.slow
def test_views_of_few_stars_are_not_judged(views):
    few = []
    for view in views:
        corners = [np.argmin(view.points_px @ way) for way in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        few.append(view.part(np.isin(np.arange(len(view)), corners)))
    assert check_views(few) == ()
    with suppress(DegenerateViews):  # four exact points a view may say too little of a camera
        assert not any("ids" in note or "origin" in note for note in after(few))


# ---------------------------------------------------------------- image size


def of_size(views, size):
    return [replace(view, image_size=size) for view in views]


def camera(size, cx=642.0, cy=363.0):
    return CameraModel(3345.0, 3345.0, cx, cy, size)


@pytest.mark.parametrize("size", [(640, 480), (720, 1280), (1279, 600)])
def test_points_outside_are_refused_with_a_size_that_holds_them(views, size):
    with pytest.raises(InputMismatch, match=r"view pose-001: .* into 1280 x 720") as raised:
        check_views(of_size(views, size))
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
    assert re.search(rf"size {size[0]} x {size[1]}, .* x = 12", doubt)
    assert doubt.endswith("probably 1280 x 720.")


def test_a_principal_point_far_off_without_a_known_size_is_only_a_doubt(views):
    doubt = check_image_size(views, camera((1280, 720), cx=900.0), (1.0, 1.0))
    assert "261 px" in doubt
    assert "Check the image size, " in doubt


@pytest.mark.parametrize(("cx", "sigma"), [(642.0, 1.0), (500.0, 1.0), (900.0, 50.0)])
def test_a_plausible_or_uncertain_principal_point_is_no_doubt(views, cx, sigma):
    assert not check_image_size(views, camera((1280, 720), cx=cx), (sigma, sigma))


# ---------------------------------------------------------------- views that are there twice


def part(view, order):
    """Some of the stars, in an order."""
    arrays = (view.ids[order], view.points_px[order], view.target_mm[order], view.covariances_px2[order])
    return View(f"{view.name}-part", view.image_size, *arrays)


def test_a_recording_under_another_name_or_a_part_of_it_in_another_order_is_named():
    views = Bench().views(np.random.default_rng(1), 0.02)
    some = np.random.default_rng(3).permutation(len(views[1]))[:50]
    for name, stars, again in (
        ("again", len(views[1]), replace(views[1], name="again")),
        ("pose-002-part", 50, part(views[1], some)),
    ):
        (sentence,) = find_duplicates([*views, again])
        assert sentence.startswith(f"Views pose-002 and {name} are the same measurement: their {stars} ")


def test_copies_of_one_view_are_named_together():
    views = Bench().views(np.random.default_rng(1), 0.02)
    copies = [replace(views[0], name=f"copy {number}") for number in range(7)]
    (sentence,) = find_duplicates([*views, *copies])
    assert sentence.startswith(f"Views {views[0].name}, copy 0, copy 1, copy 2, copy 3 and 3 more")
    assert "all but one" in sentence


def test_many_pairs_that_are_nearly_the_same_are_counted():
    view = Bench().views(np.random.default_rng(1), 0.02)[0]
    moved_px = 1e-4 * np.arange(6)[:, None, None] * [1.0, -1.0]
    near = [replace(view, name=f"{at}", points_px=view.points_px + moved_px[at]) for at in range(6)]
    sentences = find_duplicates(near)
    assert len(sentences) == 6
    assert sentences[-1].startswith("10 more pairs ")


def test_a_copy_with_rounded_points_is_nearly_the_same():
    view = Bench().views(np.random.default_rng(4), 0.02)[0]
    rounded = replace(view, name="rounded", points_px=np.round(view.points_px, 2))
    (sentence,) = find_duplicates([view, rounded])
    rms_px = float(re.search(r"differ by (\S+) px rms", sentence)[1])
    assert rms_px == pytest.approx(0.01 / np.sqrt(6), rel=0.1)


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
def test_another_unit_than_the_known_radius_shows_is_named_and_refused(views, unit, length):
    with pytest.raises(InputMismatch, match=rf"target positions: .* look like {unit}\. .* in mm\."):
        check_views(in_unit(views, length), known_r_mm=255.0)


@pytest.mark.parametrize("lengths_mm", [(1, 25.4), (25.4, 1), (1, 10), (1, 0.001)])
def test_two_units_of_x_and_y_are_refused(views, lengths_mm):
    with pytest.raises(InputMismatch, match="X and Y are in two units"):
        check_views(in_unit(views, lengths_mm))


@pytest.mark.parametrize(("unit", "length"), UNITS[:3])
def test_a_certificate_in_another_unit_is_named_and_refused(views, unit, length):
    with pytest.raises(InputMismatch, match=rf"the certificate: .* {unit}\. .* in mm\."):
        check_views(views, known_r_mm=255.0 / length)


@pytest.mark.parametrize(("unit", "length"), [("metres", 1000.0), ("micrometres", 0.001)])
def test_an_implausible_pitch_needs_no_known_radius(views, unit, length):
    sentence = check_target_units(in_unit(views, length))
    assert sentence.endswith(f"The target positions look like {unit}; give them in mm.")
    assert "e+" not in sentence


def test_an_implausible_radius_is_noticed(views):
    note = check_target_units(in_unit(views, 60.0), known_r_mm=300.0)
    assert re.search(r"radius of 4\.21\d* mm.* in mm\.$", note)


@pytest.mark.parametrize("known", [None, 255.0, 200.0, 300.0])
def test_millimetres_are_not_doubted(views, known):
    assert not check_target_units(views, known_r_mm=known)


def test_one_view_has_no_closed_form_and_no_doubt(views):
    assert closed_form_radius(views[:1]) is None
    assert not check_target_units(views[:1], known_r_mm=255.0)
