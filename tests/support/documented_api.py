"""What a notebook or the author of a plug-in calls, and what the docstrings of these names leave out.

A docstring of the API holds a ``Parameters`` section that names every parameter, ``Returns`` where something is
returned, ``Raises`` for what the body itself raises, and a shape such as ``(N, 2)`` for every array.
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("bench", "calib", "drivers", "sequences", "simulators")

# File, and the names in it; "*" for all. A class stands for its public methods too.
PLUGIN_API = {
    "bench/front_door/__init__.py": "*",
    "bench/front_door/own_packages.py": "*",
    "bench/solve/run_reader.py": "Pose Run load",
    "bench/stations/sections.py": "AxisConfig AnyStage StageSection AnyLight LightSection BiasesConfig EventCameraConfig"
    " EventCameraSection FrameCameraConfig FrameCameraSection",
    "bench/extras/plugin_tests/__init__.py": "*",
    "bench/extras/plugin_tests/cameras.py": "*",
    "bench/extras/plugin_tests/rig.py": "*",
    "bench/extras/plugin_tests/stages.py": "*",
    "drivers/stage/__init__.py": "*",
    "drivers/light/__init__.py": "*",
    "drivers/camera/__init__.py": "*",
    "drivers/camera/frames.py": "FrameSettings FrameFacts FrameCamera",
    "drivers/stage/watched.py": "WatchedStage",
    "drivers/text_line.py": "TextLine",
}

_ARRAY = re.compile(r"\b(Array|NDArray|ndarray|\w*Array)\b")
_SHAPE = re.compile(r"\(\s*[\w.+*/ -]*\s*(,[^()]*)?\)|\bscalar\b|\bshape\b")
_HEADING = re.compile(
    r"^(Parameters|Returns|Yields|Raises|Attributes|Examples|Notes|References|See Also)\n-+$", re.MULTILINE
)
_SECTION = re.compile(r"^(Parameters|Returns|Yields|Raises|Attributes)\n-+$", re.MULTILINE)
_DOCUMENTED_ELSEWHERE = re.compile(r"property|override|validator|serializer|fixture|overload|setter")
_REFERS = re.compile(r"\ASee `[\w.]+`\.")

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Documented:
    """A function, method or class with a docstring: its place, its name with its class, its tree, its text."""

    place: str
    name: str
    node: Function | ast.ClassDef
    docstring: str

    def section(self, title: str) -> str | None:
        """Return the text of a section of the docstring, or None where it has none."""
        headings = list(_HEADING.finditer(self.docstring))
        for here, match in enumerate(headings):
            if match.group(1) == title:
                end = headings[here + 1].start() if here + 1 < len(headings) else None
                return self.docstring[match.end() : end]
        return None

    def has_sections(self) -> bool:
        """Return whether the docstring has the full form."""
        return bool(_SECTION.search(self.docstring))

    def gaps(self) -> Iterator[str]:
        """Yield what the docstring leaves out, a phrase each; a class leaves nothing out, its methods may."""
        if isinstance(self.node, ast.ClassDef):
            return
        listed = self.section("Parameters") or ""
        a = self.node.args
        for parameter in [*a.posonlyargs, *a.args, *filter(None, [a.vararg, a.kwarg]), *a.kwonlyargs]:
            if parameter.arg in {"self", "cls"} or parameter.arg.startswith("_"):
                continue
            entry = _entry(listed, parameter.arg)
            if entry is None:
                yield f"parameter {parameter.arg} is not described"
            elif _is_array(parameter.annotation) and not _SHAPE.search(entry):
                yield f"parameter {parameter.arg} has no shape"
        returned = ast.unparse(self.node.returns) if self.node.returns else ""
        if returned not in {"", "None", "NoReturn", "Never", "Self"}:
            result = self.section("Returns") or self.section("Yields")
            if result is None:
                yield "no Returns section"
            elif _is_array(self.node.returns) and not _SHAPE.search(result):
                yield "the result has no shape"
        raises = self.section("Raises") or ""
        for name in sorted({name for name in _raised(self.node) if not name.startswith("_")}):
            if name not in raises:
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


def _below(node: ast.AST, around: str, place: str) -> Iterator[Documented]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Function | ast.ClassDef):
            name = around + child.name
            yield Documented(f"{place}:{child.lineno}", name, child, ast.get_docstring(child) or "")
            if isinstance(child, ast.ClassDef):
                yield from _below(child, f"{name}.", place)
        else:
            yield from _below(child, around, place)


def calib_api() -> dict[str, str]:
    """Return file and names of what ``calib`` offers, from its table of modules."""
    tree = ast.parse((ROOT / "calib/__init__.py").read_text(encoding="utf-8"))
    (table,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_MODULES"
    )
    names_of: dict[str, str] = {}
    for name, module in table.items():
        file = f"{module.replace('.', '/')}.py"
        file = file if (ROOT / file).is_file() else f"{module.replace('.', '/')}/__init__.py"
        names_of[file] = f"{names_of.get(file, '')} {name}"
    return names_of


def documented(source: str, place: str = "here") -> list[Documented]:
    """Return every function, method and class of a source text, in the order of lines."""
    return list(_below(ast.parse(source), "", place))


@functools.cache
def split_by_api() -> tuple[list[Documented], list[Documented]]:
    """Return what belongs to the API and has to be complete, and everything else of the product."""
    api: list[Documented] = []
    inner: list[Documented] = []
    names = {**PLUGIN_API, **calib_api()}
    for package in PACKAGES:
        for file in sorted((ROOT / package).rglob("*.py")):
            place = str(file.relative_to(ROOT))
            wanted = names.get(place, "").split()
            for documented_name in documented(file.read_text(encoding="utf-8"), place):
                outer = documented_name.name.split(".")[0]
                (api if wanted == ["*"] or outer in wanted else inner).append(documented_name)
    return api, inner


def must_be_complete(documented: Documented) -> bool:
    """Return whether a name of the API is documented by itself, not by its base, its property or its framework."""
    decorators = " ".join(ast.unparse(d) for d in documented.node.decorator_list)
    return not (
        isinstance(documented.node, ast.ClassDef)
        or any(part.startswith(("_", "test_")) for part in documented.name.split("."))
        or _DOCUMENTED_ELSEWHERE.search(decorators)
        or _REFERS.match(documented.docstring)
    )
