"""How a run leaves its devices stands in the journal before the results are written, so that the report states it."""

import pytest
from rehearsed import TWO, Scene

from bench.base.device_ends import DEVICES, NOT_ASKED
from bench.records.events import Event
from bench.records.history import replay
from bench.records.journal import Journal, read_journal
from bench.report import run_tables
from drivers.errors import LightFault

END = "  - solve: {model: spherical, distortion: [k1]}\n  - report\n"


def journaled(scene):
    return [event for event, _ in scene.events()]


def left(scene):
    (told,) = scene.told(Event.DEVICES_LEFT)
    return {end["device"]: (end["state"], end["said"]) for end in told["devices"]}


def test_what_each_device_confirmed_stands_before_the_results(tmp_path):
    scene = Scene(tmp_path, poses=TWO, end=END)
    assert scene.run().how == "finished"
    ends = left(scene)
    assert list(ends) == list(DEVICES)
    assert {state for state, _ in ends.values()} == {"confirmed safe"}
    states = scene.states()
    assert states.index("parking") < states.index("solving")
    at = journaled(scene).index(Event.DEVICES_LEFT)
    entered = [data["state"] for event, data in scene.events()[:at] if event == Event.ENTERING]
    assert entered[-1] == "parking"


def test_a_light_that_does_not_confirm_may_be_on_in_the_report(tmp_path):
    scene = Scene(tmp_path, poses=TWO, end=END)

    def hook(name):
        if name == "light.off" and "stage.stop" in scene.calls:  # asked after the last step, not by one
            raise LightFault("the output reads on.", where="COM1", remedy="Switch it off by hand.")

    scene.hook = hook
    scene.run()
    assert left(scene)["light"][0] == "not confirmed"
    told = scene.told(Event.DEVICES_LEFT)[0]["devices"]
    rows = {device: (state, said) for device, state, said in run_tables.left(told)}
    assert rows["light"][0] == "not confirmed"
    assert rows["light"][1].endswith("The light may be on.")
    assert "the output reads on" in rows["light"][1]
    assert rows["stage"][0] == "confirmed safe"
    assert "may" not in rows["stage"][1]


def test_a_run_that_needs_no_further_step_states_it_at_its_end_only(tmp_path):
    scene = Scene(tmp_path, poses=TWO)
    assert scene.run().how == "finished"
    assert not scene.told(Event.DEVICES_LEFT)
    assert [end["state"] for end in scene.told(Event.RUN_ENDED)[0]["devices"]] == ["confirmed safe"] * 3


@pytest.mark.parametrize("ended", [True, False])
def test_a_resumed_run_without_devices_claims_only_what_was_seen(tmp_path, monkeypatch, ended):
    scene = Scene(tmp_path, poses=TWO, end=END)

    class Cut(BaseException):
        pass

    def gone(*_, **__):
        raise Cut

    def cut(self):
        if ended:
            raise LightFault("gone.", where="COM1", remedy="Look.")
        monkeypatch.setattr(Journal, "put", gone)  # a process that is gone writes no more
        gone()

    monkeypatch.setattr("bench.run.run_devices.RunDevices.leave", cut)
    if ended:
        assert scene.run().how == "failed"
    else:
        with pytest.raises(Cut):
            scene.run()
    monkeypatch.undo()
    opened = len(scene.opened)
    scene.run()
    assert len(scene.opened) == opened  # no device is opened for a calculation
    state, said = left(scene)["light"]
    assert state == ("confirmed safe" if ended else "not confirmed")
    assert (said == NOT_ASKED) is not ended
    history = replay(read_journal(scene.folder / "journal.jsonl")[0])
    assert [end["device"] for end in history.devices_left] == list(DEVICES)
