"""Compiled functions that only loops may call: how a test calls them, and who calls them from Python."""

import ast
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numba import njit

ROOT = Path(__file__).parents[2]


def from_python(inner: Callable[..., Any]) -> Callable[..., Any]:
    """Return a loop that Python may call, and that does nothing but call a function that only loops may call."""

    @njit
    def call(*values):
        return inner(*values)

    return call


def inner_functions(sources: list[Path]) -> set[tuple[str, str]]:
    """Return module and name of each function whose compiler options are those of an inner one (``**INNER...``)."""
    texts = {path: path.read_text(encoding="utf-8") for path in sources}
    return {
        (_module(path), node.name)
        for path, text in texts.items()
        if "INNER" in text  # to parse takes long
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef) and any("INNER" in ast.unparse(d) for d in node.decorator_list)
    }


def calls_from_python(path: Path, inner: set[tuple[str, str]]) -> Iterator[str]:
    """Yield the calls of inner functions in a file that stand outside of compiled functions."""
    text, own = path.read_text(encoding="utf-8"), _module(path)
    if all(home != own and home.rpartition(".")[2] not in text for home, _ in inner):
        return
    tree = ast.parse(text)
    known = _names(tree, own, inner)
    for node in _plain_code(tree) if known else ():
        if isinstance(node, ast.Call) and ast.unparse(node.func) in known:
            yield f"{path.name}:{node.lineno}: {ast.unparse(node.func)}"


def _names(tree: ast.Module, module: str, inner: set[tuple[str, str]]) -> set[str]:
    """Return how a file calls the inner functions that it defines or imports, for instance ``tail.level``."""
    names = {name for home, name in inner if home == module}
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.ImportFrom)
            and node.module
            and node.module.startswith(("simulators", "drivers", "calib"))
        ):
            for alias in node.names:
                own = alias.asname or alias.name
                names |= {own} if (node.module, alias.name) in inner else set()
                names |= {f"{own}.{name}" for home, name in inner if home == f"{node.module}.{alias.name}"}
    return names


def _plain_code(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a file, but for those of compiled functions."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef) and any("njit" in ast.unparse(d) for d in child.decorator_list):
            continue
        yield child
        yield from _plain_code(child)


def _module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts) if path.is_relative_to(ROOT) else path.stem
