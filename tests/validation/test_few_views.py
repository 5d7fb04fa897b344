"""Triples of the published views, with nothing known, scatter as much as they state: what `bench_recordings` measures."""

import numpy as np
import pytest

from calib import CalibrationOptions, calibrate
from tests.benchmarks.worlds.recordings import read, robust, solved, triples


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_focal_lengths_of_triples_scatter_as_stated_and_none_is_refused(collimator_recordings):
    views = read(collimator_recordings)
    lines = [solved(views, chosen) for chosen in triples(100)]
    assert not [line["refused"] for line in lines if "refused" in line]
    found_px, u_px = (np.array([line[name] for line in lines]) for name in ("fx", "u_fx"))
    assert robust(found_px) <= 17.0  # 13 are wanted; 12 are reached, known to 5
    assert 0.9 <= np.median(u_px) / robust(found_px) <= 1.2
    # Not robust it is .84: few triples are far off, and none by more than 1.5 U.
    assert 0.8 <= np.sqrt(np.mean(u_px**2)) / found_px.std() <= 1.3


@pytest.mark.parametrize("chosen", [(1, 9, 18), (3, 6, 18)])
def test_right_ids_of_a_camera_that_a_hand_moved_are_not_doubted(collimator_recordings, chosen):
    """Shifted ids explain their errors better: the pupil may have been elsewhere."""
    views = read(collimator_recordings)
    result = calibrate([views[k] for k in chosen], CalibrationOptions())
    assert not [note for note in result.notes if "star ids" in note]
