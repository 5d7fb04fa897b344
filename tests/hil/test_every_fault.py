"""Every fault that can be ordered of an axis or its line, on every family: a typed error in time, or the truth."""

import pytest

from drivers.errors import DriverError, MoveFailed, NotHomed, PortLost, ReplyError, WrongDevice
from simulators.faults.catalogue import AXIS_FAULTS, LINE_FAULTS
from simulators.faults.line_faults import REPLY_FAULTS, REQUEST_FAULTS
from tests.hil.direct_stages import FAMILIES, DirectStage, rig_of

pytestmark = pytest.mark.usefixtures("never_late")

LONGEST_S = 20.0
"""Of the bench's own time, from the order to its end: the move itself takes 1.2 s."""

WITHOUT_ENCODER = {"grbl", "flir", "k10cr1"}
UNSEEN_WITHOUT_ENCODER = {"stall", "slip"}
"""Of a move; a controller that counts the steps it sends knows no better. The stars do: see the runs' tests."""

FAILS = {
    "stall": MoveFailed,
    "limit": MoveFailed,
    "twist": MoveFailed,
    "restart": (MoveFailed, ReplyError),
    "stop_short": MoveFailed,
    "no_progress": MoveFailed,
    "slip": MoveFailed,
    "unplug": PortLost,
    "press_stop": (MoveFailed, ReplyError),
    "stuck_busy": MoveFailed,
    "reboot": (NotHomed, MoveFailed, ReplyError),
    "exchange": (NotHomed, MoveFailed, ReplyError),
    "emergency_stop": (NotHomed, MoveFailed, ReplyError),
}
"""What a move ends in, when this befalls its axis."""

HARMLESS = {"idle_flicker", "release", "mend"}
"""Or may become harmless: a move goes on through these, and ends in the truth."""

AFTERWARDS = {"creep", "push"}
"""Happen to an axis that has arrived."""

MESSAGES = {*REPLY_FAULTS, *REQUEST_FAULTS, "stale", "any"}


@pytest.fixture(params=FAMILIES)
def rig(request) -> DirectStage:
    rig = rig_of(request.param)
    rig.stage.home()
    rig.stage.move_to({"pan": 10.0})
    return rig


def move(rig: DirectStage, target_deg: float = -10.0) -> DriverError | None:
    """Move; return the error it ends in, if any, which must come in time."""
    return rig.line.error_of(lambda: rig.stage.move_to({"pan": target_deg}), LONGEST_S)


def assert_true_or_error(rig: DirectStage) -> None:
    """Ask for the position: it must be where the axis is, or an error in time."""
    readings: list[float] = []
    if rig.line.error_of(lambda: readings.append(rig.stage.position_deg()["pan"]), LONGEST_S) is None:
        assert readings == [pytest.approx(rig.true_deg(), abs=0.01)]


def move_to_the_truth_or_an_error(rig: DirectStage) -> DriverError | None:
    error = move(rig)
    assert error is not None or rig.true_deg() == pytest.approx(-10.0, abs=0.01)
    assert_true_or_error(rig)
    return error


def test_every_fault_of_the_catalogue_is_spoken_of_here() -> None:
    assert set(AXIS_FAULTS) == {*FAILS, *HARMLESS, *AFTERWARDS}
    assert set(LINE_FAULTS) == {*MESSAGES, "baud", "say", "unplug", "replug", "mend"}


@pytest.mark.parametrize("fault", FAILS)
def test_a_fault_of_an_axis_ends_the_move_in_its_error_and_undoes_the_reference(rig, fault) -> None:
    rig.order(f"pan {fault}")
    error = move(rig)
    if rig.family in WITHOUT_ENCODER and fault in UNSEEN_WITHOUT_ENCODER:
        assert error is None
        return
    assert isinstance(error, FAILS[fault])
    if fault in {"stall", "stop_short", "slip", "stuck_busy"}:
        assert error.where == "pan"
    if fault == "slip" and rig.stage.encoder_deg():
        assert error.what.startswith("slipped: the counter reads")
    if fault != "unplug":
        assert move(rig, 1.0) is not None


@pytest.mark.parametrize("fault", sorted(HARMLESS))
def test_what_is_harmless_lets_the_move_arrive(rig, fault) -> None:
    rig.order(f"pan {fault}")
    error = move(rig)
    if (rig.family, fault) == ("grbl", "release"):  # its stop button holds the board in reset
        assert isinstance(error, NotHomed)
        return
    assert error is None
    assert rig.true_deg() == pytest.approx(-10.0, abs=0.01)


@pytest.mark.parametrize("fault", ["creep creep_deg_s=0.1", "push deg=0.3"])
def test_what_moves_an_axis_that_has_arrived_shows_in_its_readings(rig, fault) -> None:
    rig.order(f"pan {fault}")
    arrived_deg = 10.0
    if fault.startswith("creep"):
        arrived_deg = -10.0
        assert isinstance(move(rig), MoveFailed | None)  # an encoder may show it at once
    rig.line.clock.sleep(3.0)
    read_deg = {**rig.stage.position_deg(), **rig.stage.encoder_deg()}["pan"]
    if rig.family not in WITHOUT_ENCODER:
        assert read_deg == pytest.approx(rig.true_deg(), abs=0.2)
        assert abs(read_deg - arrived_deg) > 0.05
    else:  # a counter of steps shows where it was driven to
        assert read_deg == pytest.approx(arrived_deg, abs=0.01)


@pytest.mark.parametrize("skip", [0, 3, 7])
@pytest.mark.parametrize("fault", sorted(MESSAGES))
def test_one_spoilt_message_of_a_move_never_passes_for_another(rig, fault, skip) -> None:
    rig.order(f"gimbal {fault} skip={skip} delay_s=1.2 pattern=1 replacement=7")
    move_to_the_truth_or_an_error(rig)


@pytest.mark.parametrize("fault", sorted(MESSAGES - {"any", "echo", "doubled", "nul", "preceded"}))
def test_a_line_that_is_bad_for_ever_is_an_error_or_the_truth(rig, fault) -> None:
    rig.order(f"gimbal {fault} count=0 delay_s=1.2 pattern=1 replacement=7")
    error = move_to_the_truth_or_an_error(rig)
    if fault in {"lost", "request_lost", "stranger"}:
        assert isinstance(error, ReplyError)


def test_after_a_move_that_ended_in_silence_the_axis_is_not_homed(rig, monkeypatch) -> None:
    """A stop that nobody confirmed has left it anywhere, and what answers later may have restarted."""
    clock, sleep = rig.line.clock, rig.line.clock.sleep

    def falls_silent(seconds: float) -> None:
        monkeypatch.undo()
        rig.order("gimbal lost count=0")
        sleep(seconds)

    monkeypatch.setattr(clock, "sleep", falls_silent)  # the driver sleeps once the move has begun
    assert isinstance(move(rig), ReplyError)
    rig.order("gimbal mend")
    assert not rig.stage.is_homed()
    assert isinstance(move(rig, 1.0), NotHomed)
    rig.stage.home()
    assert move(rig, 1.0) is None


def test_another_baud_rate_is_an_error_and_nothing_moves(rig) -> None:
    rig.order("gimbal baud rate=4800")
    assert isinstance(move(rig), ReplyError)
    assert rig.true_deg() == pytest.approx(10.0, abs=0.01)


@pytest.mark.parametrize(
    "text", ["!01 1 IDLE --:00", "ALARM:3", "-1.00000", "1", "ok", "@01 1 05 OK IDLE -- 0:00"]
)
def test_what_nobody_asked_for_is_no_answer(rig, text) -> None:
    rig.order(f"gimbal say text='{text}\\r\\n'")
    move_to_the_truth_or_an_error(rig)


def test_a_pulled_cable_is_lost_and_put_back_needs_the_port_opened_anew(rig) -> None:
    rig.order("gimbal unplug")
    assert isinstance(move(rig), PortLost)
    rig.order("gimbal replug")
    assert_true_or_error(rig)
    assert rig.true_deg() == pytest.approx(10.0, abs=0.01)


def test_another_controller_in_its_place_is_refused_before_anything_moves(rig) -> None:
    rig.order("pan exchange serial=777")
    rig.line.clock.sleep(5.0)
    stood = rig.true_deg()
    with pytest.raises(WrongDevice):
        rig.stage.home()
    rig.line.sent.clear()
    with pytest.raises(WrongDevice, match="777"):
        rig.reopen()
    assert rig.line.closed
    assert rig.true_deg() == stood
