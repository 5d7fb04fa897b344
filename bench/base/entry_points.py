"""What installed packages add to Starbench by entry points: commands, kinds of folder, schemas and workers.

An object is imported when it is used, as are the libraries of extras.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib import import_module, metadata
from importlib.metadata import EntryPoint
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
SOURCE = Path(__file__).parents[2]


class ExtraMissing(UsageError):
    """Something needs a package that is not installed, or cannot be imported."""


def extra_library(name: str, what: str, *, where: str = "", remedy: str) -> Any:
    """Import a library of an extra. Raises `UsageError` with ``what``, a sentence, if it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        raise UsageError(what, where=where, remedy=remedy) from error


def load_entry(entry: EntryPoint) -> Any:
    """Import an object. Raises `ExtraMissing` with the reason why it cannot be used."""
    try:
        return entry.load()
    except ModuleNotFoundError as error:
        if error.name is None or not f"{entry.module}.".startswith(f"{error.name}."):
            raise _unusable(entry, error) from error
        needed = entry.module.rpartition(".")[0] or entry.module
        what = f"The {_named(entry)} needs the package {needed}, which is missing."
        raise ExtraMissing(what, remedy=f"Install it again: {_package(entry)} declares it.") from error
    except Exception as error:  # another package may raise anything
        raise _unusable(entry, error) from error


def _named(entry: EntryPoint) -> str:
    return f"{_WORDS[entry.group]} {entry.name.partition('|')[0].strip()!r}"


def _package(entry: EntryPoint) -> str:
    return "an unknown package" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"


def _unusable(entry: EntryPoint, error: Exception) -> ExtraMissing:
    why = f"{type(error).__name__}: {error}"
    what = f"The {_named(entry)} of {_package(entry)} cannot be used: {why}."
    return ExtraMissing(what, where=entry.value, remedy="Install this package again, or remove it.")


@functools.cache
def entry_points(group: str) -> Mapping[str, EntryPoint]:
    """Return what is declared for a group, by name; of two with one name, that which Python would find first."""
    return {entry.name: entry for entry in reversed(tuple(metadata.entry_points(group=group)))}


def load(group: str, name: str) -> Any:
    """Import what is declared by a name. Raises `ExtraMissing`."""
    entry = entry_points(group).get(name)
    if entry is None:
        raise missing(group, name)
    return load_entry(entry)


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
