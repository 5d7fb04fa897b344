"""Triples of the published views, with nothing known, scatter as much as they state: what `bench_recordings` measures."""

import numpy as np
import pytest

from calib import CalibrationOptions, calibrate
from tests.benchmarks.worlds.recordings import read, robust, solved, triples


@pytest.fixture(scope="module")
def scatter(collimator_recordings):
    """fx of 100 triples and its standard uncertainties, px."""
    views = read(collimator_recordings)
    lines = [solved(views, chosen) for chosen in triples(100)]
    assert not [line["refused"] for line in lines if "refused" in line]
    return tuple(np.array([line[name] for line in lines]) for name in ("fx", "u_fx"))


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_focal_lengths_of_triples_scatter_no_more_than_stated(scatter):
    found_px, u_px = scatter
    assert robust(found_px) <= 13.0
    assert np.median(u_px) >= 0.9 * robust(found_px)
    assert np.sqrt(np.mean(u_px**2)) >= 0.9 * found_px.std()


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.xfail(
    reason="u is 1.14 times the robust scatter, and 1.26 times the standard deviation; 1.2 is allowed",
    strict=True,
)
def test_what_is_stated_of_triples_is_not_larger_than_their_scatter(scatter):
    found_px, u_px = scatter
    assert np.median(u_px) <= 1.2 * robust(found_px)
    assert np.sqrt(np.mean(u_px**2)) <= 1.2 * found_px.std()


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [(1, 9, 18), (3, 6, 18)])
def test_right_ids_of_a_camera_that_a_hand_moved_are_not_doubted(collimator_recordings, chosen):
    """Shifted ids explain their errors better: the pupil may have been elsewhere."""
    views = read(collimator_recordings)
    result = calibrate([views[k] for k in chosen], CalibrationOptions())
    assert not [note for note in result.notes if "star ids" in note]
