"""No code takes a fact out of a sentence: what is read by a program travels in a field of its own."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted(path for room in ("bench", "sequences") for path in (ROOT / room).rglob("*.py"))
SENTENCES = {
    "what", "why", "remedy", "reason", "reasons", "says", "said", "notes", "note", "remarks", "message", "messages",
    "statement", "statements", "sentence", "sentences", "deviations", "not_compared", "not_included", "effect",
    "event_text", "line_text", "interlock",
}  # fmt: skip
"""Names of attributes, keys and functions that hold sentences for people."""
TAKES_APART = {
    "partition", "rpartition", "split", "rsplit", "find", "index", "match", "fullmatch", "search", "findall", "finditer",
    "startswith", "removeprefix",
}  # fmt: skip
ALLOWED = {
    "bench/extras/certificate/check.py": "also.startswith",  # the form of a fixed text, not a fact in it
    "bench/extras/certificate/lab_config.py": "self.recalibration.startswith",  # what a person writes and the page prints
    "bench/report/calibration_tables.py": "str(line).partition",  # the engine states sources and effects as lines
}


def sentence_in(node):
    """Return the name of a sentence that an expression reads; None if it reads none."""
    for part in ast.walk(node):
        name = getattr(part, "attr", None) or getattr(part, "id", None)
        if isinstance(part, ast.Subscript) and isinstance(part.slice, ast.Constant):
            name = part.slice.value
        if isinstance(part, ast.Call) and part.args and isinstance(part.args[0], ast.Constant):
            name = part.args[0].value if getattr(part.func, "attr", "") == "get" else name
        if name in SENTENCES:
            return name
    return None


OF_A_PATTERN = {"match", "fullmatch", "search", "findall", "finditer"}


def taken_apart(tree):
    """Yield the calls that take a sentence apart, and slices of one; to join its words by single spaces is no such call."""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in TAKES_APART
        ):
            read = node.args if node.func.attr in OF_A_PATTERN else [node.func.value]
            if any(map(sentence_in, read)) and (node.args or node.func.attr != "split"):
                yield f"{node.lineno}: {ast.unparse(node)}"
        if (
            isinstance(node, ast.Subscript)
            and isinstance(node.slice, ast.Slice)
            and isinstance(node.value, ast.Call)
        ) and getattr(node.value.func, "id", "") in SENTENCES:
            yield f"{node.lineno}: {ast.unparse(node)}"


def test_no_code_takes_a_fact_out_of_a_sentence():
    places = []
    for path in FILES:
        name = path.relative_to(ROOT).as_posix()
        text = path.read_text(encoding="utf-8")
        allowed = ALLOWED.get(name, "\0")
        places += [f"{name}:{line}" for line in taken_apart(ast.parse(text)) if allowed not in line]
    assert places == []


def test_no_code_names_a_step_by_the_name_of_a_class():
    files = [path.name for path in FILES if "__name__.removesuffix" in path.read_text(encoding="utf-8")]
    assert files == []


@pytest.mark.parametrize(
    "code",
    [
        'name, _, why = history.interlock.partition(":")',
        'pose = re.match(r"pose (\\d+)", gate["why"])',
        'certificate.statement("also").partition("Reason: ")[2]',
        "text = line_text(entry)[14:]",
        'parts = _PART.findall(" ".join(verification.not_compared))',
    ],
)
def test_the_scan_sees_the_ways_in_which_facts_were_read_before(code):
    assert list(taken_apart(ast.parse(code)))
