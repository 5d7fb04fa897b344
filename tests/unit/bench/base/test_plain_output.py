"""Names of folders and people reach the terminal as text: they never steer it."""

import json

import pytest
from journals import MadeRun
from running import starbench

HOSTILE = "run\x1b[2J\x9b31m\u202etxt"
"""Clears the screen, colours what follows (in seven and eight bits), and turns the reading direction."""


@pytest.fixture
def folder(tmp_path):
    made = MadeRun(tmp_path / "runs" / HOSTILE).begin()
    made.record(1)
    return made.folder


@pytest.mark.parametrize("words", [["runs"], ["status"], ["status", "--json"]])
def test_a_hostile_name_of_a_folder_is_printed_as_text(folder, tmp_path, words):
    place = folder.parent if words == ["runs"] else folder
    ended = starbench(*words, place, home=tmp_path)
    text = ended.stdout + ended.stderr
    assert not {"\x1b", "\x9b", "\u202e"} & set(text)
    if "--json" in words:
        assert HOSTILE in json.loads(ended.stdout)["folder"]
    else:
        assert r"\x9b31m\u202etxt" in text  # of a pipe, click takes the first part away
