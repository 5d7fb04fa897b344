"""What Grbl's descendants say on the line, as people have published it."""

import re

import pytest

from drivers.errors import DeviceRefused, OutsideLimits, ReplyError
from simulators.stages.grbl import FIRMWARES
from tests.unit.drivers.stage.grbl_bench import Bench

pytestmark = pytest.mark.usefixtures("never_late")

TARGET = {"pan": 7.0, "tilt": 12.0}


@pytest.fixture
def bench() -> Bench:
    return Bench()


def runs(bench: Bench) -> None:
    """Open, home and move; the board is at the angle that it is asked for, and its stage says so."""
    stage = bench.open()
    assert bench.motions() == []
    stage.home()
    stage.move_to(TARGET)
    assert stage.position_deg() == TARGET
    assert stage.is_homed()
    assert stage.faults() == []
    bench.clock.sleep(1.0)  # until the load has settled
    for letter, angle_deg in zip("XY", TARGET.values(), strict=True):
        axis = bench.board.axes[letter]
        assert axis.pointing.angle_deg(bench.clock.now_s) == pytest.approx(angle_deg, abs=1e-3)


def reports_by_itself(bench: Bench, every_s: float) -> None:
    """Let the board send a report in each interval, without a question."""
    unsolicited, latest_s = bench.line.device.unsolicited, [bench.clock.now_s]

    def heard() -> bytes:
        if bench.clock.now_s - latest_s[0] < every_s:
            return unsolicited()
        latest_s[0] = bench.clock.now_s
        return unsolicited() + bench.board.receive(b"?")

    bench.line.device.unsolicited = heard


def in_words(line: bytes) -> bytes:
    """Return an error in FluidNC's words, any other line as it is."""
    words = {b"3": b"Invalid $ statement", b"162": b"Read-only setting"}
    return re.sub(
        rb"^error:(\d+)", lambda match: b"error:" + words.get(match[1], b"Bad GCode number format"), line
    )


DIALECTS = {
    # FluidNC's Report.cpp up to 3.7, with verbose_errors: true; Grbl_Esp32 with $Errors/Verbose=On has a blank more.
    "errors in words": in_words,
    "errors in words after a blank": lambda line: re.sub(rb"^error:\d+", b"error: Bad number format", line),
    # FluidNC's Channel.cpp since 3.9: the words follow in a message.
    "errors with words": lambda line: line + b"[MSG:ERR: Bad number]\r\n" if line[:6] == b"error:" else line,
    # grblHAL's report.c: more than one spindle, and a message that has not been acknowledged yet.
    "a field with a digit": lambda line: line.replace(b"|FS:", b"|SP1:0,,|FS:"),
    "a field with a dollar sign": lambda line: line.replace(b">\r\n", b"|FW:grblHAL|$C:1>\r\n"),
    # Wiki page "Report extensions" of grblHAL: [MOTORFAULT:...] and the like come between reports.
    "a fault of a motor before reports": lambda line: (
        b"[MOTORFAULT:Z]\r\n" + line if line.startswith(b"<") else line
    ),
    "each report twice": lambda line: line + line if line.startswith(b"<") else line,
}


@pytest.mark.parametrize("name", DIALECTS)
def test_a_board_is_driven_in_the_dialect_with(bench, name) -> None:
    bench.change(DIALECTS[name])
    runs(bench)


@pytest.mark.parametrize("every_s", [0.05, 0.1, 0.2, 1.0])
def test_a_board_that_reports_by_itself_is_driven(bench, every_s) -> None:
    """FluidNC issue 725: another program had sent ``$ri=50``; grblHAL issue 281: ``$481`` survives a restart."""
    reports_by_itself(bench, every_s)
    runs(bench)


def test_a_board_that_reports_by_itself_is_stopped_and_homed_after_a_lost_reply(bench) -> None:
    reports_by_itself(bench, 0.05)
    stage = bench.homed()
    bench.line.lose_next(b"$J")
    with pytest.raises(ReplyError, match="no complete reply"):
        stage.move_to(TARGET)
    assert bench.at_rest()
    assert not stage.is_homed()
    stage.home()
    stage.move_to(TARGET)
    assert stage.position_deg() == TARGET


@pytest.mark.parametrize("echo", [b"[echo: %s]\r\n", b"%s\r\n"])
def test_a_board_that_echoes_its_lines_is_driven(bench, echo) -> None:
    """Grbl's config.h, REPORT_ECHO_LINE_RECEIVED; FluidNC's lineedit.cpp once a terminal has edited a line."""
    receive = bench.line.device.receive

    def answer(data: bytes) -> bytes:
        return (echo % data.strip() if data.endswith(b"\n") else b"") + receive(data)

    bench.line.device.receive = answer
    runs(bench)


def test_a_refusal_in_words_is_told_in_these_words(bench) -> None:
    bench.change(lambda line: line.replace(b"error:5", b"error:Setting disabled"))
    stage = bench.open()
    bench.board.settings[22] = 0
    with pytest.raises(DeviceRefused, match="refuses '\\$H': 'Setting disabled'"):
        stage.home()


DAMAGES = {
    "a letter of the label": lambda line: line.replace(b"MPos", b"MPo"),
    "the colon": lambda line: line.replace(b"MPos:", b"MPos"),
    "a point": lambda line: re.sub(rb"(MPos:-?\d+)\.", rb"\1", line),
    "a comma": lambda line: re.sub(rb"(MPos:-?\d+\.\d+),", rb"\1", line),
    "a digit": lambda line: re.sub(rb"(MPos:-?)\d(?=\d)", rb"\1", line),
    "the sign": lambda line: line.replace(b"MPos:-", b"MPos:"),
    "the last position": lambda line: re.sub(rb"(MPos:[-\d.]+,[-\d.]+),[-\d.]+", rb"\1", line),
}


@pytest.mark.parametrize("lost", DAMAGES)
def test_a_report_that_lost_a_byte_does_no_harm_though_it_can_be_read_without(bench, lost) -> None:
    """Universal G-Code Sender issue 1527 and grbl issue 1825: boards whose reports lose a byte now and then."""
    stage = bench.homed()
    reports = [0]

    def damaged(line: bytes) -> bytes:
        reports[0] += line.startswith(b"<")
        return DAMAGES[lost](line) if line.startswith(b"<") and reports[0] % 3 == 0 else line

    bench.change(damaged)
    for target in ({"pan": -3.0, "tilt": 2.0}, TARGET):
        stage.move_to(target)
        assert stage.position_deg() == target


def test_a_board_that_searches_its_switches_slowly_is_waited_for(bench) -> None:
    """usbcnc/grbl issue 22 shows ``$24=25.000``, 0.4 degrees a second on a gimbal; ``$25`` may be as slow."""
    bench.board.settings.update({24: 1.0, 25: 1.5})
    stage = bench.open()
    began_s = bench.clock.now_s
    stage.home()
    assert bench.clock.now_s - began_s > 250.0
    assert stage.is_homed()


@pytest.mark.parametrize(("name", "value"), [("$3", 2.0), ("$22", 9.0), ("$27", 2.0), ("$150", 16.0)])
def test_a_setting_that_changes_every_angle_is_refused_unless_it_is_the_stated_one(bench, name, value):
    """grblHAL issue 289 tells people to set ``$22=9``: then homing sets another position; ``$15x`` are microsteps."""
    bench.board.settings[int(name[1:])] = value
    with pytest.raises(OutsideLimits, match=rf"has \{name} 1, .* {value:g}\. Nothing was set"):
        bench.open(settings={name: 1.0})
    assert not bench.wrote_settings()
    bench.open(settings={name: value})


def test_a_stated_setting_that_the_board_does_not_have_is_named(bench) -> None:
    with pytest.raises(OutsideLimits, match="no such setting"):
        bench.open(settings={"$150": 16.0})


# ---------------------------------------------------------------- how FluidNC homes


class FluidNc(Bench):
    """A board with FluidNC whose configuration file is as the station wants it, but for what a test changes."""

    def __init__(self) -> None:
        super().__init__(firmware="fluidnc")
        self.configured: dict[str, str | None] = {}
        receive = self.line.device.receive

        def answer(data: bytes) -> bytes:
            name = data.decode("latin-1").strip()
            if name not in self.configured:
                return receive(data)
            value = self.configured[name]
            return b"error:3\r\n" if value is None else f"{name}={value}\r\nok\r\n".encode()

        self.line.device.receive = answer


@pytest.mark.parametrize("cycle", ["0", "-1", None])
def test_an_axis_that_fluidnc_leaves_out_of_homing_is_refused(cycle) -> None:
    """FluidNC's Homing.h: 0 is left out of ``$H``; -1 assigns a position without a search; else it has no section."""
    bench = FluidNc()
    bench.configured["$/axes/y/homing/cycle"] = cycle
    with pytest.raises(DeviceRefused, match="tilt: homing"):
        bench.open()
    assert bench.motions() == []


def test_an_axis_that_homes_downwards_is_refused_though_the_version_does_not_tell_23() -> None:
    """FluidNC's SettingsDefinitions.cpp: 3.8 tells ``$20`` to ``$22`` only."""
    bench = FluidNc()
    bench.change(lambda line: b"" if line.startswith(b"$23=") else line)
    bench.configured["$/axes/x/homing/positive_direction"] = "false"
    bench.configured["$/axes/y/homing/positive_direction"] = "true"
    with pytest.raises(OutsideLimits, match=r"pan: .* downwards"):
        bench.open()


def test_a_fluidnc_that_tells_no_paths_is_driven_by_its_settings() -> None:
    bench = FluidNc()
    bench.configured = {
        f"$/axes/{letter}/homing/{name}": None for letter in "xy" for name in ("cycle", "positive_direction")
    }
    runs(bench)


def test_a_version_without_settings_is_named_and_not_the_limit_switches() -> None:
    """FluidNC's SettingsDefinitions.cpp: ``$$`` of 3.7 and older has ``$10`` and ``$13`` only."""
    bench = FluidNc()
    bench.board.settings = {10: 1.0, 13: 0.0}
    with pytest.raises(DeviceRefused, match=r"no \$22.*FluidNC .*3\.8") as caught:
        bench.open()
    assert "limit switch" not in str(caught.value)


@pytest.mark.parametrize("position", [150.0, 0.5, -40.0])
def test_a_position_at_the_reference_outside_the_travel_ends_the_homing(position) -> None:
    """FluidNC issue 1051 shows "Axis X (-572.000,150.000)": ``mpos_mm`` is any number, and no range is enforced."""
    bench = FluidNc()
    stage = bench.open()
    bench.change(lambda line: re.sub(rb"MPos:[-\d.]+", b"MPos:%.3f" % position, line))
    with pytest.raises(OutsideLimits, match=f"machine position {position:.3f}"):
        stage.home()
    bench.change(lambda line: line)
    assert not stage.is_homed()
    assert not any(data.startswith(b"$J") for data in bench.line.sent)


# ---------------------------------------------------------------- letters of the axes
def board_with(letters: str) -> Bench:
    """Return a bench whose board tells the letters of its axes, as grbl-Mega-5X and grblHAL do."""
    bench = Bench(letters)
    build = f"[VER:1.1t.20210510:{{}}]\r\n[AXS:{len(letters)}:{letters}]\r\n[OPT:VMZ,35,255]\r\n"
    bench.board.firmware = FIRMWARES["grbl"]._replace(build=build)
    return bench


@pytest.mark.parametrize("letters", ["XYZAC", "XYZUV"])
def test_the_order_of_axes_is_that_of_the_board(letters) -> None:
    """grbl-Mega-5X issue 229: [AXS:5:XYZAC] is the order of positions and settings; grblHAL, AXIS_REMAP_ABC2UVW."""
    bench = board_with(letters)
    bench.board.settings[104] = 50.0
    with pytest.raises(OutsideLimits, match=r"controller 50\..*\$104"):
        bench.open(letters[3:])
    bench.board.settings[104] = 100.0
    stage = bench.open(letters[3:])
    stage.home()
    stage.move_to(TARGET)
    assert stage.position_deg() == TARGET
    assert bench.board.axes[letters[4]].pointing.angle_deg(bench.clock.now_s + 1.0) == pytest.approx(12.0)


def test_an_axis_that_the_board_does_not_name_is_refused() -> None:
    with pytest.raises(DeviceRefused, match=r"no axis B; .* X, Y, Z, A, C"):
        board_with("XYZAC").open("XB")


def test_a_board_that_names_two_motors_once_is_refused(bench) -> None:
    """grbl-Mega-5X report.c, REPORT_VALUE_FOR_AXIS_NAME_ONCE: the settings have another order than the letters."""
    build = "[VER:1.1q.20210103:{}]\r\n[AXS:5:XYZA]\r\n[OPT:V,15,128]\r\n"
    bench.board.firmware = FIRMWARES["grbl"]._replace(build=build)
    with pytest.raises(DeviceRefused, match="fewer letters"):
        bench.open()
    assert not bench.wrote_settings()


def test_a_board_that_tells_no_name_is_driven(bench) -> None:
    """uCNC, grbl_protocol.c: no colon, and no name, follow the version."""
    bench.board.firmware = FIRMWARES["fork"]._replace(build="[VER: uCNC 1.11 - Uno]\r\n[OPT:VL,15,128]\r\n")
    assert [axis.firmware for axis in bench.open().identify()] == ["uCNC 1.11 - Uno"] * 2
    runs(bench)


def test_a_grblhal_that_is_built_to_be_compatible_is_known_by_its_longer_answer(bench) -> None:
    """grblHAL report.c, COMPATIBILITY_LEVEL above 0: ``$I`` has neither the name nor the axes, ``$I+`` has both."""
    build = "[VER:1.1f.20240330:{}]\r\n[OPT:VNMZHL,35,1024]\r\n"
    bench.board.firmware = FIRMWARES["grbl"]._replace(build=build)
    more = build.format(bench.board.name) + "[AXS:2:XY]\r\n[FIRMWARE:grblHAL]\r\nok\r\n"
    receive = bench.board.receive
    bench.board.receive = lambda data: more.encode() if data == b"$I+\n" else receive(data)
    stage = bench.homed()
    bench.somebody_says(b"")
    bench.line.ready += b"ALARM:10\r\n"
    assert "emergency stop" in stage.faults()[0]
