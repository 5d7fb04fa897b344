"""JSON of others: bounded depth, bounded number of values; and nobody in the bench parses it otherwise."""

import re
from pathlib import Path

import pytest

import bench
from bench.base import bounded_json
from bench.base.bounded_json import MOST_LEVELS, parse_json

OWN_DATA = {
    "extras/pages/align/simulated_hands.py",  # answers of the simulated bench, a process of our own
    "base/bounded_json.py",
    "extras/certificate/amend.py",  # text that was written a line before
    "extras/certificate/pdf.py",
    "extras/certificate/commands/certificate.py",
    "record/inbox.py",  # bounded size; pydantic bounds the depth
    "record/run_index.py",  # text that the index wrote
    "again/compare.py",
    "solve/exports.py",
    "simulated.py",  # a process of our own
    "extras/pages/web/guard.py",  # bodies of at most 16 kB
    "extras/pages/web/pages.py",
}
"""Modules that parse JSON which no stranger wrote, or that bound it themselves."""


@pytest.mark.parametrize(("begin", "end"), [("[", "]"), ('{"a":', "}")])
def test_what_has_a_usual_depth_is_read_and_what_is_nested_too_deeply_is_refused(begin, end):
    for kind in (str, str.encode):
        assert parse_json(kind(f"{begin * MOST_LEVELS}7{end * MOST_LEVELS}"))
    for levels in (MOST_LEVELS + 1, 1_000_000):
        with pytest.raises(ValueError, match="more than 100 levels"):
            parse_json(f"{begin * levels}7{end * levels}")


def test_too_many_values_are_refused_before_they_take_memory(monkeypatch):
    monkeypatch.setattr(bounded_json, "MOST_VALUES", 1000)
    monkeypatch.setattr(bounded_json.json, "loads", lambda *_, **__: pytest.fail("it was parsed"))
    for text in ("[" + "{}," * 1000 + "{}]", b"[" + b"0," * 1001 + b"0]"):
        with pytest.raises(ValueError, match="more than 1000 values"):
            parse_json(text)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('{"a": 1, "a": 2}', "the key 'a' is there twice"),
        ('{"a": NaN}', "NaN is not a number"),
        ('\ufeff{"a": 1}', "byte-order mark"),
        ('{"a": 1} ', "blanks stand behind its end"),
    ],
)
def test_what_two_readers_could_read_differently_is_refused(text, what):
    for data in (text, text.encode()):
        with pytest.raises(ValueError, match=what):
            parse_json(data)


def test_nobody_in_the_bench_parses_json_without_bounds():
    root = Path(bench.__file__).parent
    files = {
        path.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if re.search(r"json\.loads?\(|model_validate_json\(", path.read_text(encoding="utf-8"))
    }
    assert files <= OWN_DATA, f"use parse_json or read_json: {sorted(files - OWN_DATA)}"
