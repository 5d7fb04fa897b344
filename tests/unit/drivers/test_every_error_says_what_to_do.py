"""Each error of a driver says what is wrong, and what to do about it: no ``raise`` leaves the remedy out."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import drivers
from drivers import errors

FILES = sorted(Path(drivers.__file__).parent.rglob("*.py"))


def _has_remedy_of_its_own(kind: type[errors.DriverError]) -> bool:
    return kind is errors.UnreadableEvents and bool(kind("gone").remedy)


KINDS = {
    name
    for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, errors.DriverError) and not _has_remedy_of_its_own(kind)
}


def made_errors(source: str) -> Iterator[ast.Call]:
    """Calls that make one of the drivers' errors, by its name."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in KINDS:
            yield node


def without_remedy(source: str) -> list[int]:
    """Lines of those that say no remedy, or an empty one."""
    remedies = {
        call.lineno: [word.value for word in call.keywords if word.arg == "remedy"]
        for call in made_errors(source)
    }
    return [
        line
        for line, values in remedies.items()
        if not values or (isinstance(values[0], ast.Constant) and not values[0].value)
    ]


def test_the_check_sees_a_missing_and_an_empty_remedy() -> None:
    source = 'raise PortLost("gone", where="a")\nPortLost("gone", remedy="")\nPortLost("gone", remedy="look")'
    assert without_remedy(source) == [1, 2]


def test_every_error_has_a_remedy() -> None:
    sources = {path: path.read_text(encoding="utf-8") for path in FILES if path.name != "errors.py"}
    assert sum(len(list(made_errors(source))) for source in sources.values()) > 100
    missing = [f"{path.name}:{line}" for path, source in sources.items() for line in without_remedy(source)]
    assert missing == []
