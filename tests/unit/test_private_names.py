"""No test reaches into a private name: not of a module or class of ours, not of an object of ours."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
OURS = ("bench", "calib", "drivers", "sequences", "simulators", "tests")
PRIVATE = re.compile(r"_(?!_)\w+")
PRIVATE_WORD = re.compile(r"\b_(?!_)\w+")
PUBLIC = {"_replace", "_asdict", "_fields", "_make", "_repr_html_"}
"""Methods of every named tuple, and what Jupyter calls."""


def own_names(tree):
    """Private names that a file defines: functions, classes, variables and attributes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr


def used_names(tree):
    """Names that a file imports from us, takes of objects, or spells in a patch; and their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in OURS:
            yield from ((name.name, node.lineno) for name in node.names)
        elif isinstance(node, ast.Attribute):
            yield node.attr, node.lineno
        elif isinstance(node, ast.Call):
            words = [word.value for word in node.args if isinstance(word, ast.Constant)]
            yield from ((str(word).rpartition(".")[2], node.lineno) for word in words if " " not in str(word))


def private(words):
    return {word for word in words if PRIVATE.fullmatch(word)} - PUBLIC


def test_tests_use_public_names_alone():
    texts = {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for folder in OURS
        for path in (ROOT / folder).rglob("*.py")
    }
    strange = []  # private names that a test file uses and does not define
    for name in sorted(name for name in texts if name.startswith("tests")):
        if private(PRIVATE_WORD.findall(texts[name])):  # to parse takes long
            tree = ast.parse(texts[name])
            words, own = list(used_names(tree)), set(own_names(tree))
            strange += [(name, line, word) for word, line in words if word in private({word}) - own]
    asked = {word for _, _, word in strange}
    assert "_exit" in asked  # Python's own
    ours = set()
    for text in texts.values():
        if asked & set(PRIVATE_WORD.findall(text)):
            ours |= asked & set(own_names(ast.parse(text)))
    assert [f"{name}:{line}: {word}" for name, line, word in strange if word in ours] == []
