"""Interlocks: they hold, light off and stage at rest, go on by themselves, and never hold for ever."""

import os
from datetime import UTC, datetime

import pytest
from rehearsed import Scene, with_runner

from bench.clock import Interrupted, VirtualClock
from bench.records.history import Event, replay
from bench.records.journal import read_journal
from bench.run.interlocks import CameraTemperature, DiskSpace, Door, EventRate, Interlocks, interlocks_of
from bench.run.status import read_status, status_text
from bench.stations.station import Station
from bench.stations.station_interlocks import (
    CameraTemperatureWords,
    DiskSpaceWords,
    DoorWords,
    EventRateWords,
    InterlockWords,
)
from drivers.errors import CameraLost, PortLost, PortNotFound, ReplyTimeout, WrongDevice
from sequences.errors import DocumentFaults
from sequences.reader import check_document

NOW = datetime(2026, 3, 1, 20, tzinfo=UTC)


# ---------------------------------------------------------------- each by itself


def test_a_door_is_closed_where_its_sensor_says_so_and_open_wherever_else(tmp_path):
    sensor = tmp_path / "value"
    door = Door(DoorWords(path=str(sensor)))
    assert "cannot be read" in door.why(held=False)
    for text, is_open in ((b"1\n", False), (b"0\n", True), (b"", True), (b"\xff", True), (b"1" * 99, True)):
        sensor.write_bytes(text)
        assert bool(door.why(held=False)) is is_open, text


def test_a_sensor_that_has_fallen_silent_is_an_open_door(tmp_path):
    sensor = tmp_path / "value"
    sensor.write_text("closed")
    os.utime(sensor, (1000.0, 1000.0))
    words = DoorWords(path=str(sensor), closed="closed", max_age_s=10)
    assert Door(words, utc_s=lambda: 1009.0).why(held=False) == ""
    assert "said nothing for 11 s" in Door(words, utc_s=lambda: 1011.0).why(held=False)


def test_a_sensor_that_speaks_from_the_future_is_not_believed_for_long(tmp_path):
    sensor = tmp_path / "value"
    sensor.write_text("closed")
    os.utime(sensor, (5000.0, 5000.0))
    words = DoorWords(path=str(sensor), closed="closed", max_age_s=10)
    assert Door(words, utc_s=lambda: 4991.0).why(held=False) == ""
    assert "clock was set back" in Door(words, utc_s=lambda: 1400.0).why(held=False)
    assert Door(DoorWords(path=str(sensor), closed="closed"), utc_s=lambda: 0.0).why(held=False) == ""


def test_a_pipe_in_place_of_a_sensor_is_an_open_door_and_nothing_to_wait_for(tmp_path):
    os.mkfifo(tmp_path / "value")
    assert "not a file" in Door(DoorWords(path=str(tmp_path / "value"))).why(held=False)
    assert "cannot be read" in Door(DoorWords(path=str(tmp_path))).why(held=False)


def test_each_lets_go_later_than_it_holds(tmp_path):
    celsius = [54.0]
    warm = CameraTemperature(CameraTemperatureWords(max_c=55, release_c=50), lambda: celsius[0])
    assert [warm.why(held=held) != "" for held in (False, True)] == [False, True]
    celsius[0] = 56.0
    assert "56.0 C" in warm.why(held=False)
    celsius[0] = 49.0
    assert warm.why(held=True) == ""
    assert CameraTemperature(warm.words, lambda: None).why(held=False) == ""
    rate = EventRate(EventRateWords(max_mev_s=50, release_mev_s=5), lambda: 60.0, lambda _s: 6.0)
    assert "60 Mev/s came" in rate.why(held=False)
    assert "6 Mev/s come in the dark" in rate.why(held=True)
    huge = DiskSpace(DiskSpaceWords(min_free_gb=1e-6, release_gb=1e9), tmp_path)
    assert [huge.why(held=held) != "" for held in (False, True)] == [False, True]


def test_an_open_door_interrupts_devices_at_work_and_nothing_else(tmp_path):
    clock = VirtualClock(NOW)
    interlocks = Interlocks([Door(DoorWords(path=str(tmp_path / "gone")))], clock)
    for state in ("checking", "solving", "holding", "preflight"):
        interlocks.entering(state)
        interlocks.look()
        clock.check()
    interlocks.entering("slewing")
    interlocks.look()
    with pytest.raises(Interrupted, match="door interlock"):
        clock.sleep(1)
    interlocks.left_off()
    clock.check()
    assert interlocks.take().interlock.name == "door"


STATION = """\
format: starbench/station/1
name: Bench
simulation: {}
stage:
  driver: zaber_ascii
  port: sim:gimbal
  axes: {pan: {device: 1, serial: 1, microsteps_per_deg: 6400, limits_deg: [-5, 5], speed_deg_s: 4, acceleration_deg_s2: 20}}
light: {driver: scpi, port: sim:light}
camera: {driver: simulated_evk4, address: sim:camera, serial: 1}
interlocks: %s
"""


@pytest.mark.parametrize(
    ("said", "wrong"),
    [
        ("{door: {path: /x, closed: 1, max_hold_s: 0}}", "max_hold_s"),
        ("{window: {path: /x}}", "window"),
        ("{camera_temperature: {max_c: 50, release_c: 50}}", "release_c must be below"),
        ("{event_rate: {max_mev_s: 5, release_mev_s: 6}}", "release_mev_s must be below"),
        ("{disk_space: {min_free_gb: 5, release_gb: 4}}", "release_gb must not"),
        ("{device_lost: {retry: 5}}", "retry"),
    ],
)
def test_a_station_file_with_an_interlock_that_makes_no_sense_is_refused(said, wrong):
    with pytest.raises(DocumentFaults) as caught:
        check_document((STATION % said).encode(), "station.yaml", Station)
    assert any(wrong in str(fault) for fault in caught.value.faults)


def test_a_station_has_those_it_names(tmp_path):
    text = "{door: {path: /x}, device_lost: {}, disk_space: {min_free_gb: 1, release_gb: 2}}"
    said = check_document((STATION % text).encode(), "station.yaml", Station).value.interlocks
    reads = dict.fromkeys(("read_c", "last_mev_s", "dark_mev_s", "reopen"))
    assert [i.name for i in interlocks_of(said, tmp_path, **reads)] == ["door", "disk_space", "device_lost"]
    assert interlocks_of(InterlockWords(), tmp_path, **reads) == []


# ---------------------------------------------------------------- in a run

END = "  - solve: {model: spherical, distortion: []}\n  - report\n"


def door_of(folder, state="1"):
    sensor = folder / "door"
    sensor.write_text(state)
    return sensor


def scene_with_door(tmp_path, monkeypatch, max_hold_s=600):
    sensor = door_of(tmp_path)
    words = f"\ninterlocks: {{door: {{path: {sensor}, max_hold_s: {max_hold_s}}}}}\n"
    return with_runner(Scene(tmp_path, station=words), monkeypatch), sensor


def opened_for(scene, sensor, when, seconds):
    """Open the door at the n-th call of something, close it so many seconds later; the thread's part is played here."""
    seen = []

    def hook(name):
        if name == when:
            seen.append(name)
            if len(seen) == 1:
                sensor.write_text("0")
                scene.shut_at_s = scene.clock.monotonic() + seconds
        scene.runner._interlocks.look()

    asked = scene.clock.__class__.sleep

    def sleep(clock, wait_s):
        if getattr(scene, "shut_at_s", None) is not None and clock.monotonic() > scene.shut_at_s:
            sensor.write_text("1")
            scene.shut_at_s = None
        asked(clock, wait_s)

    scene.hook = hook
    return sleep


@pytest.mark.parametrize(
    "when", ["stage.home", "light.on", "stage.move_to", "camera.record", "light.read", "stage.position_deg"]
)
def test_a_door_opened_at_any_moment_holds_the_run_dark_until_it_is_closed(tmp_path, monkeypatch, when):
    scene, sensor = scene_with_door(tmp_path, monkeypatch)
    monkeypatch.setattr(VirtualClock, "sleep", opened_for(scene, sensor, when, 30))
    dark = []
    wait = Interlocks.wait

    def watched(interlocks, trip):
        dark.append(not scene.light_is_on())
        return wait(interlocks, trip)

    monkeypatch.setattr(Interlocks, "wait", watched)
    end = scene.run()
    assert end.how == "finished", end.why
    assert dark
    assert all(dark)
    assert not scene.light_is_on()
    (released,) = scene.told(Event.INTERLOCK_RELEASED)
    assert released["rule"] == "door"
    assert 30 <= released["held_s"] < 32
    assert [d for d in scene.told(Event.DEVIATION) if "door interlock held for 30 s: it is open" in d["what"]]
    stored = [(d["pose"], d["attempt"]) for d in scene.told(Event.CAPTURE_STORED)]
    assert [pose for pose, _ in stored] == [1, 2]
    held = scene.states().index("holding")
    after = scene.states()[held + 1 :]
    if when in {"camera.record", "light.read", "stage.position_deg"}:  # lit and turned to its pose again
        assert after[:4] == ["lighting", "slewing", "settling", "recording"]


def test_a_recording_that_a_door_interrupted_is_kept_aside_and_counted(tmp_path, monkeypatch):
    scene, sensor = scene_with_door(tmp_path, monkeypatch)
    monkeypatch.setattr(VirtualClock, "sleep", opened_for(scene, sensor, "camera.record", 5))
    assert scene.run().how == "finished"
    (lost,) = scene.told(Event.ATTEMPT_LOST)
    assert "door interlock" in lost["why"]
    assert [d["attempt"] for d in scene.told(Event.CAPTURE_STORED)] == [2, 1]


def test_a_door_that_stays_open_ends_the_run_in_its_time_and_it_goes_on_later(tmp_path, monkeypatch):
    scene, sensor = scene_with_door(tmp_path, monkeypatch, max_hold_s=100)
    sensor.write_text("0")
    end = scene.run()
    assert end.how == "failed"
    assert "door interlock has held the run for 100 s" in end.why
    assert scene.clock.monotonic() < 110
    assert not scene.light_is_on()
    assert "stage.home" not in scene.calls
    sensor.write_text("1")
    assert scene.run().how == "finished"


def test_holds_are_added_up(tmp_path, monkeypatch):
    scene, sensor = scene_with_door(tmp_path, monkeypatch, max_hold_s=100)
    flapping = []

    def hook(name):
        if name == "stage.move_to":
            sensor.write_text("0")
        if sensor.read_text() == "0" and name == "light.off":
            flapping.append(scene.clock.monotonic())
        scene.runner._interlocks.look()

    wait = Interlocks.wait

    def watched(interlocks, trip):
        begin_s, sleep = scene.clock.monotonic(), scene.clock.sleep
        monkeypatch.setattr(
            scene.clock,
            "sleep",
            lambda s: (sleep(s), sensor.write_text("1") if scene.clock.monotonic() - begin_s > 30 else None),
        )
        try:
            return wait(interlocks, trip)
        finally:
            monkeypatch.setattr(scene.clock, "sleep", sleep)

    scene.hook = hook
    monkeypatch.setattr(Interlocks, "wait", watched)
    end = scene.run()
    assert end.how == "failed"
    assert "has held the run for 100 s" in end.why
    assert len(scene.told(Event.INTERLOCK_RELEASED)) == 3


def test_a_door_that_goes_on_and_off_is_told_once_in_ten_minutes(tmp_path, monkeypatch):
    scene, sensor = scene_with_door(tmp_path, monkeypatch, max_hold_s=3600)
    told = []
    sleep = VirtualClock.sleep

    def closing(clock, seconds):
        sleep(clock, seconds)
        if scene.runner._machine.state == "holding":
            sensor.write_text("1")
            if len(scene.told(Event.INTERLOCK_RELEASED)) == 3:
                sleep(clock, 601)

    def hook(name):
        scene.runner._hold_news._notify = lambda *words: told.append(words)
        if name == "stage.move_to" and len(scene.told(Event.INTERLOCK_RELEASED)) < 6:
            sensor.write_text("0")
        scene.runner._interlocks.look()

    scene.hook = hook
    monkeypatch.setattr(VirtualClock, "sleep", closing)
    assert scene.run().how == "finished"
    assert len(scene.told(Event.INTERLOCK_RELEASED)) == 6
    assert [occasion for occasion, _, _ in told] == ["hold", "hold"]


def test_status_says_what_holds(tmp_path, monkeypatch):
    scene, sensor = scene_with_door(tmp_path, monkeypatch)
    sensor.write_text("0")
    texts = []

    def hook(name):
        if scene.runner is not None and scene.runner._machine.state == "holding":
            texts.append(status_text(read_status(scene.folder)))
            sensor.write_text("1")

    scene.hook = hook
    assert scene.run().how == "finished"
    assert any("HELD by the door interlock: it is open" in text for text in texts)
    assert any("goes on by itself" in text for text in texts)


def test_a_warm_camera_is_let_cool_and_the_run_goes_on(tmp_path):
    words = "\ninterlocks: {camera_temperature: {max_c: 50, release_c: 45, max_hold_s: 900}}\n"
    scene = Scene(tmp_path, station=words)

    def celsius(_camera):
        now_s = scene.clock.monotonic()
        return 60.0 - 0.1 * max(0.0, now_s - 3.0) if now_s > 3.0 else 30.0

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.rehearsals.virtual_devices.VirtualCamera.temperature_c", celsius)
        end = scene.run()
    assert end.how == "finished", end.why
    (released,) = scene.told(Event.INTERLOCK_RELEASED)
    assert released["rule"] == "camera_temperature"
    assert 140 < released["held_s"] < 160


def test_light_from_elsewhere_holds_until_the_dark_is_dark(tmp_path, monkeypatch):
    words = "\ninterlocks: {event_rate: {max_mev_s: 50, release_mev_s: 5, max_hold_s: 900}}\n"
    scene = Scene(tmp_path, station=words)
    from bench.rehearsals.virtual_devices import VirtualCamera

    record = VirtualCamera.record

    def bright(camera, path, duration_s):
        facts = record(camera, path, duration_s)
        lit_from_elsewhere = scene.clock.monotonic() < 100.0
        return type(facts)(
            **{**vars(facts), "events": int((80e6 if lit_from_elsewhere else 1e6) * facts.duration_s)}
        )

    monkeypatch.setattr(VirtualCamera, "record", bright)
    end = scene.run()
    assert end.how == "finished", end.why
    (released,) = scene.told(Event.INTERLOCK_RELEASED)
    assert released["rule"] == "event_rate"
    assert 80 < released["held_s"] < 100
    assert not list(scene.folder.glob("probe*"))
    assert sorted(p.name for p in (scene.folder / "captures").iterdir()) == [
        "pose-001-attempt-1.raw",
        "pose-002-attempt-1.raw",
    ]


# ---------------------------------------------------------------- a device that goes away

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
def test_a_device_that_goes_away_is_waited_for_identified_and_used_again(tmp_path, when, error):
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


def test_a_device_that_stays_away_ends_the_run_in_its_time(tmp_path):
    scene = Scene(tmp_path, station=LOST_WORDS)
    lost_at(scene, "stage.move_to", PortLost("gone"), 1e9)
    end = scene.run()
    assert end.how == "failed"
    assert "device lost interlock has held the run for 12" in end.why
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


def test_what_held_a_run_is_forgotten_when_it_goes_on(tmp_path, monkeypatch):
    scene, sensor = scene_with_door(tmp_path, monkeypatch, max_hold_s=10)
    sensor.write_text("0")
    scene.run()
    entries, _ = read_journal(scene.folder / "journal.jsonl")
    holding = next(
        i for i, e in enumerate(entries) if e.event == Event.ENTERING and e.data["state"] == "holding"
    )
    assert replay(entries[: holding + 1]).rule.startswith("door: it is open")
    assert replay(entries).rule == ""
