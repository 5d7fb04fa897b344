"""The page for contributors: its commands work, and every file that it names exists."""

import re
from pathlib import Path

import pytest
from running import python

ROOT = Path(__file__).parents[3]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\.venv/bin/pytest (.+)$", TEXT, re.MULTILINE)


@pytest.mark.parametrize("words", COMMANDS)
def test_each_command_finds_tests(words):
    python("-m", "pytest", "--collect-only", "-p", "no:cacheprovider", *words.split(), cwd=ROOT)


def test_there_are_commands_and_each_target_of_make_exists():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = {
        name for words in re.findall(r"\bmake ([a-z-]+(?: [a-z-]+)*)", TEXT) for name in words.split()[:1]
    }
    assert len(COMMANDS) >= 2
    assert {name for name in targets if f"\n{name}:" not in makefile} == set()


def test_every_place_that_is_named_exists():
    named = re.findall(r"`((?:bench|calib|drivers|sequences|simulators|tests)/[\w/.]+)`", TEXT)
    assert len(named) > 10
    assert [place for place in named if not (ROOT / place).exists()] == []
