"""Verify the listed files of a sealed folder: its kind, exactly these files, unchanged, and each in its one form.

A folder holds only files that folders of its kind have: a reader would take another file for a part of the evidence.
JSON must be written as the program writes it, because two readers could read another form differently.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from bench.base.bounded_json import canonical_json, parse_json
from bench.base.errors import EvidenceError, StorageError
from bench.evidence.findings import Findings
from bench.evidence.instructions import KINDS, kind_of
from bench.evidence.seal import NOT_LISTED, list_files, read_manifest
from bench.records.reading import read_bounded
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
_EXPORTS = (
    r"exports/(opencv|ros_camera_info|kalibr_camchain)\.yaml|exports/mrcal\.cameramodel|exports/colmap_cameras\.txt"
    r"|exports/metavision\.json|exports/not-written\.txt"
)
_RESULT_FILES = rf"results\.json|report\.html|views\.h5|passport\.json|VERIFY\.txt|{_EXPORTS}"
FILES = {
    "run": re.compile(
        rf"{_RESULT_FILES}|journal\.jsonl|sequence\.yaml|station\.yaml|plan\.json|wire\.jsonl(\.[0-9]{{1,3}})?"
        r"|captures/pose-[0-9]{3,6}-attempt-[0-9]{1,4}\.[a-z0-9]{1,5}|quarantine/[^/]+\.[0-9]{1,4}"
    ),
    "results": re.compile(rf"{_RESULT_FILES}|sources\.json"),
    "certificate": re.compile(
        r"certificate\.json|results\.json|lab\.yaml|dcc\.xml|certificate\.pdf|VERIFY\.txt|plots/[a-z]{1,40}\.svg"
    ),
}
"""Names of the files that a sealed folder of each kind may have."""
_CANONICAL = {RESULTS: True, PLAN: True, "sources.json": True, "certificate.json": False}
"""JSON files that the program writes in one form only; whether other letters than ASCII are escaped in them."""


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
    for name in sorted(_CANONICAL.keys() & manifest.keys()):
        _form(found, folder / name)
    return manifest


def _kind(found: Findings, manifest: Mapping[str, str]) -> None:
    """Refuse a folder whose kind is not certain: its checks could be avoided by a file of another kind."""
    markers = [name for name in KINDS if name in manifest]
    if len(markers) > 1:
        found.fault("kind", markers[1], f"a folder with {markers[0]} does not have this file")
    elif not markers and _RUN_FILES & set(manifest):
        found.fault("kind", JOURNAL, "the file is missing, though the folder has other files of a run")


_FOLDERS = {"run": "run folder", "results": "folder of recalculated results", "certificate": "certificate"}


def _form(found: Findings, path: Path) -> None:
    """Check that a JSON file has the form that the program gives it, so that every reader reads the same."""
    if path.is_symlink() or not path.is_file():
        return  # told already
    try:
        data = read_bounded(path)
        content = parse_json(data)
    except (StorageError, ValueError) as error:
        if path.name != RESULTS:  # `verify` reads it too, and tells
            found.fault("form", path.name, f"the file cannot be read ({error})")
        return
    try:
        is_same = canonical_json(content, ascii_only=_CANONICAL[path.name]) == data
    except ValueError:  # a number that is not finite
        is_same = False
    if not is_same:
        found.fault("form", path.name, "its JSON is not written as the program writes it")


def _files(found: Findings, folder: Path, manifest: Mapping[str, str]) -> None:
    there, of_kind = list_files(folder), FILES.get(kind_of(folder))
    for name, kind in sorted(there.items()):
        if name in NOT_LISTED:  # `standing_of` checks these
            continue
        if kind != "file":
            found.fault("link" if kind == "link" else "added", name, f"this is a {kind}, not a file")
        elif name not in manifest:
            found.fault("added", name, "the file was added after sealing")
        elif of_kind is not None and not of_kind.fullmatch(name):
            found.fault("kind", name, f"no {_FOLDERS[kind_of(folder)]} has this file")
    for name, sha256 in manifest.items():
        if name not in there:
            found.fault("missing", name, "the file is missing")
        elif there[name] == "file" and sha256_of(folder / name) != sha256:
            found.fault("changed", name, "the file was changed after sealing")
