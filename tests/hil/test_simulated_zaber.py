"""The simulated Zaber gimbal, driven by the maker's own client, and byte by byte."""

import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import serial

from simulators.stages.axis_motion import MotionFault
from simulators.stages.zaber import checksum
from tests.hil.direct_stages import of_one_port

SCALE = 6400


class Gimbal:
    """The two chained controllers of a simulated bench on a clock that the test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.chain, controllers = of_one_port("zaber", lambda: self.now_s)
        self.pan = controllers["pan"]

    def ask(self, body: str) -> list[str]:
        """Send a request with its checksum; check the checksums of the replies and return the replies without them."""
        answer = self.chain.receive(f"/{body}:{checksum(body)}\n".encode())
        replies = []
        for line in answer.decode().split("\r\n")[:-1]:
            text, _, given = line.partition(":")
            assert given == checksum(text[1:])
            replies.append(text)
        return replies

    def wait(self, seconds: float = 60.0) -> None:
        self.now_s += seconds


@pytest.fixture
def gimbal() -> Gimbal:
    gimbal = Gimbal()
    assert gimbal.chain.receive(b"/0 0 00 get comm.checksum\n") == b"".join(
        b"@%02d 0 00 OK IDLE WR 0\r\n" % device for device in (1, 2)
    )
    gimbal.ask("0 0 00 set comm.checksum 1")
    return gimbal


@pytest.fixture
def homed(gimbal: Gimbal) -> Gimbal:
    gimbal.ask("0 0 01 home")
    gimbal.wait()
    return gimbal


# ---------------------------------------------------------------- the maker's client
def test_the_makers_client_detects_homes_moves_stops_and_reads(zaber_port: str, tmp_path) -> None:
    ascii_ = pytest.importorskip("zaber_motion.ascii", reason="the maker's client is not installed")
    from zaber_motion import Library
    from zaber_motion.exceptions import BadDataException, CommandFailedException

    Library.enable_device_db_store(str(tmp_path))
    with ascii_.Connection.open_serial_port(zaber_port) as connection:
        devices = connection.detect_devices(identify_devices=False)
        assert [device.device_address for device in devices] == [1, 2]
        pan, tilt = (device.get_axis(1) for device in devices)
        assert not pan.is_homed()
        assert pan.warnings.get_flags() == {"WR"}
        for axis in (pan, tilt):
            axis.home()
            assert axis.is_homed()
            assert axis.get_position() == 0
        pan.move_absolute(20_000)
        tilt.move_relative(-12_800)
        assert (pan.get_position(), tilt.get_position()) == (20_000, -12_800)
        pan.move_max(wait_until_idle=False)
        assert pan.is_busy()
        pan.stop()
        assert not pan.is_busy()
        assert 20_000 < pan.get_position() < 15 * SCALE
        with pytest.raises(BadDataException):
            pan.move_absolute(15 * SCALE + 1)
        pan.park()
        assert pan.is_parked()
        with pytest.raises(CommandFailedException):
            pan.move_absolute(0)
        pan.unpark()
        pan.move_absolute(0)
        assert pan.get_position() == 0
        assert devices[1].generic_command("get system.serial").data == "100102"


def test_the_makers_client_sees_a_move_interrupted_by_another(zaber_port: str, tmp_path) -> None:
    ascii_ = pytest.importorskip("zaber_motion.ascii", reason="the maker's client is not installed")
    from zaber_motion import Library
    from zaber_motion.exceptions import MovementInterruptedException

    Library.enable_device_db_store(str(tmp_path))
    with ascii_.Connection.open_serial_port(zaber_port) as connection:
        axis = connection.get_device(1).get_axis(1)
        axis.home()
        with ThreadPoolExecutor() as pool:
            waiting = pool.submit(axis.move_absolute, 15 * SCALE)
            while connection.generic_command("", device=1, axis=1).status != "BUSY":
                pass
            connection.generic_command("move abs 0", device=1, axis=1)
            with pytest.raises(MovementInterruptedException):
                waiting.result()


# ---------------------------------------------------------------- the protocol
@pytest.mark.parametrize(
    ("request_body", "replies"),
    [
        ("0 0 00", ["@01 0 00 OK IDLE WR 0", "@02 0 00 OK IDLE WR 0"]),
        ("1 0 07 get deviceid", ["@01 0 07 OK IDLE WR 50958"]),
        ("2 0 99 get system.serial", ["@02 0 99 OK IDLE WR 100102"]),
        ("1 1 08 get pos", ["@01 1 08 OK IDLE WR 0"]),
        ("1 1 08 get nonsense", ["@01 1 08 RJ IDLE WR BADCOMMAND"]),
        ("1 1 08 set deviceid 5", ["@01 1 08 RJ IDLE WR BADCOMMAND"]),
        ("1 1 08 move abs far", ["@01 1 08 RJ IDLE WR BADDATA"]),
        ("1 1 08 move abs 96001", ["@01 1 08 RJ IDLE WR BADDATA"]),
        ("1 2 08 home", ["@01 2 08 RJ IDLE WR BADAXIS"]),
        ("1 1 08 warnings", ["@01 1 08 OK IDLE WR 01 WR"]),
        ("1 1 get limit.max", ["@01 1 OK IDLE WR 96000"]),
        ("3 1 08 home", []),
        ("1 1 08 home fast", ["@01 1 08 RJ IDLE WR BADCOMMAND"]),
        ("2 1 08 set maxspeed 0", ["@02 1 08 RJ IDLE WR BADDATA"]),
    ],
)
def test_a_request_is_answered_as_the_protocol_specifies(
    gimbal: Gimbal, request_body: str, replies: list[str]
):
    assert gimbal.ask(request_body) == replies


def test_speed_and_acceleration_settings_make_the_ramp(homed: Gimbal):
    homed.ask(f"1 1 02 set maxspeed {round(10 * SCALE * 1.6384)}")
    homed.ask(f"1 1 03 set accel {round(50 * SCALE * 1.6384 / 10_000)}")
    homed.ask(f"1 1 04 move abs {10 * SCALE}")
    homed.wait(1.19)
    assert homed.ask("1 1 05") == ["@01 1 05 OK BUSY -- 0"]
    homed.wait(0.02)
    assert homed.ask("1 1 06") == ["@01 1 06 OK IDLE -- 0"]


def test_alerts_are_sent_unsolicited_if_enabled(homed: Gimbal):
    homed.ask("1 1 02 move abs 100")
    homed.wait()
    assert homed.chain.unsolicited() == b""
    homed.ask("1 0 03 set comm.alert 1")
    homed.ask("1 1 04 move abs 0")
    assert homed.chain.unsolicited() == b""
    homed.wait()
    assert homed.chain.unsolicited() == b"!01 1 IDLE --:" + checksum("01 1 IDLE --").encode() + b"\r\n"
    assert homed.chain.unsolicited() == b""


def test_a_stall_stops_the_axis_and_raises_its_flag_until_cleared(homed: Gimbal):
    homed.pan.axis.arm(MotionFault("stall", share=0.5))
    homed.ask("1 1 02 move abs 64000")
    homed.wait()
    assert homed.ask("1 1 03 get pos") == ["@01 1 03 OK IDLE FS 32000"]
    assert homed.ask("1 1 04 warnings clear") == ["@01 1 04 OK IDLE -- 01 FS"]


# ---------------------------------------------------------------- the line
def test_bytes_take_their_time_on_the_line(zaber_port: str):
    with serial.Serial(zaber_port, 115_200, timeout=5.0) as line:
        begun = time.monotonic()
        line.write(b"/0 0 00\n")
        answer = line.read_until(b"\n") + line.read_until(b"\n")
        assert time.monotonic() - begun >= (8 + len(answer)) * 10 / 115_200


def test_a_wrong_baud_rate_is_garbage(zaber_port: str):
    with serial.Serial(zaber_port, 9600, timeout=0.2) as line:
        line.write(b"/0 0 00 home\n")
        answer = line.read(100)
        assert len(answer) == 13
        assert not answer.isascii()
    with serial.Serial(zaber_port, 115_200, timeout=5.0) as line:
        line.write(b"/1 1 00\n")
        assert line.read_until(b"\n").startswith(b"@01 1 00 OK IDLE WR")
