"""Devices of a run: their cables are asked before it, a lost one is waited for, and how each is left is journaled."""

from types import SimpleNamespace

import pytest
from rehearsed import TWO, Scene

from bench.commands.run import show_run
from bench.record.device_end import DEVICES, NOT_ASKED
from bench.record.events import Event
from bench.record.journal import Journal
from bench.run.run_devices import NOT_REOPENED
from bench.run.states import NOT_STATED, connections
from drivers.camera import CameraIdentity
from drivers.errors import CameraLost, LightFault, PortLost, PortNotFound, ReplyTimeout, WrongDevice

# ---------------------------------------------------------------- before a run


@pytest.mark.parametrize(
    ("link_mbit_s", "link_text"),
    [(None, NOT_STATED), (480, "480 Mbit/s (USB 2)"), (5000, "5000 Mbit/s (USB 3)")],
)
def test_the_speed_of_the_connection_is_told(link_mbit_s, link_text):
    words = ("Prophesee", "EVK4", "IMX636", "00051234", "3.9.0", 1280, 720)
    camera = CameraIdentity(*words, link_mbit_s=link_mbit_s)
    assert connections(camera, {"trigger_in": True}, SimpleNamespace())["camera_link"] == link_text


def test_a_bench_that_is_not_ready_and_whose_stage_falls_silent_is_not_said_to_have_stood_still(
    tmp_path, capsys
):
    scene = Scene(tmp_path)
    scene.errors = {"stage.stop": ReplyTimeout("silent")}
    scene.hook = lambda name: (lambda _: ["the lamp is hot"]) if name == "light.faults" else None
    show_run(scene.run())
    output = "".join(capsys.readouterr())
    assert "lamp is hot" in output
    assert "stage may be moving" in output


# ---------------------------------------------------------------- lost


LOST_WORDS = "\ninterlocks: {device_lost: {retry_s: 5, max_hold_s: 120}}\n"


def lost_at(scene, when, error, away_s):
    """A device goes away at the first call of something, and is back so many seconds later."""
    left_s = []

    def hook(name):
        if left_s and scene.clock.monotonic() < left_s[0] + away_s:
            raise PortNotFound("no such port") if name == "open" else type(error)("gone")
        if name == when and not left_s:
            left_s.append(scene.clock.monotonic())
            raise error

    scene.hook = hook


def test_a_device_that_stays_lost_ends_the_run_in_time(tmp_path):
    scene = Scene(tmp_path, station=LOST_WORDS)
    lost_at(scene, "stage.move_to", PortLost("gone"), 1e9)
    end = scene.run()
    assert end.how == "failed"
    assert "for 12" in end.why
    assert end.opened
    assert end.unsafe == [NOT_REOPENED]
    assert scene.clock.monotonic() < 150


def test_another_device_in_its_place_is_refused(tmp_path):
    scene = Scene(tmp_path, station=LOST_WORDS)
    scene.errors = {"stage.move_to": PortLost("gone")}
    scene.fail_at("open", 2, WrongDevice("another one"))
    end = scene.run()
    assert end.how == "failed"
    assert "another one" in end.why


def test_a_device_that_is_lost_in_the_same_step_again_and_again_ends_the_run(tmp_path):
    """A camera that opened again each time and sent nothing was recorded 59 times; the run did not end."""
    scene = Scene(tmp_path, station=LOST_WORDS)
    scene.errors = {"camera.record": CameraLost("it has sent nothing")}
    end = scene.run()
    assert end.how == "failed"
    assert "it has sent nothing" in end.why
    assert scene.calls.count("camera.record") == 6


# ---------------------------------------------------------------- left

END = "  - solve: {model: spherical, distortion: [k1]}\n  - report\n"


def journaled(scene):
    return [event for event, _ in scene.events()]


def left(scene):
    (devices_left,) = scene.data_of(Event.DEVICES_LEFT)
    return {end["device"]: (end["state"], end["said"]) for end in devices_left["devices"]}


def test_what_each_device_confirmed_stands_before_the_results(tmp_path):
    scene = Scene(tmp_path, poses=TWO, end=END)
    assert scene.run().how == "finished"
    ends = left(scene)
    assert list(ends) == list(DEVICES)
    assert {state for state, _ in ends.values()} == {"confirmed safe"}
    states = scene.states()
    assert states.index("parking") < states.index("solving")
    at = journaled(scene).index(Event.DEVICES_LEFT)
    entered = [data["state"] for event, data in scene.events()[:at] if event == Event.ENTERING]
    assert entered[-1] == "parking"


@pytest.mark.parametrize("ended", [True, False])
def test_a_resumed_run_without_devices_claims_only_what_was_seen(tmp_path, monkeypatch, ended):
    scene = Scene(tmp_path, poses=TWO, end=END)

    class Cut(BaseException):
        pass

    def gone(*_, **__):
        raise Cut

    def cut(self):
        if ended:
            raise LightFault("gone.", where="COM1", remedy="Look.")
        monkeypatch.setattr(Journal, "put", gone)  # a process that is gone writes no more
        gone()

    monkeypatch.setattr("bench.run.run_devices.RunDevices.leave", cut)
    if ended:
        assert scene.run().how == "failed"
    else:
        with pytest.raises(Cut):
            scene.run()
    monkeypatch.undo()
    opened = len(scene.opened)
    scene.run()
    assert len(scene.opened) == opened  # no device is opened for a calculation
    state, reason = left(scene)["light"]
    assert state == ("confirmed safe" if ended else "not confirmed")
    assert (reason == NOT_ASKED) is not ended
    history = scene.history()
    assert [end.device for end in history.devices_left] == list(DEVICES)
