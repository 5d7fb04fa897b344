"""The commands that the extras bring: calls in the documents, and messages about invalid arguments."""

import re
from pathlib import Path

import pytest
from command_words import CORE, NOBODY, check_help, check_words, commands, examples

from bench.commands.cli import cli

ROOT = Path(__file__).parents[2]
BROUGHT = dict(commands(name for name in cli.list_commands(NOBODY) if name not in CORE))
COMMANDS = {**dict(commands(CORE)), **BROUGHT}


@pytest.mark.parametrize("words", sorted(BROUGHT))
def test_help_of_a_command_has_a_purpose_an_example_and_its_statuses(say, words):
    status, text, _ = say(*words.split(), "--help")
    assert status == 0
    check_help(words, BROUGHT[words], text)


@pytest.mark.parametrize("line", examples(BROUGHT))
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
                words.removeprefix("starbench ") not in COMMANDS and "COMMAND" not in words
            ):  # a command's bare name is no call
                yield pytest.param(words, id=f"{path.name}: {words}")


@pytest.mark.parametrize("line", list(shown_in_documents()))
def test_a_call_in_the_documents_uses_existing_arguments_and_options(line):
    check_words(line)  # what a document leaves out, as PATH or --station, stands before it in the text


@pytest.mark.parametrize("number", ["nan", "inf", "-1", "much"])
@pytest.mark.parametrize(
    "words",
    [("undistort", ".", "-o", "new.json", "--keep"), ("align", "-s", "simulated", "--port")],
    ids=lambda words: " ".join((words[0], words[-1])),
)
def test_an_impossible_number_is_an_invalid_argument(say, tmp_path, words, number):
    status, out, message = say(*words, number)
    assert (status, out) == (2, "")
    assert words[-1] in message
    assert not (tmp_path / "new.json").exists()


def test_a_conversion_needs_a_source_and_a_free_output(say, tmp_path):
    assert "only a.raw" in say("convert", "a.raw")[2]
    (tmp_path / "source").write_text("")
    (tmp_path / "taken.npz").write_text("as it was")
    assert "no folder missing" in say("convert", "source", "missing/new.npz")[2]
    assert "already" in say("convert", "source", "taken.npz")[2]
    assert (tmp_path / "taken.npz").read_text() == "as it was"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("convert q.yaml new.npz", "This is a queue"),
        ("undistort q.yaml -o new.npz", "This is a queue"),
        ("convert nowhere new.npz", "nowhere: "),
        ("undistort nowhere -o new.npz", "nowhere: "),
        ("align bench.yaml", "Name it with --station."),
        ("certificate new bench.yaml", "exists"),
    ],
)
def test_a_file_in_the_wrong_place_is_refused_with_what_it_is(say, tmp_path, words, message):
    (tmp_path / "q.yaml").write_text("format: starbench/queue/1\nname: N\n")
    (tmp_path / "bench.yaml").write_text("format: starbench/station/1\n")
    status, _, error = say(*words.split())
    assert status == 2
    assert message in error


def test_a_new_file_of_the_laboratory_is_one_to_fill_in(say):
    assert say("certificate", "new", "lab.yaml")[1].startswith("Written: lab.yaml.")
    assert "REPLACE" in Path("lab.yaml").read_text()
