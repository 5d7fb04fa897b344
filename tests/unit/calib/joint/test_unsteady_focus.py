"""Where the focal length changes while the poses are recorded, U holds every one that was there, and one sentence says it."""

from dataclasses import replace

import numpy as np
import pytest

from calib.model import cause as kinds
from tests.benchmarks.worlds import product
from tests.benchmarks.worlds.attacks import views
from tests.benchmarks.worlds.bench import NINE
from tests.benchmarks.worlds.knowledge import options_for, solve

_POSES = np.arange(len(NINE))
_RING, _PLAY, _DRIFT = np.where(_POSES >= 6, -1e-3, 0.0), 1e-3 * (_POSES % 2), -2e-3 * _POSES / 8.0
#: A pause before the seventh pose, s.
_PAUSED_S = np.array([0.0, 60.0, 120.0, 180.0, 240.0, 300.0, 1260.0, 1320.0, 1380.0])


def _answer(shares, seed, known="cr", profile="like-bench", times_s=60.0 * _POSES):
    """Return the result, and (9, 4) fx, fy, cx, cy of the poses over the stated ones, as shares of U."""
    bench = product.draw(seed, NINE, profile=profile)
    values = bench.camera.values
    centre = np.array([values["cx"], values["cy"]])

    def change(k, view):
        px = centre + (1.0 + shares[k]) * (view.px - centre)
        return replace(view, px=px, recorded_s=times_s[k])

    changed = views(change)(bench)
    answer = solve(changed, options_for(changed, known, "right"))
    factors = {"fx": 1.0 + shares, "fy": 1.0 + shares, "cx": np.ones(len(NINE)), "cy": np.ones(len(NINE))}
    off = [
        (factor * values[name] - answer.values[name]) / answer.raw.U[name] for name, factor in factors.items()
    ]
    return answer, np.abs(off)


@pytest.mark.parametrize(
    ("kind", "shares", "seed", "station"),
    [
        (kinds.FOCUSED, _RING, 502, ("0", "like-bench")),
        pytest.param(kinds.FOCUSED, _RING, 502, ("cr", "like-bench"), marks=pytest.mark.slow),
        pytest.param(kinds.FOCUS_PLAYS, _PLAY, 506, ("cr", "like-bench"), marks=pytest.mark.slow),
        pytest.param(kinds.FOCUS_CREEPS, 1e-3 * _POSES, 3, ("cr", "like-bench"), marks=pytest.mark.slow),
        pytest.param(kinds.FOCUS_CREEPS, _DRIFT, 509, ("c", "S1"), marks=pytest.mark.slow),
    ],
)
def test_uncertainties_span_the_focal_lengths_that_were_there_and_a_cause_says_so(
    kind, shares, seed, station
):
    answer, off = _answer(shares, seed, *station)
    (cause,) = answer.raw.causes
    assert cause.kind == kind
    assert abs(cause.value) == pytest.approx(100.0 * np.ptp(shares), abs=1.5 * cause.expanded)
    assert off.max() < 1.1  # 1.9 if U did not reach to the poses, 1.6 if cy did not follow a drift
    assert "U spans" in answer.notes[0]
    assert not any("The statement" in note for note in answer.notes)


@pytest.mark.slow
def test_a_drift_goes_by_the_times_of_the_views():
    answer, off = _answer(-2e-3 * _PAUSED_S / _PAUSED_S[-1], 509, times_s=_PAUSED_S)
    (cause,) = answer.raw.causes
    assert (cause.kind, cause.beside) == (kinds.FOCUS_CREEPS, ())
    assert cause.value == pytest.approx(-0.2, abs=1.5 * cause.expanded)
    assert off.max() < 1.1


@pytest.mark.slow
def test_a_drift_that_the_data_do_not_decide_is_told_beside_no_change_and_is_in_the_uncertainties():
    answer, off = _answer(1e-3 * _POSES / 8.0, 508)
    (cause,) = answer.raw.causes
    assert (cause.kind, cause.beside) == (kinds.FOCUS_CREEPS, (kinds.UNCHANGED,))
    assert off.max() < 1.0
