"""A homing of a described stage is believed by evidence: controllers ignore the command in silence, and take moves then."""

import pytest

from drivers.errors import DeviceRefused, MoveFailed, NotHomed
from tests.hil.test_described_stages_of_users import changed, gsc02, opened, smc100
from tests.hil.text_wire import LINES, Motor, Wire, described

SCALE = 400.0
QUEUE = '  errors: {send: "?ERR", reply: "{state:integer}", when: [0]}\n'
TRUE_DEG = 1.94
"""Where the axis of `ps10` stands, while its counter is 0."""


def ps10(clock, *, state: str = "R", ignores: str = "") -> tuple[Wire, Motor]:
    """Connect an OWIS PS10 whose counter another program has set to 0 anywhere; ``ignores`` is a command."""
    wire, motor = Wire(clock, LINES), Motor(clock, TRUE_DEG)
    zero_deg = [TRUE_DEG]
    known = wire.known = {"ERR": "0", "state": state, "PVEL1": "1000", "PSET1": "0", "refused": "0"}

    def answer(request: str) -> str:
        name, _, value = request.partition("=")
        if known["state"] == "P" and not motor.is_busy:
            known["state"], zero_deg[0] = "R", 0.0
        if name == ignores or (known["state"] != "R" and name in {"REF1", "PGO1"}):
            known["ERR"] = known["refused"]
        elif name == "REF1":
            known["state"] = "P"
            motor.move(0.0)
        elif name == "PGO1":
            motor.move(float(known["PSET1"]) / SCALE + zero_deg[0])
        elif name == "INIT1":
            known["state"] = "R"
        elif name == "STOP1":
            motor.stop()
        elif value:
            known[name] = value
        if not name.startswith("?"):
            return ""
        error, known["ERR"] = known["ERR"], known["ERR"] if name != "?ERR" else "0"
        return {
            "?VERSION": "PS10-V1.1", "?SERNUM": "9080145", "?ERR": error,
            "?ASTAT": "T" if motor.is_busy and known["state"] == "R" else known["state"],
            "?CNT1": str(round((motor.position_deg - zero_deg[0]) * SCALE)), "?PVEL1": known["PVEL1"],
        }[name] + "\r"  # fmt: skip

    wire.answer = answer
    return wire, motor


def test_an_axis_that_was_not_initialised_is_by_a_bare_command_and_is_homed(clock) -> None:
    wire, motor = ps10(clock, state="I")
    stage = opened(wire, described("ps10"), ("1", SCALE))
    stage.home()
    stage.move_to({"pan": 5.0})
    assert motor.position_deg == pytest.approx(5.0)
    assert wire.sent.count("INIT1") == 1


def test_a_search_that_is_ignored_without_any_trace_is_no_homing(tmp_path, clock) -> None:
    wire, motor = ps10(clock, ignores="REF1")
    stage = opened(wire, changed(tmp_path, "ps10", QUEUE, ""), ("1", SCALE))
    with pytest.raises(MoveFailed, match="nothing shows"):
        stage.home()
    assert not stage.is_homed()
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 5.0})
    assert motor.position_deg == TRUE_DEG


def test_a_search_that_the_error_queue_refuses_is_told_and_old_errors_are_not_taken_for_it(clock) -> None:
    wire, _ = ps10(clock, ignores="REF1")
    wire.known |= {"ERR": "7", "refused": "40"}
    stage = opened(wire, described("ps10"), ("1", SCALE))
    with pytest.raises(DeviceRefused, match=r"'REF1=4': '\?ERR' .* '40'"):
        stage.home()
    assert not stage.is_homed()


@pytest.mark.parametrize(("make", "scale"), [(ps10, SCALE), (smc100, 1.0)])
def test_an_axis_at_its_reference_is_homed_without_any_motion(clock, make, scale) -> None:
    """By an empty error queue, and by a reference that comes."""
    wire, motor = make(clock)
    motor.move(0.0)
    clock.sleep(1.0)
    stage = opened(wire, described(make.__name__), ("1", scale))
    for _ in range(2):
        stage.home()
        assert stage.is_homed()


def test_a_reference_of_another_program_is_none(clock) -> None:
    """12.000 deg were true for 5: that program had set another zero."""
    wire, motor = smc100(clock)
    wire.known["state"] = "32"
    stage = opened(wire, described("smc100"), ("1", 1.0))
    assert not stage.is_homed()
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 5.0})
    stage.home()  # a reset brings it to the state in which it searches
    stage.move_to({"pan": 5.0})
    assert motor.position_deg == 5.0


def test_a_search_that_ends_beside_the_reference_is_no_homing(clock) -> None:
    wire, motors = gsc02(clock)
    answer = wire.answer

    def stopped_by_hand(request: str) -> str:
        replied = answer(request)
        if request.startswith("H:1"):
            motors["1"].move(1.0)
        return replied

    wire.answer = stopped_by_hand
    stage = opened(wire, described("gsc02"), ("1", SCALE), ("2", SCALE))
    with pytest.raises(MoveFailed, match=r"400 counts, .* 0"):
        stage.home()
    assert not stage.is_homed()
