"""The checks before a run, made while aligning; and the hands at the simulated camera."""

import json

import pytest

from bench.base.errors import ControlRefused
from bench.extras.pages.align import readiness
from bench.extras.pages.align.open_bench import SimulatedHands
from bench.extras.pages.align.readiness import check_readiness
from bench.measure.gates import Gate
from bench.measure.measure import Measurement
from drivers.errors import LightFault


class Kind:
    """A kind of camera whose recording shows what the test wants."""

    ending = ".raw"

    def __init__(self, gates, fault="", others=()):
        self.gates, self.fault, self.others, self.paths = gates, fault, list(others), []

    def record(self, camera, path, step, frequency_hz):
        self.paths.append(path)
        return camera.record(path, 0.05)

    def measure(self, path, step, frequency_hz, target, expected):
        assert path.exists()
        return Measurement(None, None, {}, self.fault)

    def judge(self, facts, step, frequency_hz, measurement):
        return self.gates, self.others


def _checked(session, monkeypatch, kind):
    monkeypatch.setattr(readiness, "camera_kind", lambda _station: kind)
    return {check.name: check for check in check_readiness(session)}


def test_a_dark_bench_is_checked_as_far_as_it_can_be(opened):
    session, devices = opened
    checks = {check.name: check for check in check_readiness(session)}
    assert {name: check.verdict for name, check in checks.items()} == {
        "station file": "good",
        "stage: identity": "good",
        "stage: faults": "good",
        "light: identity": "good",
        "light: faults": "good",
        "camera: identity": "good",
        "camera: settings": "good",
        "recording": "open",
    }
    assert devices.stage.calls == []
    assert devices.light.calls == []


def test_the_recording_is_judged_by_the_gates_of_a_run(opened, monkeypatch):
    session, devices = opened
    session.light(on=True)
    gates = [Gate("stars", 12, "", ">= 40", "fail"), Gate("edge width", 2.5, "px", "<= 1.2", "fail"),
             Gate("event rate", 90, "Mev/s", "<= 200", "pass")]  # fmt: skip
    kind = Kind(gates, others=["the rate controller is on"])
    checks = _checked(session, monkeypatch, kind)
    assert checks["recording: stars"].verdict == "bad"
    assert checks["recording: stars"].found == "12; a run needs at least 40."
    assert "focus the lens" in checks["recording: edge width"].remedy
    assert checks["recording: event rate"].verdict == "good"
    assert checks["recording"].verdict == "bad"
    assert not kind.paths[0].exists()  # the recording is not kept
    assert devices.light.lit  # the light stays as it is


def test_a_recording_without_stars_says_so_once(opened, monkeypatch):
    session, _ = opened
    session.light(on=True)
    kind = Kind([Gate("stars", 0, "", ">= 40", "fail")], fault="no star was found.")
    checks = _checked(session, monkeypatch, kind)
    assert checks["recording: stars"].found == "no star was found."
    assert checks["recording: stars"].verdict == "bad"


def test_a_stage_that_is_not_homed_is_no_fault(opened):
    session, devices = opened
    devices.stage.homed = False
    devices.stage.fault = "pan: no reference position"
    checks = {check.name: check for check in check_readiness(session)}
    assert checks["stage: faults"].verdict == "open"
    assert checks["stage: faults"].remedy == "Press Home."


def test_a_device_that_does_not_answer_is_red_and_the_others_are_checked(opened):
    session, devices = opened

    def fail():
        raise LightFault("it does not answer.", where="light", remedy="Plug it in.")

    devices.light.identify = fail
    checks = {check.name: check for check in check_readiness(session)}
    assert checks["light: identity"].verdict == "bad"
    assert checks["light: identity"].remedy == "Plug it in."
    assert checks["camera: identity"].verdict == "good"


class Simulation:
    """A simulated bench that notes its orders."""

    def __init__(self, answer):
        self.orders, self.answer = [], answer

    def order(self, line):
        self.orders.append(line)
        return self.answer


def test_hands_turn_the_lens_of_a_simulated_bench_only():
    bench = Simulation(json.dumps({"ok": True, "now": {"ring_deg": 5.0}}))
    hands = SimulatedHands(bench)
    assert hands.do("lens turn", {"deg": 5.0}) == {"ring_deg": 5.0}
    assert bench.orders == ["lens turn deg=5"]
    assert hands.seen == {"ring_deg": 5.0}
    with pytest.raises(ControlRefused, match="is real"):
        SimulatedHands(None).do("lens turn", {"deg": 5.0})


@pytest.mark.parametrize(
    ("action", "numbers"),
    [
        ("lens break", {}),
        ("pan stall", {"share": 1.0}),
        ("lens turn", {"x": 1.0}),
        ("lens turn", {"deg": float("inf")}),
    ],
)
def test_hands_do_only_what_hands_can_do(action, numbers):
    bench = Simulation("{}")
    with pytest.raises(ControlRefused):
        SimulatedHands(bench).do(action, numbers)
    assert bench.orders == []


@pytest.mark.parametrize("answer", ["", '{"ok": false, "error": "f_number must be above 0"}'])
def test_a_refused_order_is_said(answer):
    with pytest.raises(ControlRefused, match=r"did not answer|f_number"):
        SimulatedHands(Simulation(answer)).do("lens aperture", {"f_number": 0.0})


def test_a_sequence_is_planned_and_its_light_compared_with_the_present_one(opened, monkeypatch):
    session, _ = opened
    session.light(on=True, frequency_hz=60.0)
    kind = Kind([])
    kind.light_for = lambda flicker: flicker
    monkeypatch.setattr(readiness, "camera_kind", lambda _station: kind)
    checks = {check.name: check for check in check_readiness(session, sequence="three_pose")}
    assert checks["sequence"].verdict == "good"
    assert checks["light of the sequence"].verdict == "good"
    session.light(frequency_hz=80.0, level_percent=40.0)
    checks = {check.name: check for check in check_readiness(session, sequence="three_pose")}
    assert checks["light of the sequence"].verdict == "open"
    assert "square 60 Hz" in checks["light of the sequence"].found
    assert "square 80 Hz" in checks["light of the sequence"].found


def test_a_sequence_that_cannot_run_is_red(opened, tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(
        "format: starbench/sequence/1\nname: far\nsteps: [light, {move: {pan_deg: 99}}, record]\n"
    )
    checks = {check.name: check for check in check_readiness(opened[0], sequence=str(path))}
    assert checks["sequence"].verdict == "bad"
    assert "99" in checks["sequence"].found
