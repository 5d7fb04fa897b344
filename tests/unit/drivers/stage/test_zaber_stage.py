"""The Zaber stage on its simulated controllers: what it sends, what it refuses, and how it stops.

``tests/hil/test_every_fault.py`` shows what each family does with faults of axis and line.
"""

import re
import threading

import pytest

from drivers.errors import DeviceRefused, MoveFailed, NotHomed, OutsideLimits, ReplyError
from drivers.stage import AxisLimits
from drivers.stage.zaber_protocol import checksum
from tests.unit.drivers.stage.zaber_bench import SCALE, Bench, words

pytestmark = pytest.mark.usefixtures("never_late")


@pytest.fixture
def bench() -> Bench:
    return Bench()


# ---------------------------------------------------------------- the good case
def test_opening_moves_nothing_and_programs_what_differs(bench) -> None:
    stage = bench.open()
    assert bench.motions() == []
    assert stage.axes == ("pan", "tilt")
    assert not stage.is_homed()
    assert [text.split("set ")[1] for text in bench.requests("set") if text.startswith("/1")] == [
        "comm.checksum 1",
        "maxspeed 16384",
        "accel 8",
    ]
    bench.line.sent.clear()
    bench.open()
    assert bench.requests("set") == []


def test_a_firmware_that_knows_the_new_name_of_the_model_alone_is_opened(bench) -> None:
    """zproto, settings of firmware 7.38: device.id, and no deviceid, as in 6.14."""
    refused = words(lambda reply: [*reply[:3], "RJ", *reply[4:6], "BADCOMMAND"])
    bench.line.spoil = lambda reply: refused(reply) if b"deviceid" in bench.line.sent[-1] else reply
    assert [axis.model for axis in bench.open().identify()] == ["device id 50958"] * 2


def test_counter_zero_and_direction_are_the_station_files(bench) -> None:
    limits = AxisLimits(-5.0, 5.0, 10.0, 50.0)
    stage = bench.open(microsteps_per_deg=-SCALE, zero_deg=2.0, limits=limits)
    limits = [text.split("limit.")[1] for text in bench.requests("set limit") if text.startswith("/1")]
    assert limits == ["min -3000", "max 7000"]
    stage.home()
    assert stage.position_deg()["pan"] == 2.0
    stage.move_to({"pan": 3.2346})
    assert bench.position("pan") == -1235
    assert stage.position_deg()["pan"] == pytest.approx(3.235, abs=1e-9)


def test_what_is_only_history_is_no_fault_and_is_cleared_before_a_move(bench) -> None:
    stage = bench.homed()
    bench.go("pan")
    bench.clock.sleep(0.1)
    stage.stop()
    assert bench.pan.warnings(bench.clock.now_s) == ["NI"]
    assert stage.faults() == []
    stage.move_to({"pan": 1.0})
    assert bench.pan.warnings(bench.clock.now_s) == []


# ---------------------------------------------------------------- refused before anything moves


@pytest.mark.parametrize(
    ("setting", "value", "error", "message"),
    [
        (
            "limit.max",
            "9000",
            OutsideLimits,
            r"allows -15 to 15 deg, but the controller allows only -15 to 9 deg \(-15000 to 9000 microsteps\)",
        ),
        ("maxspeed", "777", DeviceRefused, "maxspeed was set to 16384, but reads 777"),
    ],
)
def test_settings_that_read_otherwise_are_refused(bench, setting, value, error, message) -> None:
    bench.answer(f"01 get {setting}", 6, value)
    with pytest.raises(error, match=message):
        bench.open()


def test_a_scale_that_is_not_the_controllers_is_refused(bench) -> None:
    real = bench.tilt.execute
    bench.tilt.execute = lambda axis, words, t_s: (
        "720000" if words == ["get", "limit.cycle.dist"] else real(axis, words, t_s)
    )
    with pytest.raises(OutsideLimits, match=r"360000 microsteps .* 720000"):
        bench.open()


# ---------------------------------------------------------------- what another program has left
def test_a_controller_from_the_factory_gets_its_checksums_and_keeps_them(bench) -> None:
    assert bench.line.device.receive(b"/1 0 05 get comm.checksum\n") == b"@01 0 05 OK IDLE WR 0\r\n"
    stage = bench.homed()
    stage.move_to({"pan": 5.0})
    assert bench.position("pan") == 5000
    assert bench.line.device.receive(b"/1 0 05 get comm.checksum\n").startswith(b"@01 0 05 OK IDLE -- 1:")


@pytest.mark.parametrize("resolution", [32, 128])
def test_another_resolution_is_refused_unless_the_station_states_it(bench, resolution) -> None:
    for controller in (bench.pan, bench.tilt):
        controller.execute(1, ["set", "resolution", str(resolution)], bench.clock.now_s)
    limits = AxisLimits(-5.0, 5.0, 10.0, 50.0)
    with pytest.raises(OutsideLimits, match=f"64 microsteps .* {resolution}"):
        bench.open(limits=limits)
    bench.open(limits=limits, resolution=resolution)


def with_setting(bench, name: str, value: int) -> None:
    """Give both controllers a setting more."""
    receive = bench.line.device.receive

    def answer(data: bytes) -> bytes:
        asked = re.match(rf"/(\d) (\d) (\d\d) get {re.escape(name)}:".encode(), data)
        if asked is None:
            return receive(data)
        body = b"%02d %s %s OK IDLE WR %d" % (int(asked[1]), asked[2], asked[3], value)
        return b"@%s:%02X\r\n" % (body, checksum(body))

    bench.line.device.receive = answer


@pytest.mark.parametrize(
    ("name", "value", "stated"),
    [("limit.home.preset", 25_600, {}), ("driver.dir", 1, {"driver.dir": 0}), ("nonsense", 1, {"other": 1})],
)
def test_a_setting_that_changes_every_angle_is_refused_unless_it_is_stated(bench, name, value, stated):
    """Zaber ASCII Protocol Manual, command home: the position is then reset to ``limit.home.preset``."""
    with_setting(bench, name, value)
    with pytest.raises(OutsideLimits, match="Nothing was set"):
        bench.open(settings=stated)
    assert bench.motions() == []
    bench.open(settings={name: value})


def test_a_deceleration_of_its_own_is_set_to_the_acceleration(bench) -> None:
    bench.pan.execute(1, ["set", "motion.decelonly", "0"], bench.clock.now_s)
    bench.open()
    assert bench.pan.execute(1, ["get", "motion.decelonly"], bench.clock.now_s) == "8"


def test_a_position_that_another_program_has_set_is_no_reference(bench) -> None:
    bench.homed().close()
    bench.pan.execute(1, ["set", "pos", "5000"], bench.clock.now_s)
    bench.line.closed = False
    stage = bench.open()
    assert not stage.is_homed()
    with pytest.raises(NotHomed, match="has homed the axis"):
        stage.move_to({"pan": 1.0})


def test_an_acceleration_too_small_to_be_told_is_refused_not_made_infinite(bench) -> None:
    """``accel`` 0 would switch the ramp off."""
    with pytest.raises(OutsideLimits, match="6 deg/s"):
        bench.open(limits=AxisLimits(-15.0, 15.0, 10.0, 6.0))
    assert bench.requests("set accel") == []


def test_an_axis_that_somebody_parked_or_moves_is_left_alone(bench) -> None:
    stage = bench.homed()
    bench.go("pan")
    with pytest.raises(MoveFailed, match="already moving"):
        stage.move_to({"pan": 1.0})
    assert bench.motions() == []
    bench.clock.sleep(5.0)
    with pytest.raises(NotHomed, match=r"0\.0000 deg .* 9\.0000 deg"):
        stage.move_to({"pan": 1.0})
    assert not stage.is_homed()
    stage.home()
    bench.pan.execute(1, ["tools", "parking", "park"], bench.clock.now_s)
    with pytest.raises(DeviceRefused, match="the axis is parked"):
        stage.move_to({"pan": 1.0})


@pytest.mark.parametrize("flag", ["FS", "FH", "FE", "WM", "FX"])
def test_an_axis_with_a_fault_is_not_moved_until_it_is_homed_again(bench, flag) -> None:
    stage = bench.homed()
    mend = bench.answer("02 warnings", 6, f"01 {flag}")
    with pytest.raises(MoveFailed, match=f"tilt: .*{flag}.* Nothing was moved"):
        stage.move_to({"pan": 1.0, "tilt": 1.0})
    assert bench.motions() == []
    mend()
    stage.home()
    stage.move_to({"pan": 1.0, "tilt": 1.0})


@pytest.mark.parametrize(
    ("asked_of", "place", "word"),
    [
        *(
            ("01 get pos", place, word)
            for place, word in ((0, "02"), (1, "2"), (2, "70"), (6, "12.5"), (6, "1_0"))
        ),
        ("01 warnings", 6, "02 WR"),
    ],
)
def test_well_formed_nonsense_is_refused(bench, asked_of, place, word) -> None:
    stage = bench.homed()
    bench.answer(asked_of, place, word)
    with pytest.raises(ReplyError):
        stage.move_to({"pan": 1.0})
    assert bench.motions() == []


def test_a_flag_hidden_behind_a_more_urgent_one_is_found_at_the_end(bench) -> None:
    stage = bench.homed()
    bench.line.once_moving(b" move ", lambda: bench.answer("01 warnings", 6, "02 WT NI"))
    with pytest.raises(MoveFailed, match="NI"):
        stage.move_to({"pan": 9.0})


# ---------------------------------------------------------------- the line, and stops
def test_a_stop_reaches_all_axes_with_one_line(bench) -> None:
    stage = bench.homed()
    bench.go("pan")
    bench.go("tilt")
    bench.clock.sleep(0.1)
    stage.stop()
    assert re.fullmatch(r"/0 0 \d\d stop", bench.requests("stop")[0])
    assert bench.line.sent[0].startswith(b"/0 0 ")
    assert not bench.busy()


def test_a_stop_while_a_move_is_sent_goes_out_after_it_and_keeps_the_second_axis_from_starting(bench) -> None:
    stage = bench.homed()
    stopper = threading.Thread(target=stage.stop)

    def stop_meanwhile(request: bytes) -> None:
        if b" move " in request:
            stopper.start()
            stopper.join(0.2)

    bench.line.before = stop_meanwhile
    with pytest.raises(MoveFailed, match="stopped on request"):
        stage.move_to({"pan": 9.0, "tilt": 9.0})
    stopper.join()
    assert len(bench.motions()) == 1
    kinds = [word for line in bench.line.sent for word in ("move", "stop") if f" {word}".encode() in line]
    assert kinds[0] == "move"
    assert "stop" in kinds
    assert not bench.busy()


def test_a_stop_that_one_device_did_not_hear_is_sent_again(bench) -> None:
    stage = bench.homed()

    def lose_one(reply: bytes) -> bytes:
        bench.line.spoil = lambda later: later
        return reply[: reply.index(b"@02")]

    bench.line.spoil = lose_one
    stage.stop()
    assert len(bench.requests("stop")) == 2
