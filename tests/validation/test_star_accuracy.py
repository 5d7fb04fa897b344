"""Stars of simulated recordings compared with the truth: accurate, with true covariances, none missed, none wrong."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.events.flicker import flicker_from_events
from calib.stars.detect import detect_stars, detect_view
from simulators.optics.picture import TARGET, pose_rotation, project, star_centres
from simulators.world.truth import NOISE_LEVELS, CollimatorTruth, OpticsTruth, Truth
from tests.support.short_recordings import images_of, record

TRUTH = Truth(collimator=CollimatorTruth(r=280.0, half_angle_deg=16.0))
CELL_PX = 34.0
"""From a star to the corner of its cell: the stars are 48 px apart."""
POSES = (
    {"pan": 4.0, "tilt": 2.0, "roll": 17.0},
    {"pan": 3.0, "tilt": -2.0, "roll": 200.0},
    {"pan": -4.0, "tilt": 1.0, "roll": 75.0},
    {"pan": -2.0, "tilt": -1.0, "roll": 310.0},
)


def recorded(noise, waveform, pose, seed, truth=TRUTH):
    """Return events of 33 ms, the flicker of the light, and the true rotation of the camera."""
    rotation = pose_rotation(pose, truth.optics)
    return *record(truth, rotation, waveform, seed, NOISE_LEVELS[noise]), rotation


def images(*given):
    return images_of(TRUTH, *given)


def compare(view, rotation):
    """Return the errors, px, and their normalised squares; no star may be missed or labelled wrongly."""
    off = view.points_px - project(np.asarray(TARGET.positions_mm(view.ids)), rotation, TRUTH)
    whole, _ = star_centres(TRUTH, rotation, clearance=0.72, border_px=CELL_PX)
    assert len(whole) >= 300
    assert np.setdiff1d(whole, view.ids).size == 0
    assert np.linalg.norm(off, axis=1).max() < 0.35
    return off, np.einsum("ni,nij,nj->n", off, np.linalg.inv(view.covariances_px2), off) / 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("waveform", "noise", "chosen", "rms_px"),
    [
        ("square", "clean", "fired-per-edge", 0.014),
        ("square", "typical", "fired-per-edge", 0.015),
        ("square", "heavy", "fired-per-edge", 0.025),
        ("sine", "clean", "lock-in", 0.009),
        ("sine", "typical", "lock-in", 0.009),
        ("sine", "heavy", "lock-in", 0.022),
    ],
)
def test_stars_of_33_ms_are_as_accurate_as_required(waveform, noise, chosen, rms_px):
    errors, squares = [], []
    for seed, pose in enumerate(POSES, start=1):
        events, flicker, rotation = recorded(noise, waveform, pose, seed)
        best = images(events, flicker).best()
        assert best.name == chosen
        off, z = compare(detect_view(best.image, TARGET), rotation)
        errors.append(off)
        squares.append(z)
    assert np.sqrt((np.concatenate(errors) ** 2).mean()) <= rms_px
    assert 0.85 < np.sqrt(np.concatenate(squares).mean()) < 1.2


@pytest.mark.slow
@pytest.mark.parametrize(("waveform", "rms_px"), [("square", 0.045), ("sine", 0.018)])
def test_stars_out_of_focus_are_all_found_with_true_covariances(waveform, rms_px):
    blurred = replace(TRUTH, optics=OpticsTruth(psf_px=1.5))
    errors, squares = [], []
    for seed, pose in enumerate(POSES[:2], start=1):
        events, flicker, rotation = recorded("typical", waveform, pose, seed, blurred)
        seen = detect_stars(images(events, flicker).best().image, TARGET)
        assert 1.1 < seen.edge_width_px < 1.6
        off, z = compare(seen.view, rotation)
        errors.append(off)
        squares.append(z)
    assert np.sqrt((np.concatenate(errors) ** 2).mean()) <= rms_px
    assert 0.85 < np.sqrt(np.concatenate(squares).mean()) < 1.2


@pytest.mark.slow
def test_no_star_is_taken_for_another_at_any_pose(monkeypatch):
    """Try some of the poses of ``bench_star_names.py``; the benchmark tries a thousand."""
    script = Path(__file__).parents[1] / "benchmarks" / "bench_star_names.py"
    monkeypatch.syspath_prepend(str(script.parent))
    try_pose = runpy.run_path(str(script))["try_pose"]
    poses = [try_pose(1, number) for number in range(40)]
    named = [pose for pose in poses if "stars" in pose]
    assert sum(pose["wrong"] for pose in named) == 0
    assert sum(pose["missed"] for pose in named) <= 0.005 * sum(pose["whole"] for pose in named)
    assert len(named) >= 30
    refused = [pose for pose in poses if "refused" in pose]
    assert all(pose["tag"] != "whole" and not pose["expected"] for pose in refused)


@pytest.mark.slow
def test_a_phase_from_the_events_is_as_good_as_one_from_triggers():
    events, flicker, rotation = recorded("typical", "square", POSES[0], 3)
    by_events = flicker_from_events(events.t, events.p)
    assert abs(by_events.lag_us(flicker)) < 150
    off, _ = compare(detect_view(images(events, by_events).best().image, TARGET), rotation)
    assert np.sqrt((off**2).mean()) <= 0.015
