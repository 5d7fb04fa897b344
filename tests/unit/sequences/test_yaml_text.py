"""The strict YAML text reader: what it keeps as text, what it refuses, and that it always answers."""

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from sequences.tree import Spot
from sequences.yaml_text import MOST_BYTES, MOST_DEPTH, MOST_NODES, parse


def faults(text: str | bytes) -> list[str]:
    data = text.encode() if isinstance(text, str) else text
    return [str(fault) for fault in parse(data, "f.yaml").faults]


@pytest.mark.parametrize(
    "scalar",
    ["00051234", "1:30", "no", "off", "yes", "1e-3", ".nan", "0x1F", "2026-01-31", "1_000", "<<", "="],
)
def test_scalars_that_yaml_would_turn_into_something_else_stay_text(scalar):
    assert parse(f"a: {scalar}\n".encode(), "f").value == {"a": scalar}


@pytest.mark.parametrize(
    ("written", "value"), [("", None), ("~", None), ("null", None), ("'null'", "null"), ('""', "")]
)
def test_only_plain_emptiness_means_nothing(written, value):
    assert parse(f"a: {written}\n".encode(), "f").value == {"a": value}


def test_keys_that_yaml_would_turn_into_truths_stay_text():
    assert parse(b"on: 1\nno: 2\n3: 4\n", "f").value == {"on": "1", "no": "2", "3": "4"}


def test_every_value_and_key_has_its_place():
    tree = parse(b"a:\n  - x\n  - {b: yy}\n", "f")
    assert tree.values[("a", 1, "b")] == Spot(3, 9)
    assert tree.keys[("a", 1, "b")] == Spot(3, 6)
    assert tree.spot(("a", 1, "missing", 3)) == tree.values[("a", 1)] == Spot(3, 5)


def test_a_byte_order_mark_and_windows_line_ends_are_no_fault():
    tree = parse(b"\xef\xbb\xbfa: 1\r\nb: 2\r\n", "f")
    assert tree.value == {"a": "1", "b": "2"}
    assert (tree.keys[("a",)], tree.values[("b",)]) == (Spot(1, 1), Spot(2, 4))


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("a: 1\nb: 2\na: 3\n", "f.yaml:3:1: a: duplicate key; the first one is in line 1."),
        ("a: &k 1\n", "f.yaml:1:4: an anchor (&k) is not allowed: write each value in full."),
        ("a: !!int 1\n", "f.yaml:1:4: a tag (tag:yaml.org,2002:int)"),
        ("%YAML 1.1\n---\na: 1\n", "f.yaml:1:1: a directive (%) is not allowed: remove it."),
        ("a: 1\n---\nb: 2\n", "f.yaml:2:1: a second document is not allowed: a file holds one document."),
        ("? [a]\n: 1\n", "f.yaml:1:3: a key must be plain text."),
        ("~: 1\n", "f.yaml:1:1: a key must not be empty."),
        ('a: "\\0"\n', "f.yaml:1:4: a: a control character is not allowed: remove it."),
        ('"\\x07": 1\n', "f.yaml:1:1: a control character is not allowed: remove it."),
        ("a: 1\n\tb: 2\n", "f.yaml:2:1: not valid YAML"),
        ("a:\n\t- 1\n", "Indent with spaces, not tabs."),
        ("a:\t1\n", "Write spaces, not tabs."),
        ("a: 1\t# one\nb: 2\n", "f.yaml:1:5: not valid YAML while scanning for the next token"),
        (
            "z: 0\na:1\nb: 2\n",
            "f.yaml:2:1: not valid YAML while scanning a simple key: could not find expected ':'. Write `key: value`",
        ),
        (
            "a: 1\nb:\u00a02\nc: 3\n",
            "f.yaml:2:1: not valid YAML while scanning a simple key: could not find expected ':'. The line has a no-break space (U+00A0)",
        ),
        ("a: Kowa: 16 mm\n", "put a text that holds a colon into quotes."),
        ("a: %LAB%\n", "Put the text into quotes."),
        ("a: 'open\n", "f.yaml:2:1: not valid YAML"),
        ('a: "\\UFFFFFFFF"\n', "f.yaml:1:"),
        ("%YAML 1." + "9" * 5000 + "\n---\na: 1\n", "f.yaml:1:"),
        (b"a: \xff\n", "f.yaml:1:4: not UTF-8 text (byte 0xff): save the file as UTF-8."),
        ("a: b\x00c\n", "f.yaml:1:5: a character that is not allowed in text (U+0000): remove it."),
        ("a: 1\n".encode("utf-16"), "f.yaml:1:1: not UTF-8 text"),
        (b"a" * (MOST_BYTES + 1), f"f.yaml: larger than {MOST_BYTES} bytes"),
        ("- 1\n" * (MOST_NODES + 1), f"f.yaml:{MOST_NODES}:3: more than {MOST_NODES} values"),
        ("[" * (MOST_DEPTH + 1), f"f.yaml:1:{MOST_DEPTH + 1}: "),
    ],
    ids=lambda case: repr(case)[:30],
)
def test_what_is_refused_is_refused_at_its_place(text, fault):
    assert any(fault in line for line in faults(text)), faults(text)


def test_an_alias_is_refused_and_expands_nothing():
    bomb = "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n"
    tree = parse(bomb.encode(), "f")
    assert sum("an alias" in str(fault) for fault in tree.faults) == 4
    assert tree.value["c"] == [None, None]


def test_all_faults_of_a_readable_document_come_at_once_and_the_rest_is_kept():
    tree = parse(b"a: 1\na: 2\nb: &x 3\nc: !!str 4\nd: 5\n", "f")
    assert len(tree.faults) == 3
    assert tree.complete
    assert tree.value == {"a": "1", "b": "3", "c": "4", "d": "5"}


def test_what_stands_under_a_refused_key_is_dropped_with_it():
    tree = parse(b"a: 1\na: {b: [2, {c: 3, c: 4}]}\nd: 4\n", "f")
    assert tree.value == {"a": "1", "d": "4"}
    assert set(tree.values) == {(), ("a",), ("d",)}
    assert set(tree.keys) == {("a",), ("d",)}


@pytest.mark.parametrize("opening", ["[", "- ", "{a: ", "? ", "[{"])
def test_nesting_without_end_is_refused_at_its_bound_not_at_the_end_of_the_file(opening):
    text = opening * (MOST_BYTES // len(opening))
    assert f"nested deeper than {MOST_DEPTH} levels" in faults(text)[-1]
    assert len(parse(text.encode(), "f").values) <= 2 * MOST_DEPTH


documents = st.recursive(
    st.none() | st.text(st.characters(codec="utf-8", exclude_categories=["C"]), max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.text(st.characters(codec="utf-8", exclude_categories=["C"]), max_size=5), inner, max_size=4
        )
    ),
    max_leaves=15,
)


@given(documents, st.booleans())
def test_a_document_of_text_comes_back_as_it_was_written(document, flow):
    written = yaml.safe_dump(document, default_flow_style=flow, allow_unicode=True, default_style=None)
    tree = parse(written.encode(), "f")
    assert (tree.value, tree.faults) == (document, [])


SHREDS = ["a", "b: ", "- ", "\n", "\n  ", "[", "]", "{", "}", ",", ":", "? ", "&x ", "*x", "!!t ", "|\n", ">-", "#", "'", '"', "\\", "\t", "%", "---", "...", "\x00", "é", "~"]  # fmt: skip


@settings(max_examples=300)
@given(st.lists(st.sampled_from(SHREDS), max_size=30).map("".join).map(str.encode) | st.binary(max_size=200))
def test_any_bytes_end_in_a_document_or_in_faults_inside_the_file(data):
    tree = parse(data, "f")
    lines = (
        data.count(b"\n")
        + data.count(b"\r")
        + 1
        + sum(map(data.count, (b"\xc2\x85", b"\xe2\x80\xa8", b"\xe2\x80\xa9")))
    )
    assert tree.complete or tree.faults
    assert all(1 <= fault.line <= lines and fault.column >= 1 for fault in tree.faults)
