"""The commands that the extras bring: help, examples, calls in the documents, and messages about invalid arguments."""

import re
from pathlib import Path

import pytest
from calling import ended, out_of, refusal
from command_words import NOBODY, check_help, check_words, commands, examples

from bench.commands.cli import SECTIONS, cli

ROOT = Path(__file__).parents[2]
OF_CORE = {name for section in SECTIONS.values() for name in section}
ALL = dict(commands(cli.list_commands(NOBODY)))
OF_EXTRAS = {words: command for words, command in ALL.items() if words.split()[0] not in OF_CORE}


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def say(capsys):
    def called(*words):
        status, captured = ended(capsys, *words)
        return status, captured.out, captured.err

    return called


@pytest.mark.parametrize("words", sorted(OF_EXTRAS))
def test_help_of_a_command_has_a_purpose_an_example_and_its_statuses(say, words):
    status, text, _ = say(*words.split(), "--help")
    assert status == 0
    check_help(words, OF_EXTRAS[words], text)


@pytest.mark.parametrize("line", examples(OF_EXTRAS))
def test_an_example_uses_existing_arguments_and_options(line):
    assert check_words(line) == []


def shown_in_documents():
    """Every call of the program that a document shows."""
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))):
        text = path.read_text(encoding="utf-8")
        calls = re.findall(r"`(starbench [^`]+)`", text) + re.findall(r"^(starbench .*)$", text, re.MULTILINE)
        for call in calls:
            words = call.partition(" #")[0].strip()
            if (
                words.removeprefix("starbench ") not in ALL and "COMMAND" not in words
            ):  # a command's bare name is no call
                yield pytest.param(words, id=f"{path.name}: {words}")


@pytest.mark.parametrize("line", list(shown_in_documents()))
def test_a_call_in_the_documents_uses_existing_arguments_and_options(line):
    check_words(line)  # what a document leaves out, as PATH or --station, stands before it in the text


@pytest.mark.parametrize("number", ["nan", "inf", "-1", "much"])
@pytest.mark.parametrize(
    "words",
    [
        ("undistort", ".", "-o", "new.json", "--keep"),
        ("align", "-s", "simulated", "--port"),
    ],
    ids=lambda words: " ".join((words[0], words[-1])),
)
def test_an_impossible_number_is_an_invalid_argument(say, tmp_path, words, number):
    status, out, message = say(*words, number)
    assert (status, out) == (2, "")
    assert words[-1] in message
    assert not (tmp_path / "new.json").exists()


@pytest.mark.parametrize(
    "words", [("convert", "{file}", "new.npz"), ("undistort", "{file}", "-o", "new.npz")]
)
def test_a_queue_in_the_place_of_data_is_refused_with_what_it_is(say, tmp_path, words):
    (tmp_path / "q.yaml").write_text("format: starbench/queue/1\nname: N\n")
    assert "This is a queue; it holds no data." in say(*[word.format(file="q.yaml") for word in words])[2]
    status, _, message = say(*[word.format(file="nowhere") for word in words])
    assert status == 2
    assert "nowhere: " in message


def test_a_conversion_needs_a_source_and_a_free_output(say, tmp_path):
    assert "SOURCE and OUTPUT; only a.raw is given" in say("convert", "a.raw")[2]
    (tmp_path / "source").write_text("")
    (tmp_path / "taken.npz").write_text("as it was")
    assert "There is no folder missing" in say("convert", "source", "missing/new.npz")[2]
    assert "already" in say("convert", "source", "taken.npz")[2]
    assert (tmp_path / "taken.npz").read_text() == "as it was"


def test_a_station_file_without_its_option_is_refused_with_the_option(say, tmp_path):
    (tmp_path / "bench.yaml").write_text("format: starbench/station/1\n")
    assert say("align", "bench.yaml")[2].endswith("bench.yaml is a station file. Name it with --station.\n")


def test_the_same_verb_takes_the_same_arguments(capsys, tmp_path):
    output = out_of(capsys, "certificate", "new", tmp_path / "lab.yaml")
    assert output.startswith(f"Written: {tmp_path / 'lab.yaml'}.")
    assert "REPLACE" in (tmp_path / "lab.yaml").read_text()
    assert "exists" in refusal(capsys, "certificate", "new", tmp_path / "lab.yaml", status=2)
