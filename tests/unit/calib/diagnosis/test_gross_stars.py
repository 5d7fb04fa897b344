"""Stars that cannot be right: gross errors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from calib import CalibrationOptions, calibrate
from calib.diagnosis.gross_stars import find_gross_stars, outside_image, without_gross_stars
from calib.errors import DegenerateViews, InputMismatch
from calib.model.gimbal_readings import AXES, GimbalReadings
from tests.unit.calib.conftest import Bench


def spoilt(view, stars, rng, nearest=30.0, farthest=300.0):
    angles, lengths = rng.uniform(0, 2 * np.pi, len(stars)), rng.uniform(nearest, farthest, len(stars))
    points = view.points_px.copy()
    points[stars] += lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return replace(view, points_px=points), lengths


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 25))
@example(seed=348, count=20)
def test_gross_errors_are_counted_and_measured(seed, count):
    rng = np.random.default_rng(seed)
    clean = Bench().views(rng, 0.05)[0]
    stars = rng.choice(len(clean), count, replace=False)
    view, lengths = spoilt(clean, stars, rng)
    (gross,) = find_gross_stars([view])
    assert set(stars) <= set(np.flatnonzero(gross.wrong))
    left_out = len(gross.distances_px) + gross.outside
    assert left_out - count <= 1
    inside = ~outside_image(view) if gross.outside else np.full(len(view), fill_value=True)
    measured = dict(zip(np.flatnonzero(gross.wrong & inside), gross.distances_px, strict=True))
    expected = {star: length for star, length in zip(stars, lengths, strict=True) if inside[star]}
    assert [measured[star] for star in expected] == pytest.approx([*expected.values()], abs=3.0)
    (kept,) = without_gross_stars([view], [gross])
    assert not set(clean.ids[stars]) & set(kept.ids)
    assert len(kept) == len(clean) - left_out


def test_the_sentence_names_the_view_the_number_and_the_distances():
    clean = Bench().views(np.random.default_rng(1), 0.02)[0]
    points = clean.points_px.copy()
    points[[20, 70, 110]] += [[30.0, 0.0], [0.0, 300.0], [100.0, 0.0]]
    (gross,) = find_gross_stars([replace(clean, points_px=points)])
    assert gross.sentence == (
        f"3 of {len(clean)} points in view pose-001 lie 30 to 300 px from where the neighbours predict them; "
        "they were left out."
    )
    points[[20, 70]] = clean.points_px[[20, 70]]
    (gross,) = find_gross_stars([replace(clean, points_px=points)])
    assert "1 of" in gross.sentence
    assert "lies 100 px from where the neighbours predict it; it was left out." in gross.sentence


def test_views_without_gross_errors_are_the_same_objects():
    views = Bench().views(np.random.default_rng(2), 0.05)
    gross_of_views = find_gross_stars(views)
    assert [gross.sentence for gross in gross_of_views] == ["", "", ""]
    kept = zip(without_gross_stars(views, gross_of_views), views, strict=True)
    assert all(same is view for same, view in kept)


def test_a_view_of_mostly_wrong_stars_is_refused_by_name():
    views, rng = Bench().views(np.random.default_rng(3), 0.05), np.random.default_rng(3)
    stars = rng.choice(len(views[1]), int(0.25 * len(views[1])), replace=False)
    views[1], _ = spoilt(views[1], stars, rng)
    with pytest.raises(InputMismatch, match=r"view pose-002: \d+ of \d+ points do not lie where"):
        find_gross_stars(views)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_view_of_random_ids_is_refused_by_name(seed):
    rng = np.random.default_rng(seed)
    view = Bench().views(rng, 0.05)[1]
    with pytest.raises(InputMismatch, match="view pose-002"):
        find_gross_stars([replace(view, points_px=rng.permutation(view.points_px))])


@pytest.mark.slow
def test_views_that_show_no_plane_are_left_out_and_named():
    views = Bench().views(np.random.default_rng(5), 0.05)
    first = views[0]
    few = replace(first.part(np.arange(len(first)) < 3), name="few")
    line = replace(first.part(first.target_mm[:, 0] == first.target_mm[60, 0]), name="line")
    turned = ((9.0, 9.0), *Bench().poses, (9.0, 9.0))
    angles = [dict(zip(AXES, (*pose, 0.0)[:3], strict=True)) for pose in turned]
    readings = GimbalReadings(tuple(angles), 0.01, 1e-3)
    result = calibrate([few, *views, line], CalibrationOptions(gimbal=readings))
    expected = calibrate(views, CalibrationOptions(gimbal=readings.part((1, 2, 3))))
    assert dict(result.values) == dict(expected.values)
    notes = sorted(set(result.notes) - set(expected.notes))
    assert ["few" in notes[0], "3 points" in notes[0], "line" in notes[1]] == [True] * 3
    with pytest.raises(DegenerateViews, match=r"at least 2 needed.*View line"):
        calibrate([line, first])


def test_one_point_outside_of_the_image_is_left_out_and_named():
    views = Bench().views(np.random.default_rng(5), 0.05)
    narrower = (int(np.sort(np.concatenate([view.points_px[:, 0] for view in views]))[-2]) + 1, 720)
    views = [replace(view, image_size=narrower) for view in views]
    outside = [view.points_px[:, 0] > narrower[0] for view in views]
    assert sum(map(np.count_nonzero, outside)) == 1
    result = calibrate(views, CalibrationOptions())
    (note,) = [note for note in result.notes if "outside of the image" in note]
    assert views[int(np.argmax([own.any() for own in outside]))].name in note
    for own, weights in zip(outside, result.weights, strict=True):
        assert (weights[own] == 0.0).all()
        assert len(weights) == len(own)
