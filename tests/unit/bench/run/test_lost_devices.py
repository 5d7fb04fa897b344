"""The interlock for a lost device: the run waits, identifies the device, and uses it again."""

import pytest
from rehearsed import Scene

from bench.records.events import Event
from bench.run.run_devices import NOT_REOPENED
from drivers.errors import CameraLost, PortLost, PortNotFound, ReplyTimeout, WrongDevice

LOST = [PortLost("gone"), CameraLost("gone"), ReplyTimeout("silent")]
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


@pytest.mark.parametrize("when", ["stage.home", "light.on", "stage.move_to", "camera.record", "light.read"])
@pytest.mark.parametrize("error", LOST, ids=lambda e: type(e).__name__)
def test_a_lost_device_is_waited_for_identified_and_used_again(tmp_path, when, error):
    scene = Scene(tmp_path, station=LOST_WORDS)
    lost_at(scene, when, error, 31)
    end = scene.run()
    assert end.how == "finished", end.why
    (released,) = scene.told(Event.INTERLOCK_RELEASED)
    assert 30 < released["held_s"] < 40
    held = scene.states().index("holding")
    assert scene.states()[held + 1 : held + 3] == ["preflight", "homing"]
    assert [d["pose"] for d in scene.told(Event.CAPTURE_STORED)] == [1, 2]
    assert any(
        "CHECK" not in d["what"] and "device lost interlock held" in d["what"]
        for d in scene.told(Event.DEVIATION)
    )


def test_without_that_interlock_a_lost_device_ends_the_run(tmp_path):
    scene = Scene(tmp_path)
    lost_at(scene, "stage.move_to", PortLost("gone"), 0)
    assert scene.run().how == "failed"


def test_a_device_that_stays_lost_ends_the_run_in_time(tmp_path):
    scene = Scene(tmp_path, station=LOST_WORDS)
    lost_at(scene, "stage.move_to", PortLost("gone"), 1e9)
    end = scene.run()
    assert end.how == "failed"
    assert "device lost interlock has held the run for 12" in end.why
    assert end.opened
    assert end.unsafe == [NOT_REOPENED]
    assert scene.clock.monotonic() < 150


def test_another_device_in_its_place_is_refused(tmp_path):
    scene = Scene(tmp_path, station=LOST_WORDS)

    def hook(name):
        if name == "stage.move_to":
            raise PortLost("gone")
        if name == "open" and scene.opened:
            raise WrongDevice("another one")

    scene.hook = hook
    end = scene.run()
    assert end.how == "failed"
    assert "another one" in end.why


def test_a_device_that_is_lost_in_the_same_step_again_and_again_ends_the_run(tmp_path):
    """A camera that opened again each time and sent nothing was recorded 59 times; the run did not end."""
    scene = Scene(tmp_path, station=LOST_WORDS)
    calls = []

    def hook(name):
        if name == "camera.record":
            calls.append(name)
            assert len(calls) < 50
            raise CameraLost("it has sent nothing")

    scene.hook = hook
    end = scene.run()
    assert end.how == "failed"
    assert "it has sent nothing" in end.why
    assert len(calls) == 6
