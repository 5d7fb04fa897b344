"""The unchanged GRBL 1.1 firmware, compiled for this computer: our driver moves it, and our simulated board equals it.

The firmware is not part of Starbench (GPL). Name its folder to run these tests:

    git clone https://github.com/gnea/grbl; export STARBENCH_GRBL_SOURCE=$PWD/grbl/grbl
"""

import os
import re
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from waiting import wait_until

from drivers.clock import SystemClock
from drivers.errors import MoveFailed, NotHomed, OutsideLimits
from drivers.stage import AxisLimits
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.grbl_controller import CANCEL_JOG, STATUS
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.grbl import GrblController
from tests.hil.grbl_firmware.board import FACTORY, SOURCE, STEPS_PER_DEG, NativeBoard, compile_board

pytestmark = [
    pytest.mark.skipif(SOURCE not in os.environ, reason=f"{SOURCE} names no firmware"),
    pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc on this computer"),
]
PATIENCE_S = 60.0
HIGHEST_DEG = {"pan": 15.0, "tilt": 10.0}
START_BELOW_DEG = (12.6, 11.7, 10.0)
SETTINGS = FACTORY | {1: 255, 20: 1, 21: 1}


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compile_board(tmp_path_factory.mktemp("grbl"))


@pytest.fixture
def board(program: Path, tmp_path: Path) -> Iterator[NativeBoard]:
    board = NativeBoard(program, tmp_path / "eeprom", START_BELOW_DEG)
    board.set_up(SETTINGS)
    yield board
    board.close()


# ------------------------------------------------------------ the driver on the firmware
class Wire:
    """All bytes on the line of a stage, in order."""

    def __init__(self) -> None:
        self.parts: list[tuple[str, bytes]] = []

    def record(self, _t_s: float, _port: str, direction: str, data: bytes) -> None:
        self.parts.append((direction, data))

    def sent_after(self, report: bytes) -> list[bytes]:
        """What was sent after the board had told something."""
        heard = b""
        for place, (direction, data) in enumerate(self.parts):
            heard += data if direction == "<" else b""
            if report in heard:
                return [later for way, later in self.parts[place:] if way == ">"]
        raise AssertionError(heard)


def open_stage(board: NativeBoard, heard: Wire | None = None) -> GrblStage:
    axes = [
        GrblAxis(
            name=name,
            letter=letter,
            steps_per_deg=STEPS_PER_DEG,
            limits=AxisLimits(-highest, highest, 40.0, 200.0),
            zero_deg=highest + 1.0,
        )
        for letter, (name, highest) in zip("XY", HIGHEST_DEG.items(), strict=True)
    ]
    return GrblStage.open(board.port, axes, serial="gimbal", clock=SystemClock(), wire_log=heard)


@pytest.fixture
def heard() -> Wire:
    return Wire()


@pytest.fixture
def stage(board: NativeBoard, heard: Wire) -> Iterator[GrblStage]:
    board.say("$I=gimbal\n")
    stage = open_stage(board, heard)
    yield stage
    stage.close()


@contextmanager
def once_it_moves(board: NativeBoard, act: Callable[[], None]) -> Iterator[None]:
    """Do something as soon as the first axis is a degree away from where it stands."""
    start_deg = board.angles_below()[0]

    def wait() -> None:
        wait_until(lambda: abs(board.angles_below()[0] - start_deg) >= 1.0, PATIENCE_S)
        act()

    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(wait)
        yield
        done.result()


def test_identity_homing_moves_and_limits(board: NativeBoard, stage: GrblStage):
    assert [(axis.serial, axis.firmware) for axis in stage.identify()] == [("GIMBAL", "1.1h.20190830")] * 2
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 0.0})
    stage.home()
    assert stage.faults() == []
    before = board.angles_below()
    stage.move_to({"pan": -6.0, "tilt": 2.0})
    assert stage.position_deg() == pytest.approx({"pan": -6.0, "tilt": 2.0}, abs=0.002)
    moved = [b - a for a, b in zip(before, board.angles_below(), strict=True)]
    assert moved == pytest.approx([-21.0, -8.0, 0.0], abs=0.002)
    with pytest.raises(OutsideLimits):
        stage.move_to({"pan": 16.0})


def test_a_limit_switch_is_named_and_homing_at_once_works(board: NativeBoard, stage: GrblStage, heard: Wire):
    """The firmware forgets a reset for half a second after an alarm; a driver that sends it once would fail here."""
    stage.home()
    with (
        once_it_moves(board, lambda: board.wire("press", "X")),
        pytest.raises(MoveFailed, match=r"\(ALARM:1\)"),
    ):
        stage.move_to({"pan": -15.0})
    sent = heard.sent_after(b"ALARM:1\r\n")
    assert sent in ([CANCEL_JOG], [STATUS, CANCEL_JOG]), "a mute board is not asked again and again"
    assert "ALARM:1" in stage.faults()[0]
    board.wire("release", "X")
    stage.home()
    stage.move_to({"pan": 3.0, "tilt": 1.0})
    assert board.angles_below()[:2] == pytest.approx([-13.0, -10.0], abs=0.02)


# ------------------------------------------------------------ our simulated board and the firmware
class SimulatedBoard:
    """The simulated board on a virtual clock, set up as the other one."""

    def __init__(self) -> None:
        self.now_s = 0.0
        limits = {"X": (15.0, 2.4), "Y": (10.0, -1.7), "Z": (10.0, 0.0)}
        models = {
            letter: AxisModel(
                Mechanics(
                    STEPS_PER_DEG, -high - 2, high + 2, home_deg=high, start_deg=start, stall_detection=False
                ),
                limit_deg=high + 0.5,
            )
            for letter, (high, start) in limits.items()
        }
        self.device = GrblController(models, lambda: self.now_s)
        for number, value in SETTINGS.items():
            self.device.receive(f"${number}={value:g}\n".encode())
        self.device.restart(0.0)
        self.device.unsolicited()

    def say(self, data: bytes | str, quiet_s: float) -> str:
        answer = self.device.receive(data.encode("latin-1") if isinstance(data, str) else data)
        for _ in range(round(quiet_s / 0.02)):
            self.now_s += 0.02
            answer += self.device.unsolicited()
        return answer.decode()


PLAIN_S = 0.3
CONVERSATIONS = {
    "lists": "?|$$|$I|$X|?|$I=x7|$I|$N",
    "writing": (
        "$ i|$Z|$100|$100=-1|$100=q|$10=1X|$300=1|$999=1|$=5|$22=0|$$|$20=1|$22=1|$110=2400.5|"
        "$J|$J=|$X1|$SLPX|$I1|$N0|$Q"
    ),
    "locked": "G0X-1|$J=X-1F100|$C|\x85|?|\x18 @0.3|?|$N0=",
    "lines": (
        f"$X||  |(c)|; c|G0 X-1(not closed|g90 G0 x -1 . 0|/G0X-2|{79 * 'X'}|{80 * 'X'}|G0 X|G0 XA|G|"
        "G99|N5 G0|G0 Q1|G90 G91|G0 G1 X1|5|G1.5 X1"
    ),
    "modes": "$X|G1X-2F600 @0.8|G91G1X-1F0|G91|G0X-1 @0.6|?|G90|$J=F600 @1.5|?",
    "soft limit": "$X|G0X5 @1|?|$X|\x18 @0.6|?|$X|?",
    "homing": "$H @5|?|$J=G53X-5Y-3F600 @1.2|?|$J=G53X1F600|$J=X-40F600",
    "check": "$X|$C|?|G0X-5|G0Q|?|$J=X-5F100|$H|$I|\x18 @0.3|?",
    "sleep": "$SLP @1|?|$I|\x18 @2|?",
    "reset in motion": "$X|G0X-20F600 @0.15|\x18 @1.2|$J=X-3F600",
    "reset in homing": "$H @5|$J=G53X-20F2400 @1.5|$H @0.2|\x18 @1.2",
    "busy": "$H @5|G1X-20F300 @0.05|$I|$$|$H|$N|$C|$SLP|$J=X-1F100",
}
"""What is said, one after the other; behind an ``@``, how long to listen, s."""


def comparable(answer: str) -> str:
    """Leave out what our board does not show, and the place where a motion was when it was stopped."""
    answer = re.sub(r"\|(WCO|Ov|Pn|Bf):[^|>]*", "", answer)
    return answer.replace("[MSG:Check Limits]\r\n", "")


@pytest.mark.parametrize("name", CONVERSATIONS)
def test_the_simulated_board_answers_as_the_firmware(board: NativeBoard, name: str):
    ours = SimulatedBoard()
    for exchange in CONVERSATIONS[name].split("|"):
        text, _, told_s = exchange.partition(" @")
        quiet_s = float(told_s or PLAIN_S)
        sent = text if text in {"?", "\x85", "\x18"} else f"{text}\n"
        assert comparable(ours.say(sent, quiet_s)) == comparable(board.say(sent, quiet_s)), text
