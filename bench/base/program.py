"""The program that runs, by the hashes of its sources: what drew a report, and what wrote exports."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

_PACKAGES = ("bench", "calib", "drivers", "sequences", "simulators")
_REPORT = ("bench/report", "bench/wording")
_DRAWN_WITH = (
    "bench/record/stored_calibration.py",
    "calib/uncertainty/projection_uncertainty.py",
    "calib/model/camera.py",
    "calib/model/lens.py",
)
"""Modules of the engine that the plots use."""
_EXPORTED_WITH = (
    "bench/solve/exports.py",
    "calib/model/camera.py",
    "calib/model/lens.py",
)
_ENDINGS = frozenset({".py", ".j2", ".css"})
_SHOWN = 16  # Hexadecimal digits, 64 bit: no two versions agree by chance


@functools.cache
def forms() -> dict[str, str]:
    """Return ``program``, ``report_form``, ``export_form``: 16 digits of the SHA-256 of these files and their names."""
    import bench

    root = Path(bench.__file__).parent.parent
    return {
        "program": hash_of_files(root, (path for package in _PACKAGES for path in _sources(root / package))),
        "report_form": hash_of_files(
            root,
            [
                *(path for folder in _REPORT for path in _sources(root / folder)),
                *(root / name for name in _DRAWN_WITH),
            ],
        ),
        "export_form": hash_of_files(root, (root / name for name in _EXPORTED_WITH)),
    }


def differing_software(used: Mapping[str, str], here: Mapping[str, str]) -> str:
    """Return what of the software used differs here: ``numpy 2.1 (here 2.2)``, with commas."""
    return ", ".join(
        f"{name.replace('_', ' ')} {used.get(name, 'not stated')} (here {version})"
        for name, version in here.items()
        if used.get(name) != version
    )


def installed_versions(packages: Iterable[str]) -> dict[str, str]:
    """Return the versions of packages, in their order; one that is missing here is left out."""
    from importlib.metadata import PackageNotFoundError, version  # which most commands do not need

    versions = {}
    for name in packages:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions


def _sources(folder: Path) -> Iterable[Path]:
    return (path for path in folder.rglob("*") if path.suffix in _ENDINGS)


def hash_of_files(root: Path, files: Iterable[Path]) -> str:
    """Return 16 digits of the SHA-256 of source files and their names below a folder; line ends do not count."""
    digest = hashlib.sha256()
    for name, path in sorted((path.relative_to(root).as_posix(), path) for path in files):
        data = path.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name} {len(data)}\n".encode() + data)
    return digest.hexdigest()[:_SHOWN]
