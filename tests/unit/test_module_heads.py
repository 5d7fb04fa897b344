"""A module has one head and one thing, constants above the first definition, and variables named for what they hold."""

import ast
import doctest
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted(
    path
    for package in ("bench", "calib", "drivers", "sequences", "simulators")
    for path in (ROOT / package).rglob("*.py")
)
TESTS = sorted((ROOT / "tests").rglob("*.py"))
DEFINITIONS = (ast.FunctionDef, ast.ClassDef, ast.AsyncFunctionDef)
NO_NAMES = {"found", "one", "said", "told", "away", "beside"}
"""Words that name no thing: a search for them finds everything."""
MAY_BIND = re.compile(rf"\b({'|'.join(sorted(NO_NAMES))})\b\s*([=:,()\]]|in\b)")
"""What stands in a text that binds such a word; most texts have none, and need not be parsed."""


def targets(node):
    """Return the names that a statement binds."""
    return {
        part.id for part in ast.walk(node) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)
    }


def late_constants(text):
    """Yield constants below the first definition that need no definition of their module."""
    made, below = set(), False
    for node in ast.parse(text).body:
        if isinstance(node, DEFINITIONS):
            made.add(node.name)
            below = True
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            read = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
            read |= {part.value for part in ast.walk(node) if isinstance(part, ast.Constant)}
            if below and not read & made:
                yield f"{node.lineno}: {ast.unparse(node)[:60]}"
            elif below:
                made |= targets(node)
        elif not isinstance(node, ast.Import | ast.ImportFrom | ast.Expr):
            made |= targets(node)


def second_heads(text):
    """Yield comments that stand alone between two empty lines at the left margin, below the imports."""
    lines = text.splitlines()
    inside = {
        line
        for node in ast.parse(text).body
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    begun = min(inside, default=0)
    for number, line in enumerate(lines, start=1):
        alone = number > 1 and not lines[number - 2].strip() and number > begun
        if alone and line.startswith("# ") and number not in inside:
            end = next((k for k in range(number, len(lines)) if not lines[k].startswith("#")), len(lines))
            if end < len(lines) and not lines[end].strip():
                yield f"{number}: {line[:60]}"


def no_names(text):
    """Yield variables, parameters and functions whose name is no name of a thing; fields are parts of formats."""
    if not MAY_BIND.search(text):
        return
    nodes = list(ast.walk(ast.parse(text)))
    fields = {
        part.target
        for node in nodes
        if isinstance(node, ast.ClassDef)
        for part in node.body
        if isinstance(part, ast.AnnAssign)
    }
    for node in nodes:
        is_bound = isinstance(node, (ast.arg, *DEFINITIONS)) or isinstance(
            getattr(node, "ctx", None), ast.Store
        )
        name = getattr(node, "arg", None) or getattr(node, "id", None) or getattr(node, "name", None)
        if is_bound and name in NO_NAMES and node not in fields:
            yield f"{node.lineno}: {name}"


def examples(text):
    """Yield the doctests of a text, each docstring's as a text of its own."""
    for docstring in text.split('"""') if ">>> " in text else ():
        yield "".join(example.source for example in doctest.DocTestParser().get_examples(docstring))


@pytest.mark.parametrize("scan", [late_constants, second_heads])
def test_a_module_has_one_head_and_one_thing(scan):
    lines = [
        f"{path.relative_to(ROOT).as_posix()}:{line}"
        for path in FILES
        for line in scan(path.read_text(encoding="utf-8"))
    ]
    assert lines == []


def test_the_scan_sees_a_late_constant_and_a_second_head():
    text = '"""Head."""\n\nA = 1\n\n\ndef f():\n    return B\n\n\n# Another thing.\n\nB = 2\nC = f()\nD = C + 1\n'
    assert list(late_constants(text)) == ["12: B = 2"]
    assert list(second_heads(text)) == ["10: # Another thing."]


def test_variables_are_named_for_what_they_hold():
    unnamed = [
        f"{path.relative_to(ROOT).as_posix()}:{line}"
        for path in [*FILES, *TESTS]
        for text in [path.read_text(encoding="utf-8")]
        for part in [text, *examples(text)]
        for line in no_names(part)
    ]
    assert unnamed == []


def test_the_scan_sees_a_variable_a_parameter_a_function_and_an_example_without_a_name():
    text = "def said(one, b):\n    return [found for found in one]\n"
    assert list(no_names(text)) == ["1: said", "1: one", "2: found"]
    (_, example, _) = examples('def f():\n    """Do it.\n\n    >>> told = 1\n    """\n')
    assert list(no_names(example)) == ["1: told"]
