"""The align session with fakes: who may move what, and that a stop, a lost page and the end leave the bench safe."""

import dataclasses
import threading
import time
from contextlib import closing

import pytest
from align_fakes import fake_session
from fake_devices import FakeCamera, FakeDevices, FakeStage
from waiting import wait_until

from bench.base.errors import ControlRefused
from bench.extras.pages.align import live_loop
from bench.extras.pages.align import session as session_module
from bench.extras.pages.align.live_figures import LiveMeter
from bench.extras.pages.align.stage_control import StageControl
from drivers.errors import CameraBusy, CameraLost, DriverError


def _rest(session):
    wait_until(lambda: not session.bench.stage.moving)


def test_opening_moves_nothing_and_switches_nothing_on(opened):
    session, devices = opened
    wait_until(lambda: session.picture().number >= 2)
    assert devices.stage.calls == []
    assert devices.light.calls == []


def test_the_measurement_knows_the_waveform_and_no_angles_before_homing(opened, monkeypatch):
    session, devices = opened
    limits, measure = [], LiveMeter.measure
    monkeypatch.setattr(
        LiveMeter,
        "measure",
        lambda meter, part, setting: (
            limits.append(setting.gates.max_event_rate_mev_s) or measure(meter, part, setting)
        ),
    )
    wait_until(lambda: limits == [200.0])
    session.bench.light.set(waveform="sine")
    wait_until(lambda: limits[-1] == 500.0)
    assert session.bench.stage.known_deg() == {"pan": 0.0, "tilt": 0.0}
    devices.stage.homed = False
    session.bench.stage.look()
    assert session.bench.stage.known_deg() == {}


def test_pictures_come_and_no_slice_is_left(opened):
    session, devices = opened
    wait_until(lambda: session.picture().number >= 5)
    picture = session.picture()
    assert picture.number >= 5
    assert picture.jpeg[:2] == b"\xff\xd8"
    assert picture.figures.to_json()["time_s"] > 0
    folder = devices.camera.paths[0].parent
    assert len(list(folder.iterdir())) <= 3
    assert folder.stat().st_mode & 0o077 == 0
    session.close()
    assert not folder.exists()


def test_a_jog_moves_one_axis_and_steps_add_up(opened):
    session, devices = opened
    assert session.bench.stage.move_by({"pan": 0.5}) == {"pan": 0.5}
    assert session.bench.stage.move_by({"pan": 0.5}) == {"pan": 1.0}
    _rest(session)
    assert devices.stage.at == {"pan": 1.0, "tilt": 0.0}
    devices.stage.at["pan"] = 0.9996  # the counter of a controller counts in steps
    session.bench.stage.look()
    assert session.bench.stage.move_by({"pan": -0.1}) == {"pan": 0.9}


def test_the_limit_of_an_axis_is_not_passed(opened):
    session, devices = opened
    devices.stage.at["tilt"] = 9.9
    with pytest.raises(ControlRefused, match=r"tilt .* 9.900 deg .* 10 deg") as refused:
        session.bench.stage.move_by({"tilt": 0.5})
    assert "at most 0.100 deg" in refused.value.remedy
    assert devices.stage.calls == []
    for step in (0.0, 6.0, float("nan")):
        with pytest.raises(ControlRefused, match="not possible"):
            session.bench.stage.move_by({"tilt": step})
    with pytest.raises(ControlRefused, match="no axis 'yaw'"):
        session.bench.stage.move_by({"yaw": 1.0})


def test_a_stage_that_is_not_homed_is_not_moved(opened):
    session, devices = opened
    devices.stage.homed = False
    with pytest.raises(ControlRefused, match="not homed"):
        session.bench.stage.move_by({"pan": 0.5})
    session.bench.stage.home()
    with pytest.raises(ControlRefused, match="Homing was not started"):
        session.bench.stage.home()
    _rest(session)
    assert devices.stage.calls == ["home"]
    session.bench.stage.move_by({"pan": 0.5})


def test_a_stop_reaches_the_stage_at_once_and_drops_what_waits(opened):
    session, devices = opened
    devices.stage.step_deg = 0.01
    session.bench.stage.move_by({"pan": 5.0})
    wait_until(lambda: devices.stage.at["pan"] > 0.1)
    session.bench.stage.move_by({"pan": 5.0})
    began_s = time.monotonic()
    session.stop()
    assert devices.stage.calls[-1] == "stop"
    assert time.monotonic() - began_s < 0.2
    time.sleep(0.1)
    assert 0 < devices.stage.at["pan"] < 3
    devices.stage.step_deg = 0.05
    assert not session.bench.stage.moving
    assert session.state()["stage"]["failure"] is None  # a stop that was asked for is no fault
    session.bench.stage.move_by({"pan": 0.1})
    _rest(session)
    assert devices.stage.at["pan"] < 3


def test_a_move_that_begins_just_after_a_stop_is_stopped_too(opened):
    session, devices = opened
    real, entered = devices.stage.move_to, threading.Event()

    def late(target_deg):
        entered.set()
        wait_until(lambda: devices.stage.stops >= 1)
        real(target_deg)  # the driver has seen no stop since it was called

    devices.stage.move_to = late
    session.bench.stage.move_by({"pan": 5.0})
    assert entered.wait(2)
    session.stop()
    assert devices.stage.stops >= 2
    assert not session.bench.stage.moving
    assert devices.stage.at["pan"] < 2


def test_a_failed_move_is_shown_and_the_next_one_is_possible(opened):
    session, devices = opened
    devices.stage.fault = "pan: stalled"
    session.bench.stage.move_by({"pan": 0.5})
    _rest(session)
    shown = session.state()["stage"]
    assert "stalled" in shown["failure"]["what"]
    assert shown["failure"]["remedy"] == "Free the axis."
    devices.stage.fault = ""
    session.bench.stage.move_by({"pan": 0.5})
    assert session.state()["stage"]["failure"] is None


def test_a_page_that_is_lost_stops_its_motion_within_a_second(opened):
    session, devices = opened
    devices.stage.step_deg = 0.005
    session.holder.enter("page-one")
    session.bench.stage.move_by({"pan": 5.0})
    session.bench.stage.move_by({"pan": 5.0})
    began_s = time.monotonic()
    wait_until(lambda: "stop" in devices.stage.calls)
    assert time.monotonic() - began_s < 1.5  # 0.8 s on a computer that is not busy
    _rest(session)
    assert devices.stage.at["pan"] < 10


def test_a_stop_that_is_not_confirmed_is_shouted_where_nobody_waits_for_it(opened):
    session, devices = opened
    devices.stage.step_deg, devices.stage.stop_fails = 0.005, True
    session.bench.stage.move_by({"pan": 5.0})
    session.stop_motion()
    assert session.state()["stage"]["failure"]["what"].startswith("CHECK THE BENCH")
    devices.stage.stop_fails = False


def test_ready_names_what_is_not_ready(opened):
    session, devices = opened
    wait_until(lambda: session.picture().number >= 1)
    assert session.state()["not_ready"] == ["Light", "Picture"]  # what a dark picture lacks is not judged
    session.bench.light.set(on=True)
    devices.stage.homed = False
    session.bench.stage.look()
    wait_until(lambda: "Stars" in session.state()["not_ready"])
    assert "Stage" in session.state()["not_ready"]
    assert session.state()["rows"]["Stage"]["value"] == "not homed"


def test_a_picture_that_has_grown_old_is_not_ready(opened, monkeypatch):
    session, _ = opened
    wait_until(lambda: session.picture().number >= 1)
    monkeypatch.setattr(session_module, "OLD_S", -1.0)
    assert session.state()["rows"]["Camera"]["value"] == "no new picture"


def test_the_light_is_read_back_and_its_range_is_kept(opened):
    session, devices = opened
    session.bench.light.set(frequency_hz=100.0)  # a value alone does not switch it on
    assert not devices.light.lit
    assert "on" not in devices.light.calls
    shown = session.bench.light.set(on=True, frequency_hz=50.0, level_percent=40.0)
    assert shown.on is True
    assert shown.settings.frequency_hz == 50
    assert shown.settings.high_v == pytest.approx(2.0)
    assert devices.light.calls[-1] == "on"
    before = list(devices.light.calls)
    with pytest.raises(ControlRefused, match=r"frequency_hz 20000 .* 0\.1 to 10000"):
        session.bench.light.set(frequency_hz=20_000.0)
    with pytest.raises(ControlRefused, match="level_percent 0 is outside"):
        session.bench.light.set(level_percent=0.0)
    assert devices.light.calls == before
    assert session.bench.light.set(on=False).on is False


GONE = CameraLost("the cable is out.", where="camera", remedy="Plug it in.")


@pytest.mark.parametrize(
    ("device", "unplugged", "plugged", "used"),
    [
        ("light", {"lost": True}, {"lost": False}, lambda session: session.bench.light.set(on=True)),
        ("stage", {"lost": True}, {"lost": False}, lambda session: session.bench.stage.move_by({"pan": 0.5})),
        ("camera", {"fault": GONE}, {"fault": None}, None),
    ],
)
def test_an_unplugged_device_is_shown_and_comes_back(opened, device, unplugged, plugged, used):
    session, devices = opened
    wait_until(lambda: session.picture().number >= 1)
    vars(getattr(devices, device)).update(unplugged)
    if used is not None:
        with pytest.raises(DriverError):
            used(session)
    wait_until(lambda: session.state()[device]["failure"] is not None)
    assert session.state()[device]["failure"]["remedy"] == "Plug it in."
    assert session.state()["stage"]["answers"] == (device != "stage")
    assert (session.state()["light"]["on"] is None) == (device == "light")
    vars(getattr(devices, device)).update(plugged)
    session.bench.light.look()
    seen = session.picture().number
    wait_until(lambda: session.state()[device]["failure"] is None and session.picture().number > seen)


def test_biases_change_between_two_slices_and_are_read_back(opened):
    session, devices = opened
    wait_until(lambda: session.picture().number >= 1)
    assert session.bench.camera.set("bias_diff_on", 20)["bias_diff_on"] == 20
    assert session.bench.camera.set("bias_fo", -5)["bias_diff_on"] == 20
    assert devices.camera.settings.biases["bias_fo"] == -5
    for wrong in (300, 0.5):
        with pytest.raises(ControlRefused, match=r"bias_refr .* from -50 to 255"):
            session.bench.camera.set("bias_refr", wrong)
    with pytest.raises(ControlRefused, match="no setting 'bias_x'"):
        session.bench.camera.set("bias_x", 0)
    seen = session.picture().number
    wait_until(lambda: session.picture().number > seen + 1)


def test_the_end_leaves_the_bench_safe_and_says_what_each_device_confirmed(opened):
    session, devices = opened
    session.bench.light.set(on=True)
    session.bench.stage.move_by({"pan": 5.0})
    confirmed = session.close()
    assert {end.device for end in confirmed} == {"stage", "light", "camera"}
    assert {end.state for end in confirmed} == {"confirmed safe"}
    assert devices.stage.calls[-1] == "stop"
    assert not devices.light.lit
    assert devices.closed
    assert session.close() == []
    with pytest.raises(ControlRefused):
        session.bench.stage.move_by({"pan": 0.1})
    assert session.open() is None  # a closed session stays closed
    assert not session.is_open


def test_a_camera_that_was_lost_confirms_nothing():
    session, devices = fake_session()
    session.open()
    devices.camera.fault = CameraLost("the cable is out.", where="camera", remedy="Plug it in.")
    wait_until(lambda: session.state()["camera"]["failure"] is not None)
    camera = session.close()[-1]
    assert camera.state == "not confirmed"
    assert "the cable is out" in camera.text


def test_a_busy_camera_ends_in_words_and_can_be_tried_again():
    answers = [CameraBusy("another program holds it.", where="camera", remedy="Close that program."), None]

    def opener(*_):
        error = answers.pop(0)
        if error:
            raise error
        return FakeDevices()

    session, _ = fake_session(opener=opener)
    failure = session.open()
    assert failure is not None
    assert failure.remedy == "Close that program."
    assert session.state()["devices"]["state"] == "failed"
    with pytest.raises(ControlRefused, match="another program holds it"):
        session.bench.stage.move_by({"pan": 0.1})
    assert session.reopen() is None
    session.close()


def test_a_device_that_fails_during_opening_closes_the_others():
    devices = FakeDevices()
    devices.camera.apply = lambda _: (_ for _ in ()).throw(CameraLost("gone.", where="camera"))
    session, _ = fake_session(devices)
    assert session.open().kind == "CameraLost"
    assert devices.closed


def test_a_slice_holds_the_edges_of_the_light_and_a_moving_stage_makes_it_short(opened, monkeypatch):
    monkeypatch.setattr(live_loop, "SHORTEST_S", 0.02)
    session, devices = opened
    lengths = []
    record = devices.camera.record

    def noted(path, duration_s):
        lengths.append(round(duration_s * 60))
        return record(path, duration_s)

    devices.camera.record = noted
    session.bench.light.set(on=True, frequency_hz=60.0)
    wait_until(lambda: lengths.count(live_loop.PERIODS) >= 2, 9.0)
    devices.stage.step_deg = 0.005
    session.bench.stage.move_by({"pan": 5.0})
    wait_until(lambda: lengths[-1] == live_loop.MOVING_PERIODS)


def test_a_page_is_told_of_a_move_that_fails_where_the_stage_stands():
    stage, states = FakeStage(), []
    control = StageControl(stage, lambda: states.append(control.as_data()))
    control.look(thoroughly=True)
    stage.fault, stage.faults = "the motor is stuck", list
    control.home()
    wait_until(lambda: states[-1]["failure"] and states[-1]["work"] is None)
    control.close()
    assert "the motor is stuck" in states[-1]["failure"]["what"]


class ReadingCamera(FakeCamera):
    """A camera that reads all its biases back."""

    def apply(self, settings):
        return dataclasses.replace(settings, biases={"bias_fo": 0, "bias_hpf": 0} | dict(settings.biases))


def test_a_changed_bias_is_shown_beside_that_of_the_station_file():
    devices = FakeDevices()
    devices.camera = ReadingCamera()
    session, _ = fake_session(devices)
    assert session.open() is None
    with closing(session):
        session.bench.camera.set("bias_fo", 7)
        shown = {bias["name"]: bias for bias in session.state()["camera"]["settings"]}
        assert (shown["bias_fo"]["value"], shown["bias_fo"]["expected"]) == (7, 0)
        assert (shown["bias_hpf"]["value"], shown["bias_hpf"]["expected"]) == (0, 0)
        assert session.bench.camera.row().value == "bias_fo is changed"
        assert session.state()["station_lines"] == ["camera.biases.bias_fo: 7"]
