"""Boards of the GRBL family as people meet them: greetings, alarms, limits and modes that another program left."""

import pytest

from drivers.errors import DeviceRefused, DriverError, MoveFailed, NotHomed
from drivers.stage.grbl_protocol import parse_report
from simulators.stages.grbl import FIRMWARES
from tests.unit.drivers.stage.grbl_bench import Bench

pytestmark = pytest.mark.usefixtures("never_late")

GREETINGS = [
    b"\r\nGrbl 1.1h ['$' for help]\r\n",
    b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n",
    b"\r\nGrbl 3.7 [FluidNC v3.7.17 (wifi) '$' for help]\r\n",
    b"[MSG:INFO: FluidNC v3.7.17]\n",
    b"\xc2\xb5CNC 1.8.2 ['$' for help]\r\n",
    b"rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n",
    b"<Idle|MPos:-5.0GrblHAL 1.1f ['$' or '$HELP' for help]\r\n",
    b"Turntable of the lab is ready\r\n",
    b"",
]


class Rig(Bench):
    """A board with one axis and the driver for it; machine position 0 is the angle 18."""

    def __init__(self, firmware: str = "grbl", steps_per_deg: float = 100.0) -> None:
        super().__init__("X", firmware, steps_per_deg)

    def true_deg(self) -> float:
        return self.board.axes["X"].pointing.angle_deg(self.clock.now_s + 1.0)

    def lose_power(self, greeting: bytes) -> None:
        """Restart without a start-up lock: the counter is 0 where the axis stands, and the board is idle."""
        self.board.restart(self.clock.now_s)
        self.clock.sleep(1.0)
        self.board.unsolicited()
        self.board.receive(b"$X\n")
        self.line.ready += greeting


@pytest.mark.parametrize("greeting", GREETINGS)
def test_a_restart_between_two_moves_leaves_no_reference_whatever_the_board_says(greeting) -> None:
    rig = Rig()
    stage = rig.homed()
    stage.move_to({"pan": -10.0})
    rig.lose_power(greeting)
    before_deg = rig.true_deg()
    assert not stage.is_homed()
    with pytest.raises(NotHomed, match="restarted"):
        stage.move_to({"pan": -10.0})
    assert rig.true_deg() == before_deg
    stage.home()
    stage.move_to({"pan": -10.0})
    assert rig.true_deg() == pytest.approx(-10.0, abs=0.01)


@pytest.mark.parametrize(
    "line",
    [
        b"[FIRMWARE:grblHAL]\r\n",
        b"$300=grblHAL\r\n",
        b"[MSG:Caution: Unlocked]\r\n",
        b"[MSG:INFO: Connecting to STA SSID:grbl]\r\n",
        b"<Idle|MPos:-1.000|FS:0,0|SD:5.0,/grbl.nc>\r\n",
        b"\r\n",
    ],
)
def test_what_only_names_a_firmware_is_no_restart(line) -> None:
    rig = Rig()
    stage = rig.homed()
    rig.line.ready += line
    assert stage.is_homed()


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_every_firmware_of_the_family_is_homed_and_moved(firmware) -> None:
    rig = Rig(firmware)
    stage = rig.homed()
    stage.move_to({"pan": 5.0})
    assert rig.true_deg() == pytest.approx(5.0, abs=0.01)
    assert stage.faults() == []


@pytest.mark.parametrize(
    ("firmware", "alarm", "meaning"),
    [
        ("grbl", 10, "homing did not find the second limit switch"),
        ("grblhal", 10, "the emergency stop is pressed"),
        ("grblhal", 17, "a motor driver reports a fault"),
        ("fluidnc", 14, "homing is required"),
        ("fluidnc", 123, "an alarm that is unknown for FluidNC"),
        ("fork", 10, "an alarm that is unknown for this firmware"),
        ("fork", 3, "reset while moving"),
    ],
)
def test_an_alarm_is_told_by_the_firmware_that_raised_it(firmware, alarm, meaning) -> None:
    rig = Rig(firmware)
    stage = rig.homed()
    rig.line.ready += b"ALARM:%d\r\n" % alarm
    rig.line.spoil = lambda reply: reply.replace(b"<Idle|", b"<Alarm:%d|" % alarm)
    assert rf"{meaning}" in stage.faults()[0]
    assert f"(ALARM:{alarm})" in stage.faults()[0]
    with pytest.raises(DriverError):
        stage.move_to({"pan": 1.0})
    assert rig.true_deg() == pytest.approx(17.0, abs=0.01)


@pytest.mark.parametrize(
    ("line", "state"),
    [
        (b"<Alarm:11|MPos:-1.000,0.000|FS:0,0>\r\n", ("Alarm", 11)),
        (b"<Alarm:123|MPos:-1.000|Bf:100,1023|FS:0,0|Pn:PYZHSE|H:1,7|FW:grblHAL>\n", ("Alarm", 123)),
        (b"<Run:2|MPos:-1.000,0.000|SD:4.08,/a.nc|TLR>\r\r\n", ("Run", 2)),
        (b"<Tool|MPos:-1.000,0.000,0.000,0.000|In:-1>\r\n", ("Tool", 0)),
    ],
)
def test_reports_of_the_family_are_read(line, state) -> None:
    report = parse_report(line)
    assert (report.state, report.substate, report.machine_position[0]) == (*state, -1.0)


def test_a_search_that_failed_at_once_is_told_at_once() -> None:
    rig = Rig("grblhal")
    stage = rig.open()
    began_s = rig.clock.now_s
    rig.line.lose_next(b"$H")
    rig.line.before = lambda data: setattr(
        rig.line, "ready", rig.line.ready + (b"ALARM:9\r\n" if data == b"$H\n" else b"")
    )
    rig.line.spoil = lambda reply: reply.replace(b"<Idle|", b"<Alarm|")
    with pytest.raises(MoveFailed, match="ALARM:9"):
        stage.home()
    assert rig.clock.now_s - began_s < 10.0


@pytest.mark.parametrize("steps_per_deg", [88.889, 44.45, 711.11])
def test_a_limit_can_be_reached_with_any_scale(steps_per_deg) -> None:
    rig = Rig(steps_per_deg=steps_per_deg)
    stage = rig.homed()
    for limit_deg in (-15.0, 15.0):
        stage.move_to({"pan": limit_deg})
        reached_deg = stage.position_deg()["pan"]
        assert abs(reached_deg) <= 15.0005  # the board prints three places
        assert reached_deg == pytest.approx(limit_deg, abs=1.0 / steps_per_deg + 0.0005)


@pytest.mark.parametrize(
    "left", [b"G91\n", b"$10=0\n", b"$13=1\n", b"$C\n", b"$SLP\n", b"$20=0\n", b"$32=1\n"]
)
def test_an_angle_is_right_whatever_another_program_has_left(left) -> None:
    rig = Rig()
    rig.board.receive(b"$X\n" + left)
    stage = rig.homed()
    for angle_deg in (5.0, -14.9):
        stage.move_to({"pan": angle_deg})
        assert rig.true_deg() == pytest.approx(angle_deg, abs=0.01)
        assert stage.position_deg()["pan"] == pytest.approx(angle_deg, abs=0.01)


def test_a_start_up_line_that_moves_an_axis_is_refused_before_homing() -> None:
    rig = Rig()
    rig.line.spoil = lambda reply: reply.replace(b"$N0=\r", b"$N0=G0 X-10\r")
    with pytest.raises(DeviceRefused, match="G0 X-10"):
        rig.open()


def test_a_travel_that_the_board_keeps_in_a_file_is_used_if_it_is_wide_enough() -> None:
    rig = Rig("fluidnc")
    stage = rig.homed()
    stage.move_to({"pan": -15.0})
    assert rig.board.settings[130] == 35.0
    rig.board.settings[120] = 500.0
    with pytest.raises(DeviceRefused, match=r"\$120: .*50\.000.*500\.0"):
        rig.open()


def test_homing_that_leaves_an_axis_out_is_refused() -> None:
    rig = Rig("grblhal")
    rig.board.settings |= {44: 4.0, 45: 2.0}
    with pytest.raises(DeviceRefused, match=r"reference .*\$44"):
        rig.open()
