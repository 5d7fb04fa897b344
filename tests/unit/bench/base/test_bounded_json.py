"""JSON of others: bounded depth, bounded number of values; and nobody in the bench parses it otherwise."""

import re
from pathlib import Path

import pytest

import bench
from bench.base import bounded_json
from bench.base.bounded_json import MOST_LEVELS, parse_json
from bench.base.errors import StorageError
from bench.record.storage import MOST_BYTES, read_bounded, read_json

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


def nested(levels, begin="[", end="]"):
    return begin * levels + end * levels


@pytest.mark.parametrize("kind", [str, str.encode])
def test_what_has_a_usual_depth_is_read(kind):
    assert parse_json(kind('{"a": [1, {"b": null}]}')) == {"a": [1, {"b": None}]}
    assert parse_json(kind("7")) == 7
    assert parse_json(kind(nested(MOST_LEVELS)))


@pytest.mark.parametrize("levels", [MOST_LEVELS + 1, 1_000_000])
@pytest.mark.parametrize(("begin", "end"), [("[", "]"), ('{"a":[', "]}")])
def test_what_is_nested_too_deeply_is_refused_with_a_sentence(levels, begin, end):
    with pytest.raises(ValueError, match="more than 100 levels"):
        parse_json(nested(levels, begin, end))


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


def test_a_large_file_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "results.json"
    with path.open("wb") as file:
        file.truncate(10 << 30)
    with pytest.raises(StorageError, match=f"{MOST_BYTES} bytes"):
        read_json(path)
    path.write_bytes(b"[1]")
    assert read_json(path) == [1]
    assert read_bounded(path, 3) == b"[1]"
    with pytest.raises(StorageError, match="more than 2 bytes"):
        read_bounded(path, 2)


def test_nobody_in_the_bench_parses_json_without_bounds():
    root = Path(bench.__file__).parent
    files = {
        path.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if re.search(r"json\.loads?\(|model_validate_json\(", path.read_text(encoding="utf-8"))
    }
    assert files <= OWN_DATA, f"use parse_json or read_json: {sorted(files - OWN_DATA)}"
