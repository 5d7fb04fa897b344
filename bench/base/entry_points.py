"""What installed packages add to Starbench by entry points: commands, kinds of folder, schemas and workers.

The list is read from the packages' own files: `importlib.metadata` reads the same, but its import alone takes as long
as half of ``starbench --help``. An object is imported when it is used.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from bench.base.errors import UsageError

COMMANDS = "starbench.commands"
FOLDERS = "starbench.folders"
SCHEMAS = "starbench.schemas"
WORKERS = "starbench.workers"
_WORDS = {
    COMMANDS: "command",
    FOLDERS: "kind of folder with",
    SCHEMAS: "schema",
    WORKERS: "option --workers with",
}
_METADATA = ".dist-info"
SOURCE = Path(__file__).parents[2]


class ExtraMissing(UsageError):
    """Something needs a package that is not installed, or cannot be imported."""


@dataclass(frozen=True)
class EntryPoint:
    """A line of a package's list."""

    group: str
    name: str
    value: str  # ``module:object``
    package: str  # Name and version of the package that declares it

    def load(self) -> Any:
        """Import the object. Raises `ExtraMissing` with the reason why it cannot be used."""
        module, _, path = self.value.partition(":")
        try:
            found = import_module(module)
            for part in path.split("."):
                found = getattr(found, part)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{module}.".startswith(f"{error.name}."):
                raise self._unusable(error) from error
            needed = module.rpartition(".")[0] or module
            what = f"The {self._named} needs the package {needed}, which is missing."
            raise ExtraMissing(what, remedy=f"Install it again: {self.package} declares it.") from error
        except Exception as error:  # a package of others may raise anything
            raise self._unusable(error) from error
        return found

    @property
    def _named(self) -> str:
        return f"{_WORDS[self.group]} {self.name.partition('|')[0].strip()!r}"

    def _unusable(self, error: Exception) -> ExtraMissing:
        why = f"{type(error).__name__}: {error}"
        what = f"The {self._named} of {self.package} cannot be used: {why}."
        return ExtraMissing(what, where=self.value, remedy="Install this package again, or remove it.")


def entry_points(group: str) -> Mapping[str, EntryPoint]:
    """Return what is declared for a group, by name; of two with one name, that which Python would find first."""
    return {
        name: EntryPoint(group, name, value, package)
        for package, lines in reversed(declared_lines(tuple(sys.path)))
        for of_group, name, value in reversed(lines)
        if of_group == group
    }


def load(group: str, name: str) -> Any:
    """Import what is declared by a name. Raises `ExtraMissing`."""
    entry = entry_points(group).get(name)
    if entry is None:
        raise missing(group, name)
    return entry.load()


def missing(group: str, name: str) -> ExtraMissing:
    """Return the error for a name that no installed package declares."""
    what = f"No installed package has the {_WORDS[group]} {name!r}."
    return ExtraMissing(what, remedy="Install the package that brings it.")


def stale_remark() -> str:
    """Return what the source folder declares and its installation lacks, by name, and what to do; or nothing."""
    import tomllib

    try:
        with (SOURCE / "pyproject.toml").open("rb") as file:
            declared = tomllib.load(file)["project"]["entry-points"]
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return ""
    new = [name for group, names in declared.items() for name in names if name not in entry_points(group)]
    if not new:
        return ""
    named = ", ".join(name.partition("|")[0].strip() for name in new)
    return (
        f"This installation is older than {SOURCE / 'pyproject.toml'}, and lacks: {named}. Install again: "
        f"pip install --no-deps -e {SOURCE}"
    )


@functools.cache
def declared_lines(path: tuple[str, ...]) -> Sequence[tuple[str, Sequence[tuple[str, str, str]]]]:
    """Return by package the lines of all groups of Starbench: group, name and value."""
    found: dict[str, Sequence[tuple[str, str, str]]] = {}
    for folder in dict.fromkeys(path):
        try:
            names = sorted(os.listdir(folder or "."))  # noqa: PTH208 - paths of a hundred packages take too long
        except OSError:
            continue
        for name in names:
            if name.endswith(_METADATA):
                package = name.removesuffix(_METADATA).replace("-", " ")
                found.setdefault(package, _lines(f"{folder or '.'}/{name}/entry_points.txt"))
    return tuple(found.items())


def _lines(file: str) -> Sequence[tuple[str, str, str]]:
    try:
        with open(file, "rb") as opened:  # noqa: PTH123 - as above
            text = opened.read()
    except OSError:
        return ()
    if b"starbench." not in text:
        return ()
    group, lines = "", []
    for line in map(str.strip, text.decode("utf-8", errors="replace").splitlines()):
        if line.startswith("["):
            group = line.strip("[]")
        elif group.startswith("starbench.") and "=" in line and not line.startswith(("#", ";")):
            name, _, value = line.partition("=")
            lines.append((group, name.strip(), value.strip()))
    return lines
