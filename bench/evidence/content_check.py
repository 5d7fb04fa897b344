"""What the files of a folder state, checked by their list alone: `verify` and the seal refuse by this one rule."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.base.bounded_json import canonical_json, parse_json
from bench.base.errors import StorageError
from bench.evidence.findings import Findings, Verification
from bench.evidence.folder_kinds import folder_kind, markers
from bench.evidence.journal_check import check_journal
from bench.record.journal import Capture
from bench.record.run_folder import JOURNAL, PLAN, REPORT, RESULTS, SEQUENCE_COPY, SOURCES, STATION_COPY
from bench.record.storage import is_plain_file, read_bounded, read_json

_RUN_FILES = frozenset({RESULTS, REPORT, PLAN, SEQUENCE_COPY, STATION_COPY})
"""Files of runs. If a folder with one of them has no file that marks its kind, somebody removed that file."""
_CANONICAL = {RESULTS: True, PLAN: True, SOURCES: True}
"""JSON files that the program writes in one form only; whether other letters than ASCII are escaped in them."""


def check_content(folder: Path, manifest: Mapping[str, str] | None, verification: Verification) -> None:
    """Check names, form, journal and results of the files that a list names, each with the SHA-256 that it has."""
    kind, captures = folder_kind(folder), None
    if manifest is not None:
        _kind(verification, manifest)
        for name in manifest:
            if kind.files is not None and not kind.files.fullmatch(name):
                verification.fault("kind", name, f"no {kind.noun} has this file")
        canonical = {**_CANONICAL, **kind.canonical}
        for name in sorted(canonical.keys() & manifest.keys()):
            _form(verification, folder / name, ascii_only=canonical[name])
        if kind.name == "run":
            captures = check_journal(folder, manifest, verification)
    _results(folder, captures, verification)


def _kind(findings: Findings, manifest: Mapping[str, str]) -> None:
    """Refuse a folder whose kind is not certain: its checks could be avoided by a file of another kind."""
    found = [name for name in markers() if name in manifest]
    if len(found) > 1:
        findings.fault("kind", found[1], f"a folder with {found[0]} does not have this file")
    elif not found and _RUN_FILES & set(manifest):
        findings.fault("kind", JOURNAL, "the file is missing, though the folder has other files of a run")


def _form(findings: Findings, path: Path, *, ascii_only: bool) -> None:
    """Check that a JSON file has the form that the program gives it, so that every reader reads the same."""
    if not is_plain_file(path):
        return  # told already
    try:
        data = read_bounded(path)
        content = parse_json(data)
    except (StorageError, ValueError) as error:
        if path.name != RESULTS:  # `verify` reads it too, and tells
            findings.fault("form", path.name, f"the file cannot be read ({error})")
        return
    with suppress(ValueError):  # a number that is not finite
        if canonical_json(content, ascii_only=ascii_only) == data:
            return
    findings.fault("form", path.name, "its JSON is not written as the program writes it")


def _results(folder: Path, captures: Mapping[str, Capture] | None, verification: Verification) -> None:
    """Take run and camera from the results, and check that the journal, if there is one, names the same recordings."""
    path = folder / RESULTS
    if not is_plain_file(path):
        return  # the journal tells whether a run must have results
    with verification.unreadable("results", RESULTS, "the file cannot be read"):
        recordings = _read_facts(read_json(path), verification)
        hashes = None if captures is None else {name: capture.sha256 for name, capture in captures.items()}
        for name, sha256 in recordings:
            if hashes is not None and hashes.get(name) != sha256:
                what = f"the journal does not name {name} with this hash"
                verification.fault("results", RESULTS, what)


def _read_facts(results: Any, verification: Verification) -> list[tuple[str, str]]:
    """Take run and camera from results; return name and SHA-256 of each recording."""
    serial = (results["devices"].get("camera") or {}).get("serial")
    run_id, simulated = str(results["run"]["id"]), bool(results["run"]["simulated"])
    recordings = [
        (str(attempt["capture"]), str(attempt["sha256"]))
        for pose in results["poses"]
        for attempt in pose.get("attempts") or ()
        if attempt["capture"] is not None
    ]
    verification.run_id, verification.simulated = run_id, simulated
    verification.camera_serial = None if serial is None else str(serial)
    return recordings
