"""Interlocks in a run: they hold it safely, let it continue by itself, and never hold it for ever."""

from dataclasses import replace

import pytest
from rehearsed import Scene, with_runner

from bench.base.clock import VirtualClock
from bench.batch.virtual_devices import VirtualCamera
from bench.record.events import Event
from bench.run.interlocks import Interlocks
from bench.run.messages.run_messages import HoldNotifier


def scene_with_door(tmp_path, monkeypatch, max_hold_s=600):
    sensor = tmp_path / "door"
    sensor.write_text("1")
    words = f"\ninterlocks: {{door: {{path: {sensor}, max_hold_s: {max_hold_s}}}}}\n"
    return with_runner(Scene(tmp_path, station=words), monkeypatch), sensor


def open_door_at(call, scene, sensor, monkeypatch, closed_after_s, times=1):
    """The door opens at a call of a device, so many times; it is closed after some seconds, by virtual time."""
    sleep, opened_s = VirtualClock.sleep, []

    def closing(clock, seconds):
        if sensor.read_text() == "0" and clock.monotonic() > opened_s[-1] + closed_after_s(len(opened_s)):
            sensor.write_text("1")
        sleep(clock, seconds)

    def hook(name):
        if name == call and len(opened_s) < times:
            opened_s.append(scene.clock.monotonic())
            sensor.write_text("0")
        scene.runner.context.interlocks.check_door()

    scene.hook = hook
    monkeypatch.setattr(VirtualClock, "sleep", closing)


@pytest.mark.parametrize("when", ["stage.home", "light.on", "camera.record", "light.read"])
def test_a_door_opened_at_any_moment_holds_the_run_dark_until_it_is_closed(tmp_path, monkeypatch, when):
    scene, sensor = scene_with_door(tmp_path, monkeypatch)
    open_door_at(when, scene, sensor, monkeypatch, lambda _: 30)
    dark = []
    wait = Interlocks.wait_until_clear

    def watched(interlocks, trip):
        dark.append(not scene.light_is_on())
        return wait(interlocks, trip)

    monkeypatch.setattr(Interlocks, "wait_until_clear", watched)
    end = scene.run()
    assert end.how == "finished", end.why
    assert dark
    assert all(dark)
    assert not scene.light_is_on()
    (released,) = scene.data_of(Event.INTERLOCK_RELEASED)
    assert released["rule"] == "door"
    assert 30 <= released["held_s"] < 32
    assert any("door interlock held for 30 s" in data["what"] for data in scene.data_of(Event.DEVIATION))
    stored = [(d["pose"], d["attempt"]) for d in scene.data_of(Event.CAPTURE_STORED)]
    assert [pose for pose, _ in stored] == [1, 2]
    if when == "camera.record":  # what exists of it is kept in quarantine, and counted
        (lost,) = scene.data_of(Event.ATTEMPT_LOST)
        assert "door interlock" in lost["why"]
        assert stored == [(1, 2), (2, 1)]
    held = scene.states().index("holding")
    after = scene.states()[held + 1 :]
    if when in {"camera.record", "light.read"}:  # lit and turned to its pose again
        assert after[:4] == ["lighting", "slewing", "settling", "recording"]


def test_a_door_that_stays_open_ends_the_run_which_can_be_resumed(tmp_path, monkeypatch):
    scene, sensor = scene_with_door(tmp_path, monkeypatch, max_hold_s=100)
    sensor.write_text("0")
    end = scene.run()
    assert end.how == "failed"
    assert "for 100 s" in end.why
    assert scene.clock.monotonic() < 110
    assert not scene.light_is_on()
    assert "stage.home" not in scene.calls
    sensor.write_text("1")
    assert scene.run().how == "finished"


def test_holds_are_added_up(tmp_path, monkeypatch):
    scene, sensor = scene_with_door(tmp_path, monkeypatch, max_hold_s=100)
    open_door_at("stage.move_to", scene, sensor, monkeypatch, lambda _: 30, times=99)
    end = scene.run()
    assert end.how == "failed"
    assert "for 100 s" in end.why
    assert len(scene.data_of(Event.INTERLOCK_RELEASED)) == 3


def test_a_door_that_opens_repeatedly_is_notified_once_in_ten_minutes(tmp_path, monkeypatch):
    scene, sensor = scene_with_door(tmp_path, monkeypatch, max_hold_s=3600)
    open_door_at("stage.move_to", scene, sensor, monkeypatch, lambda nth: 601 if nth == 4 else 1, times=6)
    messages = []
    monkeypatch.setattr(
        "bench.run.runner.HoldNotifier",
        lambda clock, _notify: HoldNotifier(clock, lambda *words: messages.append(words)),
    )
    assert scene.run().how == "finished"
    assert len(scene.data_of(Event.INTERLOCK_RELEASED)) == 6
    assert [occasion for occasion, _, _ in messages] == ["hold", "hold"]


def test_stray_light_holds_the_run_until_it_is_dark_again(tmp_path, monkeypatch):
    words = "\ninterlocks: {event_rate: {max_mev_s: 50, release_mev_s: 5, max_hold_s: 900}}\n"
    scene = Scene(tmp_path, station=words)
    record = VirtualCamera.record

    def bright(camera, path, duration_s):
        facts = record(camera, path, duration_s)
        lit_from_elsewhere = scene.clock.monotonic() < 100.0
        return replace(facts, events=int((80e6 if lit_from_elsewhere else 1e6) * facts.duration_s))

    monkeypatch.setattr(VirtualCamera, "record", bright)
    end = scene.run()
    assert end.how == "finished", end.why
    (released,) = scene.data_of(Event.INTERLOCK_RELEASED)
    assert released["rule"] == "event_rate"
    assert 80 < released["held_s"] < 100
    assert not list(scene.folder.glob("probe*"))
    assert sorted(p.name for p in (scene.folder / "captures").iterdir()) == [
        "pose-001-attempt-1.raw",
        "pose-002-attempt-1.raw",
    ]
