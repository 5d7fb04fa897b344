"""Values set otherwise than a file says: put where they belong, checked as the file is, refused where there is no place."""

import pytest

from sequences.errors import DocumentFaults
from sequences.reader import with_settings
from sequences.yaml_text import parse


def read(data):
    tree = parse(data, "x.yaml")
    assert not tree.faults
    return tree.value


def test_nothing_set_leaves_every_byte():
    data = b"# a comment\na: 1\n"
    assert with_settings(data, "x.yaml", {}) is data


@pytest.mark.parametrize(
    ("path", "text", "expected"),
    [
        ("a", "2", {"a": "2", "list": [{"b": "0123"}]}),
        ("list.0.b", "no", {"a": "1", "list": [{"b": "no"}]}),
        ("new.deep.er", "[x, y]", {"a": "1", "list": [{"b": "0123"}], "new": {"deep": {"er": ["x", "y"]}}}),
        ("a", "{k: v}", {"a": {"k": "v"}, "list": [{"b": "0123"}]}),
    ],
)
def test_a_value_is_put_in_its_place_and_all_else_stays(path, text, expected):
    assert read(with_settings(b"a: 1\nlist: [{b: 0123}]\n", "x.yaml", {path: text})) == expected


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("a.b", "1"),
        ("list.7", "1"),
        ("list.x", "1"),
        ("a", "[1"),
        ("a", "&x 1"),
        ("a", "1\nb: 2"),
        ("list.0.b.c", "1"),
    ],
)
def test_what_has_no_place_or_is_no_value_is_a_fault_and_no_traceback(path, text):
    with pytest.raises(DocumentFaults):
        with_settings(b"a: 1\nlist: [{b: 2}]\n", "x.yaml", {path: text})
