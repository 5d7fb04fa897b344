"""Commands that arrive at the last moment: an accepted command is done."""

from dataclasses import replace

import pytest
from rehearsed import Scene, with_runner

from bench.records.events import Event
from bench.terminal.prompt import Reply

PROMPT = '  - prompt: {text: "Cap off?", default: abort, timeout_s: 5}\n'


@pytest.fixture
def scene(tmp_path, monkeypatch):
    return lambda **words: with_runner(Scene(tmp_path, **words), monkeypatch)


def commanded(scene, word, **more):
    scene.runner.context.log.write(Event.COMMANDED, id="x", word=word, by="ada", taken=True, why="", **more)


def test_an_answer_accepted_at_the_last_moment_counts(scene, monkeypatch):
    one = scene(end=PROMPT)

    def asked_in_vain(*_, **__):
        commanded(one, "answer", answer="continue")
        return Reply("abort", "time-out")

    monkeypatch.setattr("bench.run.states.ask", asked_in_vain)
    assert one.run().how == "finished"
    assert [(d["answer"], d["by"]) for d in one.told(Event.ANSWERED)] == [("continue", "ada")]


def test_a_pose_skipped_during_its_last_attempt_is_skipped_and_does_not_end_the_run(scene):
    one = scene(attempts=1)

    def hook(name):
        if name == "camera.record" and one.calls.count("camera.record") == 1:
            commanded(one, "skip", pose=1)
            return lambda facts: replace(facts, complete=False)
        return None

    one.hook = hook
    assert one.run().how == "finished"
    assert [d["pose"] for d in one.told(Event.POSE_SKIPPED)] == [1]
