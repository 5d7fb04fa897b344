"""Print docstrings of public callables drawn at random, and list those that leave something out.

Usage::

    python tests/support/docstring_sample.py                # 40 drawn at random, printed for a reader
    python tests/support/docstring_sample.py --seed 7 --count 10 calib
    python tests/support/docstring_sample.py --gaps calib   # every gap, one a line; exit status 1 where there are any

Public are functions and methods whose own name and every name around them begin with no underscore. Left out are
properties (their summary says what they are), commands of the command line (their docstring is their help text), methods
decorated with ``override`` or one-sentence docstrings of the form "See `Base.method`." (the base documents them), special
methods and pydantic validators. What a docstring has to hold:

- a ``Parameters`` section that names every parameter, where there are parameters;
- a ``Returns`` or ``Yields`` section, where something is returned;
- a ``Raises`` section, where the body itself raises a public exception;
- a shape such as ``(N, 2)`` for every parameter or result that is an array (``scalar`` where it has no dimension).

Whether an equation cites its source, only a reader can see: the sample is printed for that.
"""

from __future__ import annotations

import argparse
import ast
import random
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("bench", "calib", "drivers", "sequences", "simulators")

_ARRAY = re.compile(r"\b(Array|NDArray|ndarray|\w*Array)\b")
_SHAPE = re.compile(r"\(\s*[\w.+*/ -]*\s*(,[^()]*)?\)|\bscalar\b|\bshape\b")
_SECTION = re.compile(
    r"^(Parameters|Returns|Yields|Raises|Attributes|Examples|Notes|References|See Also)\n-+$", re.MULTILINE
)
_COMMAND = re.compile(r"\b(command|group|validator|serializer|fixture|overload|setter)\b")
_REFERS = re.compile(r"\ASee `[\w.]+`\.")


@dataclass(frozen=True)
class PublicCallable:
    """A public function or method.

    Attributes
    ----------
    place
        ``file:line``, relative to the repository.
    name
        Its name, with its class.
    node
        Its syntax tree.
    docstring
        Its docstring, cleaned; empty where there is none.
    """

    place: str
    name: str
    node: ast.FunctionDef | ast.AsyncFunctionDef
    docstring: str

    @property
    def parameters(self) -> list[ast.arg]:
        """Its parameters without self, cls and those whose names begin with an underscore."""
        a = self.node.args
        named = [
            *a.posonlyargs,
            *a.args,
            *([a.vararg] if a.vararg else []),
            *a.kwonlyargs,
            *([a.kwarg] if a.kwarg else []),
        ]
        return [p for p in named if p.arg not in {"self", "cls"} and not p.arg.startswith("_")]

    @property
    def returns(self) -> str:
        """The annotation of its result; empty for None."""
        text = ast.unparse(self.node.returns) if self.node.returns else ""
        return "" if text in {"None", "NoReturn", "Never", "Self"} else text

    def section(self, title: str) -> str | None:
        """Return the text of a section of the docstring, or None where it has none."""
        found = list(_SECTION.finditer(self.docstring))
        for here, match in enumerate(found):
            if match.group(1) == title:
                end = found[here + 1].start() if here + 1 < len(found) else len(self.docstring)
                return self.docstring[match.end() : end]
        return None

    def gaps(self) -> Iterator[str]:
        """Yield what the docstring leaves out, a phrase each."""
        listed = self.section("Parameters") or ""
        for parameter in self.parameters:
            entry = _entry(listed, parameter.arg)
            if entry is None:
                yield f"parameter {parameter.arg} is not described"
            elif _is_array(parameter.annotation) and not _SHAPE.search(entry):
                yield f"parameter {parameter.arg} has no shape"
        if self.returns:
            result = self.section("Returns") or self.section("Yields")
            if result is None:
                yield "no Returns section"
            elif _is_array(self.node.returns) and not _SHAPE.search(result):
                yield "the result has no shape"
        raised = sorted({name for name in _raised(self.node) if not name.startswith("_")})
        section = self.section("Raises")
        for name in raised:
            if section is None or name not in section:
                yield f"{name} is raised and not listed"


def _entry(section: str, name: str) -> str | None:
    """Return the entry of a parameter in a numpydoc section, or None."""
    match = re.search(
        rf"^(?:\*\*?)?(?:\w+, )*(?:\*\*?)?{re.escape(name)}(?:,[^\n:]*)?\s*(?::[^\n]*)?$((?:\n(?:[ ]+.*|(?=\n)))*)",
        section,
        re.MULTILINE,
    )
    return match.group(0) if match else None


def _is_array(annotation: ast.expr | None) -> bool:
    text = ast.unparse(annotation) if annotation is not None else ""
    return bool(_ARRAY.search(text)) and "Callable" not in text


def _raised(node: ast.AST) -> Iterator[str]:
    """Yield the names of exceptions that the body itself constructs and raises."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Lambda):
            continue
        if isinstance(child, ast.Raise) and isinstance(child.exc, ast.Call):
            name = ast.unparse(child.exc.func).rpartition(".")[2]
            if name[:1].isupper() and name not in {"AssertionError", "NotImplementedError"}:
                yield name
        yield from _raised(child)


def _functions(body: Sequence[ast.stmt], around: str, place: str) -> Iterator[PublicCallable]:
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _functions(node.body, f"{around}{node.name}.", place)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith(
            ("_", "test_")
        ):
            decorators = " ".join(ast.unparse(d) for d in node.decorator_list)
            text = ast.get_docstring(node) or ""
            if (
                "property" in decorators
                or "override" in decorators
                or _COMMAND.search(decorators)
                or _REFERS.match(text)
            ):
                continue
            yield PublicCallable(f"{place}:{node.lineno}", around + node.name, node, text)


def public_callables(packages: Sequence[str] = PACKAGES) -> list[PublicCallable]:
    """Return every public callable below these folders, in the order of files and lines.

    Parameters
    ----------
    packages
        Folders or files, relative to the repository.

    Returns
    -------
    list of PublicCallable
        What was found.
    """
    found: list[PublicCallable] = []
    for package in packages:
        top = ROOT / package
        for file in sorted(top.rglob("*.py")) if top.is_dir() else [top]:
            tree = ast.parse(file.read_text(encoding="utf-8"))
            found.extend(_functions(tree.body, "", str(file.relative_to(ROOT))))
    return found


def main() -> int:
    """Print the sample, or the gaps.

    Returns
    -------
    int
        1 where gaps were asked for and there are any, else 0.
    """
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("packages", nargs="*", default=list(PACKAGES), help="folders or files to draw from")
    options.add_argument("--count", type=int, default=40, help="how many to draw")
    options.add_argument(
        "--seed", type=int, default=None, help="seed of the draw; another sample each time without it"
    )
    options.add_argument("--gaps", action="store_true", help="list every gap instead of a sample")
    chosen = options.parse_args()
    callables = public_callables(chosen.packages)
    if chosen.gaps:
        lines = [f"{c.place}: {c.name}: {gap}" for c in callables for gap in c.gaps()]
        print("\n".join([*lines, f"{len(callables)} public callables, {len(lines)} gaps"]))
        return int(bool(lines))
    for drawn in random.Random(chosen.seed).sample(callables, min(chosen.count, len(callables))):
        signature = ast.unparse(drawn.node.args)
        print(f"{drawn.place}\n    {drawn.name}({signature}) -> {drawn.returns or None}")
        print("\n".join(f"        {line}" for line in drawn.docstring.splitlines()), end="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
