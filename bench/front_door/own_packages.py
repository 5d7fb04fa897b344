"""Checks that the five packages of Starbench lie side by side, so that none of them is another project's.

Their names (`bench`, `calib`, `drivers`, `sequences`, `simulators`) are common words. Another package or a folder of
one of these names may come earlier on Python's search path. This module finds the packages without importing them.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("bench", "calib", "drivers", "sequences", "simulators")

_INSTALL_AGAIN = "Install it again, in a virtual environment of its own."


class ForeignPackageError(ImportError):
    """A package with the name of one of Starbench's is found in its place, or one is missing.

    Attributes
    ----------
    what
        What is wrong, with the path.
    remedy
        What to do about it.
    """

    def __init__(self, what: str, remedy: str) -> None:
        self.what = what
        self.remedy = remedy
        super().__init__(f"{what} {remedy}")


def require_own_packages() -> None:
    """Refuse with `ForeignPackageError` unless Python finds all five packages in the folder in which Starbench is."""
    places = {name: _place(name) for name in PACKAGES}
    home = next(filter(_is_home, (place.parent for place in places.values() if place is not None)), None)
    if home is None:
        missing = [name for name, place in places.items() if place is None]
        named = f" Missing: {', '.join(missing)}." if missing else ""
        raise ForeignPackageError(
            f"Starbench is not installed completely.{named}",
            _INSTALL_AGAIN,
        )
    for name, place in places.items():
        if place is None:
            raise ForeignPackageError(f"The package {name!r} is missing in {home}.", _INSTALL_AGAIN)
        if place != home / name:
            raise ForeignPackageError(
                f"Python finds another package named {name!r}: {place}. Starbench is in {home}.",
                "Install Starbench in a virtual environment of its own, or remove "
                f"{place.parent} from PYTHONPATH. If it is the current folder, start from another folder.",
            )


def _place(name: str) -> Path | None:
    """Return the folder of a package, or the file of a module, that `import name` would load; None if there is none."""
    module = sys.modules.get(name)
    spec = getattr(module, "__spec__", None) if module is not None else find_spec(name)
    if spec is None:
        return None
    if spec.submodule_search_locations is None:
        return Path(spec.origin or name).absolute()
    return Path(next(iter(spec.submodule_search_locations), name)).absolute()


def _is_home(folder: Path) -> bool:
    """Return whether a folder has all five packages, with the front door in `bench`."""
    packages = all((folder / name / "__init__.py").is_file() for name in PACKAGES)
    return packages and (folder / "bench" / "front_door").is_dir()
