"""Views whose ids are shifted on the lattice, or whose points have another origin: who is named, and when nobody is."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slow_cases import slow

from calib.calibration import CalibrationOptions
from calib.engine import calibrate
from calib.model import cause as kinds
from calib.model.gimbal_readings import AXES, GimbalReadings, ParallaxBound
from tests.benchmarks.worlds.catalogue import WORLDS
from tests.benchmarks.worlds.knowledge import options_for, views_of
from tests.benchmarks.worlds.recordings import read
from tests.unit.calib.conftest import TARGET, Bench, over_u

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
STEP = st.integers(-2, 2)


def bench(seed, noise_px=0.02, count=6):
    return Bench().views(np.random.default_rng(seed), noise_px, poses=POSES[:count])


def misnamed(view, columns, rows):
    """The stars bear the names of stars that lie columns to the left and rows above; as in a file, places are rounded."""
    places = view.target_mm - TARGET.pitch_mm * np.array([columns, rows])
    return replace(view, target_mm=np.round(places, 5))


def doubts(views, options=None):
    causes = calibrate(views, options or CalibrationOptions()).causes
    return [cause for cause in causes if cause.kind in (kinds.IDS, kinds.ORIGIN)]


def shifts_of(cause):
    """By the name of each view: the columns and rows by which to shift its ids."""
    form = r"view (pose.?\d+) by (?:(-?\d+) columns?)?(?: and )?(?:(-?\d+) rows?)?"
    return {(view, int(columns or 0), int(rows or 0)) for view, columns, rows in re.findall(form, cause.axis)}


def named_shift(views):
    """The shifts that are named; none if the views seem right."""
    causes = doubts(views)
    if not causes:
        return set()
    (cause,) = causes
    assert cause.kind == kinds.IDS
    return shifts_of(cause)


@pytest.mark.parametrize(
    ("seed", "count", "shifts"),
    [
        (3, 6, {1: (1, 0)}),
        slow(3, 6, {3: (-2, 1)}),
        slow(3, 6, {4: (0, 2)}),
        slow(5, 5, {0: (2, 0)}),  # a shift of another would explain much: a dozen searches
        slow(1, 6, {1: (1, 0), 4: (0, -2)}),
    ],
)
def test_the_views_and_their_shifts_are_named(seed, count, shifts):
    views = bench(seed, count=count)
    for place, shift in shifts.items():
        views[place] = misnamed(views[place], *shift)
    assert named_shift(views) == {(f"pose-{place + 1:03d}", *shift) for place, shift in shifts.items()}


@pytest.mark.slow
@settings(max_examples=3, deadline=None)
@given(place=st.integers(0, 4), shift=st.tuples(STEP, STEP).filter(any), seed=st.integers(0, 99))
def test_a_shift_that_five_views_do_not_show_does_no_harm(place, shift, seed):
    """With nothing stated, parallax may explain it: then it is in U."""
    views = bench(seed, count=5)
    views[place] = misnamed(views[place], *shift)
    if shifts := named_shift(views):
        assert shifts == {(f"pose-{place + 1:03d}", *shift)}
    else:
        result = calibrate(views, CalibrationOptions())
        assert max(over_u(result, Bench().truth)) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("world", ["polynomial", "raytraced"])
def test_behind_a_real_collimator_a_shifted_view_is_named(world):
    """Errors of the glass, of the pupil and of each pose could hide the shift."""
    drawn = WORLDS[world](700, 9, 1, 0)
    views = views_of(drawn)
    places = np.unique(np.round(views[0].target_mm, 6)[:, 0])
    views[2] = replace(views[2], target_mm=views[2].target_mm + np.median(np.diff(places)) * np.array([1, 0]))
    (cause,) = doubts(views, options_for(drawn, "0"))
    assert (cause.kind, shifts_of(cause)) == (kinds.IDS, {("pose 3", -1, 0)})


@pytest.mark.slow  # test_sound_views_give_no_note shows three of them
@settings(max_examples=3, deadline=None)
@given(
    count=st.integers(2, 8),
    seed=st.integers(0, 999),
    noise_px=st.sampled_from([0.01, 0.05, 0.3]),
    origin_px=st.sampled_from([0.0, 0.5]),
)
def test_sound_views_of_one_origin_are_not_doubted(count, seed, noise_px, origin_px):
    assert doubts([moved(view, origin_px) for view in bench(seed, noise_px, count)]) == []


@pytest.mark.slow
@pytest.mark.parametrize(("world", "count"), [("polynomial", 3), ("product", 9), ("S1", 9), ("S2", 3)])
def test_right_ids_behind_a_real_collimator_are_not_doubted(world, count):
    drawn = WORLDS[world](705, count, 1, 0)
    assert doubts(views_of(drawn), options_for(drawn, "0")) == []


@pytest.mark.slow
def test_of_two_views_nobody_can_tell_which_is_shifted():
    """The parallax is bounded: otherwise it may explain the shift."""
    views = bench(2, count=2)
    views[0] = misnamed(views[0], 1, 0)
    angles = tuple(dict(zip(AXES, (*pose, 0.0), strict=False)) for pose in POSES[:2])
    rough = GimbalReadings(angles, 0.5, parallax=ParallaxBound(0.0, 0.1, 0.0, 0.01))
    (cause,) = doubts(views, CalibrationOptions(gimbal=rough))
    assert cause.kind == kinds.IDS
    assert {("pose-001", 1, 0), ("pose-002", -1, 0)} <= shifts_of(cause)


@pytest.mark.slow
def test_one_of_two_recordings_of_a_pose_by_hand_is_shifted():
    """With wrong ids, two recordings of one pose look like two poses, which have other unknowns."""
    drawn = WORLDS["S1"](824, 3, 2, 0)
    views = views_of(drawn)
    places = np.unique(np.round(views[5].target_mm, 6)[:, 0])
    views[5] = replace(views[5], target_mm=views[5].target_mm + np.median(np.diff(places)) * np.array([1, 0]))
    (cause,) = doubts(views, options_for(drawn, "c"))
    assert (cause.kind, cause.axis) == (kinds.IDS, "view pose 3 round 2 by -1 column")


@pytest.mark.slow
def test_a_shift_after_which_the_discs_no_longer_fit_together_is_not_named():
    """Ids are right; a shift would explain errors of this glass better."""
    drawn = WORLDS["S1"](820, 25, 1, 0)
    assert doubts(views_of(drawn), options_for(drawn, "0")) == []


@pytest.mark.slow
def test_stars_on_no_lattice_have_no_columns():
    rng, views = np.random.default_rng(5), bench(4, count=5)
    views[1] = misnamed(views[1], 1, 0)
    most_mm = 0.08 * TARGET.pitch_mm
    scattered = [
        replace(view, target_mm=view.target_mm + rng.uniform(-most_mm, most_mm, (len(view), 2)))
        for view in views
    ]
    assert doubts(scattered) == []


@pytest.mark.slow
def test_a_certificate_is_not_blamed_for_a_shifted_view():
    drawn = WORLDS["raytraced"](701, 3, 1, 0)
    views = views_of(drawn)
    places = np.unique(np.round(views[0].target_mm, 6)[:, 0])
    views[0] = replace(views[0], target_mm=views[0].target_mm - np.median(np.diff(places)) * np.array([2, 1]))
    result = calibrate(views, options_for(drawn, "cr"))
    assert [cause.kind for cause in result.causes] == [kinds.IDS]
    assert all(witness.fault_probability < 0.5 for witness in result.witnesses)


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [(1, 5, 9), (0, 3, 7, 11, 15, 19), (1, 9, 18), (3, 6, 18)])
def test_real_aberrations_and_a_hand_are_not_taken_for_shifted_ids(collimator_recordings, chosen):
    """Shifted ids explain errors of the last ones better: the pupil may have been elsewhere."""
    views = read(collimator_recordings)
    assert doubts([views[i] for i in chosen]) == []


def moved(view, by):
    return replace(view, points_px=view.points_px + by)


@pytest.mark.parametrize(("by", "along"), [(0.5, "right and down"), slow(-0.5, "left and up")])
def test_a_few_views_with_another_origin_are_named(by, along):
    views = bench(4, 0.005, 5)
    for place in (1, 3):
        views[place] = moved(views[place], by)
    (cause,) = doubts(views)
    assert (cause.kind, cause.pose, cause.axis) == (kinds.ORIGIN, "pose-002, pose-004", along)
    assert cause.value == pytest.approx(0.5, abs=2 * cause.expanded)


@pytest.mark.slow
@pytest.mark.parametrize(("noise_px", "named"), [(0.01, True), (0.05, False)])
def test_an_offset_that_noise_could_explain_is_not_named(noise_px, named):
    """In the noisier views, half a pixel is less than 3 standard uncertainties."""
    views = bench(0, noise_px, 8)
    for place in (1, 4):
        views[place] = moved(views[place], 0.5)
    assert bool(doubts(views)) == named
