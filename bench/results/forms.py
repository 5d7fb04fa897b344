"""Hashes of the program's own files, by which a verification can tell another program from changed evidence.

A version number does not identify a working copy of the sources.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

_PACKAGES = ("bench", "calib", "drivers", "sequences", "simulators")
_REPORT = "bench/report"
_DRAWN_WITH = (
    "calib/uncertainty/projection_uncertainty.py",
    "calib/model/camera.py",
    "calib/model/lens.py",
)
"""Modules of the engine that the plots use."""
_EXPORTED_WITH = (
    "bench/results/exports.py",
    "calib/model/camera.py",
    "calib/model/lens.py",
)
_ENDINGS = frozenset({".py", ".j2", ".css"})
_SHOWN = 16


@functools.cache
def forms() -> dict[str, str]:
    """Return ``program``, ``report_form``, ``export_form``: 16 digits of the SHA-256 of these files and their names."""
    import bench

    root = Path(bench.__file__).parent.parent
    return {
        "program": _hash(root, (path for package in _PACKAGES for path in _sources(root / package))),
        "report_form": _hash(root, [*_sources(root / _REPORT), *(root / name for name in _DRAWN_WITH)]),
        "export_form": _hash(root, (root / name for name in _EXPORTED_WITH)),
    }


def _sources(folder: Path) -> Iterable[Path]:
    return (path for path in folder.rglob("*") if path.suffix in _ENDINGS)


def _hash(root: Path, files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for name, path in sorted((path.relative_to(root).as_posix(), path) for path in files):
        data = path.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name} {len(data)}\n".encode() + data)
    return digest.hexdigest()[:_SHOWN]
