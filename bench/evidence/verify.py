"""Verify a sealed folder: signature, files, authorisation, time stamps, journal.

It writes nothing, trusts nothing in the folder, and reports all faults. Trusted keys come from outside the folder;
ledger and engine come in as callables (`Derivation`), so that this package imports no engine.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from bench.base.errors import EvidenceError, RunFolderError
from bench.evidence.beside_seal import read_beside
from bench.evidence.content_check import check_content
from bench.evidence.findings import Derivation, Findings, Verification
from bench.evidence.folder_kinds import folder_kind, markers
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
from bench.record.run_folder import CERTIFICATE, MANIFEST, RESULTS, SIGNATURE
from bench.record.storage import is_plain_file, read_bounded, sha256_of, storage_errors

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
    _files(findings, folder, manifest)
    _instructions(findings, folder)
    return manifest


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


def _files(findings: Findings, folder: Path, manifest: Mapping[str, str]) -> None:
    there = list_files(folder)
    for name, kind in sorted(there.items()):
        if name in NOT_LISTED:  # `standing_of` checks these
            continue
        if kind != "file":
            findings.fault("link" if kind == "link" else "added", name, f"this is a {kind}, not a file")
        elif name not in manifest:
            findings.fault("added", name, "the file was added after sealing: move it out of the folder")
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
        check_content(folder, manifest, verification)
        if verification.run_id is not None and camera_serial not in {None, verification.camera_serial}:
            what = f"the results belong to camera {verification.camera_serial}; {camera_serial} was requested"
            verification.fault("item", RESULTS, what)
        if derivations is not None and not derivations:
            verification.not_compared.append(
                f"nothing is known of the files of a folder of the kind {kind!r}"
            )
        verification.derive(folder, derivations or ())
    return verification
