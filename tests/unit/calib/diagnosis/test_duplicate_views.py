"""Views given twice under two names, and recordings of one pose, which are no duplicates."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.diagnosis.duplicate_views import find_duplicates
from tests.unit.calib.conftest import Bench, rotation


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
