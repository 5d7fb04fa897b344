"""No test reaches into a private name: not of a module or class of ours, not of an object of ours."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
OURS = ("bench", "calib", "drivers", "sequences", "simulators", "tests")
PRIVATE = re.compile(r"_(?!_)\w+")
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


def test_tests_use_public_names_alone():
    own, used = {}, {}
    for path in (path for folder in OURS for path in (ROOT / folder).rglob("*.py")):
        tree, name = ast.parse(path.read_text(encoding="utf-8")), str(path.relative_to(ROOT))
        own[name] = {word for word in own_names(tree) if PRIVATE.fullmatch(word)}
        used[name] = list(used_names(tree)) if name.startswith("tests") else []
    ours = set().union(*own.values()) - PUBLIC
    assert len(ours) > 1000
    reached = [
        f"{name}:{line}: {word}"
        for name in sorted(used)
        for word, line in used[name]
        if word in ours and word not in own[name]
    ]
    assert reached == []
