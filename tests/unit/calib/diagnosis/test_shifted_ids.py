"""Ids that are shifted against the other views: found, or named as undecidable."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.calibration import CalibrationOptions
from calib.diagnosis.shifted_ids import IdShift, find_shifted_ids
from calib.fit import initialize
from tests.unit.calib.conftest import TARGET, Bench

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (0, 0, 45), (-5, -2, 90), (5, -2, 0))
STEP = st.integers(-2, 2)


def search(views):
    bundle, start = initialize(views, CalibrationOptions(), "spherical")
    return find_shifted_ids(views, bundle, refine(bundle, start, Loss("l2"), 60).parameters)


def misnamed(view, columns, rows):
    """The stars bear the names of stars that lie columns to the left and rows above."""
    return replace(view, target_mm=view.target_mm - TARGET.pitch_mm * np.array([columns, rows]))


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
    assert found.shifts == (IdShift(f"pose-{place + 1:03d}", *shift),)
    assert found.decided
    assert found.rms_after_px < 0.04 < found.rms_before_px


@settings(max_examples=12, deadline=None)
@given(count=st.integers(2, 5), seed=st.integers(0, 999), sigma=st.sampled_from([0.01, 0.05, 0.3]))
def test_sound_views_are_not_doubted(count, seed, sigma):
    assert search(Bench().views(np.random.default_rng(seed), sigma, poses=POSES[:count])) is None


def test_two_shifted_views_of_six_are_found_one_after_the_other():
    views = Bench().views(np.random.default_rng(1), 0.02, poses=POSES)
    views[1], views[4] = misnamed(views[1], 1, 0), misnamed(views[4], 0, -2)
    found = search(views)
    assert {(one.view, one.columns, one.rows) for one in found.shifts} == {
        ("pose-002", 1, 0),
        ("pose-005", 0, -2),
    }


def test_of_two_views_nobody_can_tell_which_is_shifted():
    views = Bench().views(np.random.default_rng(2), 0.02)[:2]
    views[0] = misnamed(views[0], 1, 0)
    found = search(views)
    assert not found.decided
    named = {(one.view, one.columns, one.rows) for one in (*found.shifts, *found.rivals)}
    assert named == {("pose-001", 1, 0), ("pose-002", -1, 0)}
    assert "cannot decide" in found.sentence


def test_the_sentence_names_view_and_shift():
    views = Bench().views(np.random.default_rng(3), 0.02)
    views[2] = misnamed(views[2], -1, 2)
    assert "shift the ids of view pose-003 by -1 column and 2 rows" in search(views).sentence


def test_stars_on_no_lattice_have_no_columns():
    views = Bench().views(np.random.default_rng(4), 0.02)
    rng = np.random.default_rng(5)
    scattered = [replace(v, target_mm=v.target_mm + rng.uniform(-1, 1, (len(v), 2))) for v in views]
    bundle, start = initialize(views, CalibrationOptions(), "spherical")
    assert find_shifted_ids(scattered, bundle, start) is None


@pytest.mark.parametrize("chosen", [(1, 5, 9), (0, 3, 7, 11, 15, 19)])
def test_real_aberrations_are_not_taken_for_shifted_ids(collimator_recordings, chosen):
    from calib.view import View

    views = []
    for number in chosen:
        rows = np.loadtxt(collimator_recordings / f"image{number + 1}.txt")
        unit = np.tile(np.eye(2), (len(rows), 1, 1))
        ids = rows[:, 4].astype(np.int64)
        views.append(View(str(number), (2448, 2048), ids, rows[:, :2] - 0.5, rows[:, 2:4], unit))
    assert search(views) is None
