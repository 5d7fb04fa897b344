"""Gates: which recordings are rejected, and the reasons given; what is measured in a recording."""

from dataclasses import replace

import numpy as np
import pytest

from bench.measure.gates import failed_gate_texts, recording_gates, rejection_reasons
from bench.measure.measure import aligned_poses
from drivers.camera import RecordingFacts
from sequences.script import Gates

GATES = Gates(min_stars=40, max_event_rate_mev_s=100.0, require_triggers=True)

MEASURED = {"flicker_hz": 60.0, "flicker_source": "triggers", "triggers_expected": 3, "triggers_found": 3}


def facts(**changes):
    given = {
        "serial": "1", "model": "EVK4", "width": 1280, "height": 720, "bytes": 9, "duration_s": 0.05, "events": 3_000_000,
        "triggers": 6, "biases": {}, "filters": {"afk": False, "erc": False},
    }  # fmt: skip
    return RecordingFacts(**(given | changes))


def reasons(*, stars=300, measured=MEASURED, gates=GATES, frequency_hz=60.0, **changes):
    recording = facts(**changes)
    failed = failed_gate_texts(recording_gates(recording, gates, frequency_hz, measured, stars))
    return [*failed, *rejection_reasons(recording, gates)]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"stars": 12}, "stars 12, needed >= 40"),
        ({"measured": MEASURED | {"triggers_found": 1}}, "triggers missed 2, needed <= 1"),
        ({"measured": MEASURED | {"flicker_hz": 50.0}}, "flicker off nominal 16.6667 %"),
        ({"measured": MEASURED | {"flicker_hz": 59.9}}, "flicker off nominal 0.166667 %"),
        ({"measured": MEASURED | {"motion_px": 0.08}}, "stars moved 0.08 px, needed <= 0.05"),
        ({"gaps": ("words are missing",)}, "data lost: words are missing"),
        ({"filters": {"afk": True}}, "on-chip filters were on: afk"),
        ({"triggers": 0}, "no sync triggers"),
        ({"complete": False}, "ended too early"),
        ({"stars": 0, "duration_s": 0.0, "events": 0}, "stars 0, needed >= 40"),
        ({"measured": MEASURED | {"flicker_lag_periods": 0.5}}, "sync 0.5 periods, needed -0.28 to 0.2"),
        ({"events": 9_000_000}, "event rate 180 Mev/s, needed <= 100 (for fewer events"),
        ({"bytes": 10_000_000, "gates": replace(GATES, limits={"max_data_rate_gbit_s": 1.5})}, "1.6 Gbit/s"),
    ],
)
def test_each_fault_is_rejected_with_a_reason_that_names_it(given, words):
    assert any(words in reason for reason in reasons(**given)), reasons(**given)
    assert reasons() == []


def test_triggers_are_not_needed_if_the_sequence_does_not_require_them():
    free = Gates(40, 100.0, require_triggers=False)
    assert reasons(gates=free, triggers=0, measured={"flicker_hz": 60.0, "flicker_source": "events"}) == []


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"min_on_share": 0.5}, "on share 0.4, needed >= 0.5"),
        ({"max_on_share": 0.3}, "on share 0.4, needed <= 0.3"),
        ({"max_first_on_spread_us": 100}, "first on spread 139 us, needed <= 100"),
        ({"max_flicker_off_percent": 0.0001}, "flicker off nominal 0.001 %, needed <= 0.0001"),
        ({"max_trigger_jitter_us": 1}, "trigger jitter 2 us, needed <= 1"),
        ({"max_silent_rows": 0}, ""),
        ({"max_hot_pixels": 1}, ""),
        ({"max_edge_width_px": 1.5}, "edge width 1.8 px, needed <= 1.5 (the image is out of focus"),
    ],
)
def test_a_limit_is_judged_only_if_the_recording_has_the_number(limits, words):
    image = {"on_share": 0.4, "first_on_spread_us": 139.0, "silent_rows": 0, "hot_pixels": None}
    measured = MEASURED | {
        "image": image,
        "flicker_hz": 60.0006,
        "trigger_jitter_us": 2.0,
        "edge_width_px": 1.8,
    }
    refused = reasons(gates=replace(GATES, limits=limits), measured=measured)
    assert [reason.split(" (")[0] for reason in refused] == ([words.split(" (")[0]] if words else [])
    assert not words or refused[0].startswith(words)


def test_events_dropped_by_the_rate_controller_are_rejected_by_its_counters():
    assert reasons(rate_controller_in=1000, rate_controller_out=999) == []
    dropped = reasons(rate_controller_in=1000, rate_controller_out=900)
    assert dropped == ["rate controller loss 10 %, needed <= 1"]


# ---------------------------------------------------------------- errors that are correlated; the stored image


def quality(roll_deg: float, kind: str) -> dict:
    turn = np.radians(roll_deg)
    grid = [
        [50 * np.cos(turn), -50 * np.sin(turn), 300],
        [50 * np.sin(turn), 50 * np.cos(turn), 200],
        [1e-5, 0, 1],
    ]
    return {"grid": grid, "image": {"kind": kind}}


@pytest.mark.parametrize(
    ("seen", "aligned"),
    [
        *(([quality(roll, "fired-per-edge")], 1) for roll in (0.4, -2, 44, 46.5, 90, 181, -135)),
        *(([quality(roll, "fired-per-edge")], 0) for roll in (10, -10, 22.5, 35, 100, 170)),
        ([quality(44, "fired-per-edge"), quality(10, "fired-per-edge")], 1),
        ([quality(0, "lock-in"), quality(0, "picture")], 0),  # levels of grey
        ([{"image": {"kind": "last-polarity"}}, {}], 0),  # no stars
        ([{"grid": quality(0, "lock-in")["grid"]}], 0),
    ],
)
def test_recordings_with_edges_along_rows_or_diagonals_are_counted(seen, aligned):
    assert aligned_poses(seen) == aligned
