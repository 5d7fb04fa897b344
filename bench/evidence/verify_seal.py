"""Verify the listed files of a sealed folder: its kind, exactly these files, unchanged."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.evidence.findings import Findings
from bench.evidence.instructions import KINDS
from bench.evidence.seal import NOT_LISTED, list_files, read_manifest
from bench.records.run_folder import (
    JOURNAL,
    MANIFEST,
    PLAN,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    STATION_COPY,
)
from bench.records.storage import sha256_of

_RUN_FILES = frozenset({RESULTS, REPORT, PLAN, SEQUENCE_COPY, STATION_COPY})
"""Files of runs; a folder that has them and no file of a kind is a run, or results, whose main file was removed."""
LARGEST_SEAL_BYTES = 64 << 20
"""Seals of ten thousand poses are smaller; a larger file is not read."""


def check_listed(folder: Path, found: Findings) -> dict[str, str] | None:
    """Check that a sealed folder is of one kind, and has exactly the files of its list, unchanged.

    The signature of the list is checked by `bench.evidence.states.standing_of`.

    found: Findings; faults are added.
    Returns: SHA-256 by file name, as the seal lists them; None if there is no list that can be read.
    Raises OSError: When a file cannot be read.
    """
    path = folder / MANIFEST
    if path.is_symlink() or not path.is_file() or path.stat().st_size > LARGEST_SEAL_BYTES:
        return None  # a fault of the signature
    try:
        manifest = read_manifest(path.read_bytes())
    except EvidenceError as error:
        found.fault("manifest", error.where, error.what)
        manifest = {}
    _kind(found, manifest)
    _files(found, folder, manifest)
    return manifest


def _kind(found: Findings, manifest: Mapping[str, str]) -> None:
    """Refuse a folder whose kind is not certain: its checks could be avoided by a file of another kind."""
    markers = [name for name in KINDS if name in manifest]
    if len(markers) > 1:
        found.fault("kind", markers[1], f"a folder with {markers[0]} does not have this file")
    elif not markers and _RUN_FILES & set(manifest):
        found.fault("kind", JOURNAL, "the file is missing, though the folder has other files of a run")


def _files(found: Findings, folder: Path, manifest: Mapping[str, str]) -> None:
    there = list_files(folder)
    for name, kind in sorted(there.items()):
        if name in NOT_LISTED:  # `standing_of` checks these
            continue
        if kind != "file":
            found.fault("link" if kind == "link" else "added", name, f"this is a {kind}, not a file")
        elif name not in manifest:
            found.fault("added", name, "the file was added after sealing")
    for name, sha256 in manifest.items():
        if name not in there:
            found.fault("missing", name, "the file is missing")
        elif there[name] == "file" and sha256_of(folder / name) != sha256:
            found.fault("changed", name, "the file was changed after sealing")
