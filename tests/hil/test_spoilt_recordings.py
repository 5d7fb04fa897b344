"""Recordings spoilt in one way each: what their numbers say, and that a gate refuses them by it."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from still_picture import simulate

from bench.measure.gates import failed_gate_texts, recording_gates, rejection_reasons
from bench.measure.measure import measure
from drivers.camera import RecordingFacts
from drivers.camera.raw_file import RawFile
from sequences.schema import GateConfig
from sequences.script import Gates
from simulators.optics.picture import TARGET, pose_rotation, render
from simulators.pixels.evt3_writer import Evt3Writer
from simulators.world.truth import NOISE_LEVELS, Truth
from simulators.world.world import LightState

SIZE, SPAN_US, PERIOD_US = (640, 480), 50_000, 1e6 / 60
LIMITS = {
    "max_hot_pixels": 50, "min_lit_pixels": 100_000, "max_events_per_edge": 1.7, "min_on_share": 0.35,
    "max_on_share": 0.6, "max_first_on_spread_us": 250, "max_trigger_jitter_us": 20,
}  # fmt: skip


@pytest.fixture(scope="module")
def good():
    """Events and sync edges of a pose under a bright square flicker, on a small sensor."""
    truth = Truth()
    camera = dataclasses.replace(truth.camera, width=SIZE[0], height=SIZE[1], cx=320.0, cy=240.0)
    truth = dataclasses.replace(truth, camera=camera)
    picture = render(truth, pose_rotation({"pan": 0.6, "tilt": -0.4, "roll": 17}, truth.optics))
    light = LightState(waveform="square", output=True, sync=True)
    events = simulate(
        picture, light, SPAN_US, phase=0.7, noise=NOISE_LEVELS["typical"], camera_seed=7, seed=1
    )
    edges = np.arange(6)
    return SimpleNamespace(
        t=events.t.copy(), x=events.x, y=events.y, p=events.p,
        edge_t=np.round((edges / 2 + 0.3) * PERIOD_US).astype(np.int64), edge_value=(1 - edges % 2).astype(np.uint8),
        entered_t=None,
    )  # fmt: skip


def keep(r, mask):
    return SimpleNamespace(**{**vars(r), "t": r.t[mask], "x": r.x[mask], "y": r.y[mask], "p": r.p[mask]})


def put_in_order(r):
    order = np.lexsort((r.x, r.p, r.y, r.t))
    return keep(r, order)


def changed(r, **arrays):
    return put_in_order(SimpleNamespace(**{**vars(r), **arrays}))


def judge(path, recording, limits=LIMITS):
    """Write the recording, look at it, and give its measurement and what refuses it."""
    writer = Evt3Writer(width=SIZE[0], height=SIZE[1])
    words = writer.write(
        recording.t, recording.x, recording.y, recording.p, until_us=SPAN_US,
        trigger_t=recording.edge_t, trigger_value=recording.edge_value, entered_t=recording.entered_t,
    )  # fmt: skip
    path.write_bytes(
        b"%% format EVT3;height=%d;width=%d\n%% end\n" % (SIZE[1], SIZE[0]) + words.astype("<u2").tobytes()
    )
    scan = RawFile.open(path).scan()
    facts = RecordingFacts(
        "1", "EVK4", *SIZE, scan.bytes, SPAN_US / 1e6, scan.events, scan.triggers, {}, {},
        scan.rate_controller_in, scan.rate_controller_out,
    )  # fmt: skip
    measurement = measure(path, name="p", target=TARGET, image="auto", periods=2, expected_hz=60.0)
    gates = Gates.from_settings(dict(GateConfig(**limits)))
    failed = failed_gate_texts(recording_gates(facts, gates, 60.0, measurement.facts, measurement.stars))
    return measurement, [*failed, *rejection_reasons(facts, gates)]


def rows_missing(r):
    return keep(r, (r.y < 200) | (r.y > 209))


def off_events_lost(r):
    return keep(r, (r.p == 1) | (np.arange(len(r.t)) % 4 == 0))


def most_events_lost(r):
    return keep(r, np.random.default_rng(1).random(len(r.t)) < 0.5)


def events_doubled(r):
    twice = {name: np.tile(getattr(r, name), 2) for name in ("x", "y", "p")}
    late = np.minimum(r.t + 300, SPAN_US - 1)
    return changed(r, t=np.concatenate([r.t, late]), **twice)


def events_held_up(r):
    waits = np.random.default_rng(2).integers(0, 2500, SIZE[1])[r.y]
    return changed(r, t=np.minimum(r.t + waits, SPAN_US - 1))


def hot_pixels(r):
    rng = np.random.default_rng(3)
    n = 200
    x, y = np.repeat(rng.integers(0, SIZE[0], n), 100), np.repeat(rng.integers(0, SIZE[1], n), 100)
    t = rng.integers(0, SPAN_US, 100 * n)
    more = {"t": t, "x": x.astype(np.uint16), "y": y.astype(np.uint16), "p": (t % 2).astype(np.uint8)}
    return changed(r, **{name: np.concatenate([getattr(r, name), more[name]]) for name in more})


def moving(r):
    return changed(
        r, x=np.where((r.t > 0.55 * SPAN_US) & (r.x < SIZE[0] - 1), r.x + 1, r.x).astype(np.uint16)
    )


def rate_controlled(r):
    lost = np.random.default_rng(4).random(len(r.t)) < 0.05
    return SimpleNamespace(**{**vars(keep(r, ~lost)), "entered_t": r.t})


def sync_inverted(r):
    return SimpleNamespace(**{**vars(r), "edge_value": 1 - r.edge_value})


def sync_unsteady(r):
    return SimpleNamespace(**{**vars(r), "edge_t": r.edge_t + np.array([0, 90, -90, 0, 90, -90])})


def sync_of_another_light(r):
    return SimpleNamespace(**{**vars(r), "edge_t": (r.edge_t * 0.99).astype(np.int64)})


def sync_edges_missing(r):
    return SimpleNamespace(**{**vars(r), "edge_t": r.edge_t[[0, 1]], "edge_value": r.edge_value[[0, 1]]})


def test_a_good_recording_passes_every_gate(good, tmp_path):
    measurement, refused = judge(tmp_path / "good.raw", good)
    assert refused == []
    assert measurement.stars > 60
    facts = measurement.facts
    assert facts["flicker_source"] == "triggers"
    assert abs(facts["flicker_from_events_hz"] - 60) < 0.2
    assert facts["image"]["kind"] == "fired-per-edge"
    assert "events per edge" in facts["image"]["reason"]
    assert facts["named_by"] == "tag"


def test_a_window_of_one_period_shows_stars_but_no_motion(good, tmp_path):
    judge(tmp_path / "good.raw", good)
    measurement = measure(
        tmp_path / "good.raw", name="p", target=TARGET, image="any", periods=1, expected_hz=60.0
    )
    assert measurement.stars > 60
    assert measurement.facts["motion_px"] is None
    assert measurement.facts["image"]["kind"] == "any"


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (rows_missing, "silent rows 10, needed <= 3"),
        (off_events_lost, "on share"),
        (most_events_lost, "lit pixels"),
        (events_doubled, "events per edge"),
        (events_held_up, "first on spread"),
        (hot_pixels, "hot pixels"),
        (moving, "stars moved"),
        (rate_controlled, "rate controller loss 5."),
        (sync_inverted, "events after sync"),
        (sync_unsteady, "trigger jitter"),
        (sync_of_another_light, "flicker disagreement"),
        (sync_edges_missing, "triggers missed 2, needed <= 1"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)  # fmt: skip
def test_a_recording_spoilt_in_one_way_is_refused_for_it(good, tmp_path, spoil, words):
    measurement, refused = judge(tmp_path / "spoilt.raw", spoil(good))
    assert any(reason.startswith(words) for reason in refused), (
        refused,
        measurement.fault,
        measurement.facts,
    )
