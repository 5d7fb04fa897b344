"""Messages end with one full stop: those that the sources spell out, those that quote others, and joined ones."""

import ast
import re
from pathlib import Path

import pytest

from bench.base.errors import BenchError
from bench.commands.output import failure_of
from bench.run.interlocks import loss_text
from calib.errors import CalibrationError
from drivers.errors import DriverError, RecordingCorrupt
from sequences.errors import SequencesError
from simulators.errors import SimulatorError

ROOT = Path(__file__).parents[2]
PACKAGES = ("bench", "calib", "drivers", "sequences", "simulators")
ANYTHING = "\0"
"""Stands for what an f-string inserts."""
COMMAND_OR_FORM = re.compile(r"(?:: | as in: )\S.*$")
"""A remedy may end with a command or an example to copy: a full stop would become a part of it."""
NO_SENTENCE = {"the package for time stamps is not installed"}
"""Causes that the caller makes a sentence of."""


def spelled(node):
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(
            str(part.value) if isinstance(part, ast.Constant) else ANYTHING for part in node.values
        )
    return None


def errors_of(path):
    """Return what is wrong, remedy and line of each call that states both."""
    source = path.read_text()
    if "remedy=" not in source:
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            remedies = [spelled(keyword.value) for keyword in node.keywords if keyword.arg == "remedy"]
            if remedies and node.args:
                yield spelled(node.args[0]), remedies[0], node.lineno


@pytest.fixture(scope="module")
def messages():
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    return [
        (f"{path.relative_to(ROOT)}:{line}", what, remedy)
        for path in files
        for what, remedy, line in errors_of(path)
    ]


def ended(text):
    return text is None or text == "" or text.endswith((".", "?", "!", ANYTHING))


def test_each_message_in_the_sources_is_a_sentence(messages):
    assert len(messages) > 500
    assert [message for message in messages if not ended(message[1]) and message[1] not in NO_SENTENCE] == []
    assert [
        message for message in messages if not ended(message[2]) and not COMMAND_OR_FORM.search(message[2])
    ] == []


def test_no_message_in_the_sources_has_two_full_stops(messages):
    twice = re.compile(r"(?<!\.)\.\.(?![./\w])")
    assert [message for message in messages if any(text and twice.search(text) for text in message[1:])] == []


MOST_WORDS = 32
"""In one sentence of a message: a reader at the bench keeps about 20 to 25 words, and lists are longer."""
UNPLAIN = re.compile(
    r"\b(in order to|respectively|hence|thus|whilst|utili[sz]e|aforementioned|prior to|thereof|whereby|wherein|and/or"
    r"|it should be noted|asked none|counts little|has another form|is not known whether|on the head|no longer to)\b",
    re.IGNORECASE,
)
"""Words of papers and contracts, and phrases that a second reading was needed for."""


def sentences_of(text):
    """The sentences of a text, without what stands in quotes or after a colon to be copied."""
    plain = re.sub(r"`[^`]*`|'[^']*'|\n +\S.*", "X", text)
    return re.split(r"(?<=[.!?;:])\s+", plain)


def test_no_sentence_of_a_message_needs_a_second_reading(messages):
    long = [
        (where, sentence)
        for where, *texts in messages
        for text in texts
        for sentence in sentences_of(text or "")
        if len(sentence.split()) > MOST_WORDS
    ]
    assert long == []
    unplain = [(where, text) for where, *texts in messages for text in texts if text and UNPLAIN.search(text)]
    assert unplain == []


@pytest.fixture(scope="module")
def spoken():
    """Every text of more than some words that the sources print or show, by its place."""
    texts = []
    for path in [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]:
        tree = ast.parse(path.read_text())
        parts = {
            id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values
        }
        parts |= {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # docstrings
        for node in ast.walk(tree):
            text = spelled(node) if id(node) not in parts else None
            if text and len(text.split()) > 6:
                texts.append((f"{path.relative_to(ROOT)}:{node.lineno}", text))
    return texts


def test_no_text_of_the_sources_has_a_word_of_papers_and_contracts(spoken):
    assert len(spoken) > 2000
    assert [(where, UNPLAIN.search(text)[0]) for where, text in spoken if UNPLAIN.search(text)] == []


@pytest.mark.parametrize("kind", [BenchError, CalibrationError, DriverError, SequencesError, SimulatorError])
def test_an_error_that_quotes_a_sentence_has_one_full_stop(kind):
    error = kind("It cannot be read: The file is bad..", where="a.raw", remedy="Copy it again.")
    assert str(error) == "a.raw: It cannot be read: The file is bad. Copy it again."
    assert error.what.endswith("bad.")
    assert kind("And so on...").what == "And so on..."


def test_a_lost_device_in_a_sentence_has_one_full_stop():
    for remedy in ("", "Plug it in.", "Plug it in, then resume the run."):
        text = f"Held by the device lost interlock: {loss_text(DriverError('It is gone.', remedy=remedy))}."
        assert text.endswith(".")
        assert ".." not in text


def test_the_place_of_bad_bytes_stands_within_the_sentence():
    assert str(RecordingCorrupt("The word is bad.", offset=7, remedy="Copy it.")) == (
        "The word is bad (byte 7). Copy it."
    )


def test_what_other_programs_say_is_quoted_without_its_full_stop():
    assert failure_of(OSError("No disk.")).what == "No disk."
    assert failure_of(ZeroDivisionError("division by zero.")).what.endswith("division by zero.")
