"""An operator at another terminal: hold and go on, abort, take over."""

import json

import pytest
from quick_runs import THREE_NAMED, quick_words
from running import (
    PATIENCE_S,
    called,
    entering,
    journal,
    killed_at_end,
    light_outputs,
    numbers,
    results,
    start,
    wait_for,
)

from bench.run.control import Command, send


@pytest.fixture
def process(home, tmp_path):
    """A run under way, which a test commands; it stands still long enough before each recording to be met there."""
    words, sequence = quick_words(tmp_path, THREE_NAMED), tmp_path / "sequence.yaml"
    sequence.write_text(sequence.read_text().replace("duration_s: 0.3", "duration_s: 1.5"))
    with killed_at_end(start(*words, home=home)) as process:
        yield process


def states(folder):
    return [line["state"] for line in journal(folder) if line["event"] == "entering"]


@pytest.mark.slow
def test_a_held_run_goes_on_where_it_was_and_ends_with_the_same_numbers(home, tmp_path, process):
    folder = tmp_path / "run"
    wait_for(process, folder, entering("settling"))
    assert send(folder, Command(word="hold", by="ada"))["taken"]
    wait_for(process, folder, entering("holding"))
    refused = called("tell", folder, "release", "--operator", "ben", home=home, status=1)
    assert "held by ada" in refused.stderr
    assert light_outputs(folder)[-1] is False
    status = json.loads(called("status", folder, "--json", home=home).stdout)
    assert (status["running"], status["state"], status["held_by"]) == (True, "holding", "ada")
    taken = called("tell", folder, "release", "--operator", "ben", "--take-over", "--json", home=home)
    assert json.loads(taken.stdout)["taken"]
    assert process.wait(PATIENCE_S) == 0
    held = states(folder).index("holding")
    assert states(folder)[held - 2 : held] == ["slewing", "settling"]
    assert states(folder)[held + 1 : held + 5] == ["lighting", "slewing", "settling", "recording"]
    assert any("Held by ada" in what for what in results(folder)["holds"])
    assert results(folder)["deviations"] == []
    assert not (folder / "control").exists()
    called(*quick_words(tmp_path / "undisturbed", THREE_NAMED), home=home)
    assert numbers(folder) == numbers(tmp_path / "undisturbed" / "run")
    called("verify", folder, home=home)


def test_a_question_is_answered_from_another_terminal_once(home, tmp_path):
    folder = tmp_path / "run"
    question = '  - prompt: {text: "Is the cap off?", default: abort, timeout_s: 200}\n'
    words = quick_words(tmp_path, "[{name: left, pan_deg: -6}]", first=question, end="")
    with killed_at_end(start(*words, home=home)) as process:
        wait_for(process, folder, lambda line: line["event"] == "asked")
        status = json.loads(called("status", folder, "--json", home=home).stdout)
        assert status["question"] == "Is the cap off?"
        assert "starbench tell" in status["advice"]
        ended = called("tell", folder, "yes", "--operator", "ada", home=home)
        assert ended.stdout == "Accepted: continue.\n"
        wait_for(process, folder, lambda line: line["event"] == "answered")
        answered = next(line for line in journal(folder) if line["event"] == "answered")
        assert (answered["answer"], answered["by"]) == ("continue", "ada")
        process.communicate(timeout=PATIENCE_S)
        assert [line["pose"] for line in journal(folder) if line["event"] == "capture_stored"] == [1]
