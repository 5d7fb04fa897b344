"""The state machine: each edge, each missing edge, and what an exception leaves behind."""

from itertools import product
from types import SimpleNamespace

import pytest
from transitions import MachineError

from bench.run.machine import EDGES, STATES, RunMachine

TRIGGERS = sorted({trigger for trigger, _, _ in EDGES})
TARGETS = {(source, trigger): target for trigger, sources, target in EDGES for source in sources}


class Told:
    """Keeps what it is told, in a list of (event, data); a subclass may refuse it."""

    def __init__(self, events=None):
        self.events = [] if events is None else events

    def entering(self, data):
        self.events.append(("entering", data))

    def left_off(self, data):
        self.events.append(("left_off", data))


def machine_in(state, work=None, events=None):
    told = Told(events)
    machine = RunMachine(work or {}, told.entering, told.left_off)
    machine.state = state
    return machine


@pytest.mark.parametrize(("source", "trigger"), sorted(TARGETS))
def test_each_edge_leads_where_the_table_says_and_runs_the_work_of_that_state(source, trigger):
    did = []
    target = TARGETS[source, trigger]
    machine = machine_in(source, {target: lambda *given, **facts: did.append((given, facts))})
    step, cause = SimpleNamespace(number=7), object()
    machine.fire(trigger, step, cause, pose=2)
    assert machine.state == target
    assert did == [((step, cause), {"pose": 2})]


@pytest.mark.parametrize(("source", "trigger"), sorted(set(product(STATES, TRIGGERS)) - set(TARGETS)))
def test_no_other_edge_exists(source, trigger):
    events = []
    machine = machine_in(source, events=events)
    assert not machine.can(trigger)
    with pytest.raises(MachineError):
        machine.fire(trigger)
    assert machine.state == source
    assert events == []


def test_intent_is_reported_before_the_work_and_the_outcome_after_it_even_if_it_fails():
    events = []

    def fail(*_, **__):
        events.append("work")
        raise OSError("lamp on fire")

    machine = machine_in("homing", {"lighting": fail}, events)
    with pytest.raises(OSError, match="lamp on fire"):
        machine.fire("set_light", SimpleNamespace(number=3))
    assert events == [
        ("entering", {"state": "lighting", "from": "homing", "step": 3}),
        "work",
        ("left_off", {"state": "lighting", "error": "OSError: lamp on fire"}),
    ]
    assert machine.state == "lighting"


@pytest.mark.parametrize(
    ("refused", "state", "worked"), [("entering", "idle", []), ("left_off", "preflight", [1])]
)
def test_a_line_that_cannot_be_journaled_is_an_error_and_a_state_without_its_intent_is_not_entered(
    monkeypatch, refused, state, worked
):
    def full(_told, _data):
        raise OSError("disk full")

    monkeypatch.setattr(Told, refused, full)
    did = []
    machine = machine_in("idle", {"preflight": lambda *_: did.append(1)})
    with pytest.raises(OSError, match="disk full"):
        machine.fire("preflight")
    assert (machine.state, did) == (state, worked)
