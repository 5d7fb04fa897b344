"""Stars that cannot be right: gross errors and shifted ids."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.calibration import CalibrationOptions
from calib.diagnosis.gross_stars import find_gross_stars, without_gross_stars
from calib.diagnosis.shifted_views import find_shifted_ids
from calib.engine import calibrate
from calib.errors import InputMismatch
from calib.fit import initialize
from tests.benchmarks.worlds.recordings import read
from tests.unit.calib.conftest import TARGET, Bench


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
    (found,) = find_gross_stars([view])
    assert set(stars) <= set(np.flatnonzero(found.wrong))
    assert len(found.distances_px) - count <= 1
    measured = dict(zip(np.flatnonzero(found.wrong), found.distances_px, strict=True))
    assert [measured[star] for star in stars] == pytest.approx(lengths.tolist(), abs=3.0)
    (kept,) = without_gross_stars([view], [found])
    assert not set(clean.ids[stars]) & set(kept.ids)
    assert len(kept) == len(clean) - len(found.distances_px)


def test_the_sentence_names_the_view_the_number_and_the_distances():
    clean = Bench().views(np.random.default_rng(1), 0.02)[0]
    points = clean.points_px.copy()
    points[[20, 70, 110]] += [[30.0, 0.0], [0.0, 300.0], [100.0, 0.0]]
    (found,) = find_gross_stars([replace(clean, points_px=points)])
    assert found.sentence == (
        f"3 of {len(clean)} stars in view pose-001 lie 30 to 300 px from where the neighbours predict them; "
        "they were left out."
    )
    points[[20, 70]] = clean.points_px[[20, 70]]
    (found,) = find_gross_stars([replace(clean, points_px=points)])
    assert "1 of" in found.sentence
    assert "lies 100 px from where the neighbours predict it; it was left out." in found.sentence


def test_views_without_gross_errors_are_the_same_objects():
    views = Bench().views(np.random.default_rng(2), 0.05)
    found = find_gross_stars(views)
    assert [one.sentence for one in found] == ["", "", ""]
    assert all(kept is view for kept, view in zip(without_gross_stars(views, found), views, strict=True))


def test_a_view_of_mostly_wrong_stars_is_refused_by_name():
    views, rng = Bench().views(np.random.default_rng(3), 0.05), np.random.default_rng(3)
    stars = rng.choice(len(views[1]), int(0.25 * len(views[1])), replace=False)
    views[1], _ = spoilt(views[1], stars, rng)
    with pytest.raises(InputMismatch, match=r"view pose-002: \d+ of \d+ stars do not lie where"):
        find_gross_stars(views)


def test_a_calibration_survives_five_per_cent_of_gross_errors():
    rng = np.random.default_rng(4)
    clean = Bench().views(rng, 0.05)
    views = [
        spoilt(view, rng.choice(len(view), len(view) // 20, replace=False), rng, 30.0, 300.0)[0]
        for view in clean
    ]
    expected = calibrate(clean, CalibrationOptions())
    result = calibrate(without_gross_stars(views, find_gross_stars(views)), CalibrationOptions())
    assert result.camera.fx == pytest.approx(expected.camera.fx, abs=expected.sigma["fx"])
    assert result.sigma["fx"] > 0.95 * expected.sigma["fx"]
    assert result.rms_px == pytest.approx(expected.rms_px, rel=0.05)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_view_of_random_ids_is_refused_by_name(seed):
    rng = np.random.default_rng(seed)
    view = Bench().views(rng, 0.05)[1]
    with pytest.raises(InputMismatch, match="view pose-002"):
        find_gross_stars([replace(view, points_px=rng.permutation(view.points_px))])


# ---------------------------------------------------------------- shifted ids

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (0, 0, 45), (-5, -2, 90), (5, -2, 0))

STEP = st.integers(-2, 2)


def search(views):
    bundle, start = initialize(views, CalibrationOptions(), "spherical")
    return find_shifted_ids(views, bundle, refine(bundle, start, Loss("l2"), 60).parameters)


def misnamed(view, columns, rows):
    """The stars bear the names of stars that lie columns to the left and rows above."""
    return replace(view, target_mm=view.target_mm - TARGET.pitch_mm * np.array([columns, rows]))


def shifts_of(sentence):
    """The views that a sentence names, each with its columns and rows."""
    said = r"view (\S+) by (?:(-?\d+) columns?)?(?: and )?(?:(-?\d+) rows?)?"
    return {(view, int(columns or 0), int(rows or 0)) for view, columns, rows in re.findall(said, sentence)}


@settings(max_examples=12, deadline=None)
@given(
    place=st.integers(0, 4),
    shift=st.tuples(STEP, STEP).filter(any),
    seed=st.integers(0, 999),
    count=st.just(5),
)
def test_the_view_and_the_shift_are_found(place, shift, seed, count):
    views = Bench().views(np.random.default_rng(seed), 0.02, poses=POSES[:count])
    views[place] = misnamed(views[place], *shift)
    found = search(views)
    assert found.startswith("The star ids are wrong: shift the ids of view")
    assert shifts_of(found) == {(f"pose-{place + 1:03d}", *shift)}
    before_px, after_px = map(float, re.search(r"fall from (\S+) to (\S+) px", found).groups())
    assert after_px < 0.04 < before_px


@settings(max_examples=12, deadline=None)
@given(count=st.integers(2, 5), seed=st.integers(0, 999), sigma=st.sampled_from([0.01, 0.05, 0.3]))
def test_sound_views_are_not_doubted(count, seed, sigma):
    assert search(Bench().views(np.random.default_rng(seed), sigma, poses=POSES[:count])) == ""


def test_two_shifted_views_of_six_are_found_one_after_the_other():
    views = Bench().views(np.random.default_rng(1), 0.02, poses=POSES)
    views[1], views[4] = misnamed(views[1], 1, 0), misnamed(views[4], 0, -2)
    assert shifts_of(search(views)) == {("pose-002", 1, 0), ("pose-005", 0, -2)}


def test_of_two_views_nobody_can_tell_which_is_shifted():
    views = Bench().views(np.random.default_rng(2), 0.02)[:2]
    views[0] = misnamed(views[0], 1, 0)
    found = search(views)
    assert "cannot decide" in found
    assert shifts_of(found) == {("pose-001", 1, 0), ("pose-002", -1, 0)}


def test_the_sentence_names_view_and_shift():
    views = Bench().views(np.random.default_rng(3), 0.02)
    views[2] = misnamed(views[2], -1, 2)
    assert "shift the ids of view pose-003 by -1 column and 2 rows, and the residuals" in search(views)


def test_stars_on_no_lattice_have_no_columns():
    views = Bench().views(np.random.default_rng(4), 0.02)
    rng = np.random.default_rng(5)
    scattered = [replace(v, target_mm=v.target_mm + rng.uniform(-1, 1, (len(v), 2))) for v in views]
    bundle, start = initialize(views, CalibrationOptions(), "spherical")
    assert find_shifted_ids(scattered, bundle, start) == ""


@pytest.mark.parametrize("chosen", [(1, 5, 9), (0, 3, 7, 11, 15, 19)])
def test_real_aberrations_are_not_taken_for_shifted_ids(collimator_recordings, chosen):
    views = read(collimator_recordings)
    assert search([views[i] for i in chosen]) == ""
