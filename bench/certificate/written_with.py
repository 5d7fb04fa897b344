"""What writes a certificate: the program's own files by their hash, and the libraries that decide bytes.

A verifier that is another program cannot expect the same bytes; these entries tell it so. They stand at the end of the
certificate's list of software, after the programs of the run.
"""

from __future__ import annotations

import functools
import hashlib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from bench.certificate.result_data import Software

FORM = "certificate_form"
_LIBRARIES = ("typst", "lxml")
_FOLDER = "bench/certificate"
_ENDINGS = frozenset({".py", ".typ"})
_ALSO = (
    "bench/report/calibration_tables.py",
    "bench/report/camera_values.py",
    "calib/model/camera.py",
    "calib/model/lens.py",
    "calib/uncertainty/covariance.py",
    "calib/uncertainty/projection_uncertainty.py",
)
"""Other modules whose code decides a value or a word of a certificate."""
_SHOWN = 16


@functools.cache
def written_with() -> tuple[Software, ...]:
    """Return what writes a certificate here.

    Returns: ``certificate_form``, which is the first 16 characters of a SHA-256 over the files, and the
      libraries; those that are not installed are missing.
    """
    import bench

    root = Path(bench.__file__).parent.parent
    files = [path for path in (root / _FOLDER).rglob("*") if path.suffix in _ENDINGS]
    digest = hashlib.sha256()
    for name in sorted({*(path.relative_to(root).as_posix() for path in files), *_ALSO}):
        data = (root / name).read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name} {len(data)}\n".encode() + data)
    return (Software(FORM, digest.hexdigest()[:_SHOWN]), *_installed())


def _installed() -> list[Software]:
    found = []
    for name in _LIBRARIES:
        try:
            found.append(Software(name, version(name)))
        except PackageNotFoundError:
            continue
    return found


def other_writer(software: tuple[Software, ...]) -> str:
    """Return how the program that wrote a certificate differs from this one.

    software: The certificate's list of software.
    Returns: ``typst 0.14 (here 0.15)``, several with commas; empty if all are the same.
    """
    stated = {one.name: one.version for one in software}
    return ", ".join(
        f"{one.name.replace('_', ' ')} {stated.get(one.name, 'not stated')} (here {one.version})"
        for one in written_with()
        if stated.get(one.name) != one.version
    )
