"""Verify a sealed folder: signature, files, authorisation, time stamps, journal.

It writes nothing, trusts nothing in the folder, and reports all faults. Trusted keys come from outside the folder;
ledger and engine come in as callables (`Derivation`), so that this package imports no engine.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.base.bounded_json import canonical_json, parse_json
from bench.base.errors import EvidenceError, RunFolderError, StorageError
from bench.evidence.beside_seal import read_beside
from bench.evidence.findings import Derivation, Findings, Verification
from bench.evidence.folder_kinds import folder_kind, markers
from bench.evidence.journal_check import check_journal
from bench.evidence.key_trust import Trust
from bench.evidence.seal import (
    INSTRUCTIONS,
    NOT_LISTED,
    instructions,
    list_files,
    read_manifest,
)
from bench.evidence.signers import PRINCIPAL, Signer
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import read_signature
from bench.evidence.states import LARGEST_SEAL_BYTES, standing_of
from bench.record.journal import Capture
from bench.record.run_folder import (
    CERTIFICATE,
    JOURNAL,
    MANIFEST,
    PLAN,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    SIGNATURE,
    SOURCES,
    STATION_COPY,
)
from bench.record.storage import is_plain_file, read_bounded, read_json, sha256_of, storage_errors

_RUN_FILES = frozenset({RESULTS, REPORT, PLAN, SEQUENCE_COPY, STATION_COPY})
"""Files of runs; a folder that has them and no file of a kind is a run, or results, whose main file was removed."""
_CANONICAL = {RESULTS: True, PLAN: True, SOURCES: True}
"""JSON files that the program writes in one form only; whether other letters than ASCII are escaped in them."""
_PRINCIPAL = re.compile(rf" -I ({PRINCIPAL.pattern}) -n ")
_MOST_INSTRUCTIONS = 1 << 20  # They have 3 kB


def check_listed(folder: Path, findings: Findings) -> dict[str, str] | None:
    """Check that a sealed folder has exactly its listed files; return SHA-256 by name, None without a list."""
    path = folder / MANIFEST
    if not is_plain_file(path) or path.stat().st_size > LARGEST_SEAL_BYTES:
        return None  # a fault of the signature
    try:
        manifest = read_manifest(path.read_bytes())
    except EvidenceError as error:
        findings.fault("manifest", error.where, error.what)
        manifest = {}
    _kind(findings, manifest)
    _files(findings, folder, manifest)
    canonical = {**_CANONICAL, **folder_kind(folder).canonical}
    for name in sorted(canonical.keys() & manifest.keys()):
        _form(findings, folder / name, ascii_only=canonical[name])
    _instructions(findings, folder)
    return manifest


def _kind(findings: Findings, manifest: Mapping[str, str]) -> None:
    """Refuse a folder whose kind is not certain: its checks could be avoided by a file of another kind."""
    found = [name for name in markers() if name in manifest]
    if len(found) > 1:
        findings.fault("kind", found[1], f"a folder with {found[0]} does not have this file")
    elif not found and _RUN_FILES & set(manifest):
        findings.fault("kind", JOURNAL, "the file is missing, though the folder has other files of a run")


def _instructions(findings: Findings, folder: Path) -> None:
    """Compare VERIFY.txt with the instructions for the key that sealed the folder: a reader types these commands."""
    path = folder / INSTRUCTIONS
    try:
        key = fingerprint(read_signature(read_beside(folder, SIGNATURE) or b"").public_key)
    except EvidenceError:
        return  # told already
    had = b"" if not is_plain_file(path) else read_bounded(path, _MOST_INSTRUCTIONS)
    text = had.decode(errors="replace")
    named = _PRINCIPAL.search(text)
    if text != instructions(folder_kind(folder), principal=named[1] if named else "", fingerprint=key):
        what = "these are not the instructions for the key that sealed this folder"
        findings.fault("instructions", INSTRUCTIONS, what)


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
    try:
        is_same = canonical_json(content, ascii_only=ascii_only) == data
    except ValueError:  # a number that is not finite
        is_same = False
    if not is_same:
        findings.fault("form", path.name, "its JSON is not written as the program writes it")


def _files(findings: Findings, folder: Path, manifest: Mapping[str, str]) -> None:
    there, of_kind = list_files(folder), folder_kind(folder)
    for name, kind in sorted(there.items()):
        if name in NOT_LISTED:  # `standing_of` checks these
            continue
        if kind != "file":
            findings.fault("link" if kind == "link" else "added", name, f"this is a {kind}, not a file")
        elif name not in manifest:
            findings.fault("added", name, "the file was added after sealing: move it out of the folder")
        elif of_kind.files is not None and not of_kind.files.fullmatch(name):
            findings.fault("kind", name, f"no {of_kind.noun} has this file")
    for name, sha256 in manifest.items():
        if name not in there:
            findings.fault("missing", name, "the file is missing")
        elif there[name] == "file" and sha256_of(folder / name) != sha256:
            findings.fault("changed", name, "the file was changed after sealing")


def verify_folder(
    folder: Path,
    trust: Trust | Iterable[Signer],
    *,
    now: datetime | None = None,
    at: datetime | None = None,
    camera_serial: str | None = None,
    derivations: Sequence[Derivation] | None = None,
    again: bool = False,
) -> Verification:
    """Check a sealed folder: a run, a certificate, recalculated results, or any other (`bench.evidence.folder_kinds`).

    ``derivations`` are further checks, called in order with the folder alone, while no check has found a fault; an
    empty list: nothing is known of its files. ``trust`` comes from `read_trust`, or is trusted keys alone. ``now`` has
    its time zone, None for the system's; ``at`` is as for `standing_of`. ``camera_serial`` reveals a report of another
    camera. ``again`` is only stated.
    """
    if not folder.is_dir() or not any(
        (folder / name).exists() for name in (MANIFEST, CERTIFICATE, *markers())
    ):
        raise RunFolderError(
            "This is not a run folder, and no other folder that Starbench seals.",
            where=str(folder),
            remedy="Name the folder that a run, a certificate or recalculated results were written to.",
        )
    kind = folder_kind(folder).name
    trusted = trust if isinstance(trust, Trust) else Trust(tuple(trust))
    with storage_errors(folder):
        verification = standing_of(folder, trusted, now or datetime.now(UTC), at=at)
        verification.kind, verification.again = kind, again
        manifest = check_listed(folder, verification)
        verification.files = len(manifest or ())
        captures = (
            check_journal(folder, manifest, verification) if kind == "run" and manifest is not None else None
        )
        _results(folder, captures, camera_serial, verification)
        if derivations is not None and not derivations:
            verification.not_compared.append(
                f"nothing is known of the files of a folder of the kind {kind!r}"
            )
        verification.derive(folder, derivations or ())
    return verification


def _results(
    folder: Path,
    captures: Mapping[str, Capture] | None,
    camera_serial: str | None,
    verification: Verification,
) -> None:
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
        if camera_serial not in {None, verification.camera_serial}:
            what = f"the results belong to camera {verification.camera_serial}; {camera_serial} was requested"
            verification.fault("item", RESULTS, what)


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
