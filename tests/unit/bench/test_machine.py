"""The state machine: each edge, each missing edge, and what an exception leaves behind."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from transitions import MachineError

from bench.run.machine import EDGES, END_STATES, STATES, RunMachine

TRIGGERS = sorted({trigger for trigger, _, _ in EDGES})
TARGETS = {(source, trigger): target for trigger, sources, target in EDGES for source in sources}


def machine_in(state, work=None, told=None):
    machine = RunMachine(
        work or {}, lambda event, facts: told.append((event, facts)) if told is not None else None
    )
    machine._machine.set_state(state)
    return machine


@pytest.mark.parametrize(("source", "trigger"), sorted(TARGETS))
def test_each_edge_leads_where_the_table_says_and_runs_the_work_of_that_state(source, trigger):
    did = []
    target = TARGETS[source, trigger]
    machine = machine_in(source, {target: lambda **facts: did.append(facts)})
    machine.fire(trigger, step=7)
    assert machine.state == target
    assert did == [{"step": 7}]


@pytest.mark.parametrize(("source", "trigger"), sorted(set(product(STATES, TRIGGERS)) - set(TARGETS)))
def test_no_other_edge_exists(source, trigger):
    told = []
    machine = machine_in(source, told=told)
    assert not machine.can(trigger)
    with pytest.raises(MachineError):
        machine.fire(trigger)
    assert machine.state == source
    assert told == []


def test_every_state_that_is_no_end_can_be_aborted_and_ends_lead_nowhere():
    for state in STATES:
        leaves = [trigger for trigger in TRIGGERS if (state, trigger) in TARGETS]
        if state in END_STATES:
            assert leaves == []
        elif state != "aborting":
            assert "abort" in leaves


def test_no_state_can_be_jumped_to():
    machine = machine_in("idle")
    assert not hasattr(machine, "to_recording")


def test_intent_is_told_before_the_work_and_the_outcome_after_it_even_when_it_fails():
    told = []

    def fail(**_):
        told.append("work")
        raise OSError("lamp on fire")

    machine = machine_in("homing", {"lighting": fail}, told)
    with pytest.raises(OSError, match="lamp on fire"):
        machine.fire("set_light", step=3)
    assert told == [
        ("entering", {"state": "lighting", "from": "homing", "step": 3}),
        "work",
        ("left_off", {"state": "lighting", "error": "OSError: lamp on fire"}),
    ]
    assert machine.state == "lighting"


def test_a_state_whose_intent_cannot_be_told_is_not_entered():
    did = []

    def full(event, facts):
        raise OSError("disk full")

    machine = RunMachine({"preflight": lambda **_: did.append(1)}, full)
    with pytest.raises(OSError, match="disk full"):
        machine.fire("preflight")
    assert machine.state == "idle"
    assert did == []


def test_an_outcome_that_cannot_be_told_is_an_error():
    def full(event, facts):
        if event == "left_off":
            raise OSError("disk full")

    machine = RunMachine({}, full)
    with pytest.raises(OSError, match="disk full"):
        machine.fire("preflight")
    assert machine.state == "preflight"


def test_work_for_an_unknown_state_is_refused():
    with pytest.raises(ValueError, match="dancing"):
        RunMachine({"dancing": lambda **_: None}, lambda *_: None)


@given(st.lists(st.sampled_from(TRIGGERS), max_size=60))
def test_any_order_of_triggers_keeps_the_machine_on_its_edges(triggers):
    machine = machine_in("idle")
    for trigger in triggers:
        expected = TARGETS.get((machine.state, trigger))
        if expected is None:
            with pytest.raises(MachineError):
                machine.fire(trigger)
        else:
            machine.fire(trigger)
            assert machine.state == expected
