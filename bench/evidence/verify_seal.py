"""Verify the seal of a folder: the signature of its list, and the listed files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from bench.base.errors import EvidenceError
from bench.evidence.findings import Findings
from bench.evidence.instructions import KINDS
from bench.evidence.keys import NAMESPACE, Signer
from bench.evidence.seal import NOT_LISTED, list_files, read_manifest
from bench.evidence.sshsig import fingerprint, is_valid, read_signature
from bench.records.run_folder import (
    JOURNAL,
    MANIFEST,
    PLAN,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    SIGNATURE,
    STATION_COPY,
)
from bench.records.storage import sha256_of

_RUN_FILES = frozenset({RESULTS, REPORT, PLAN, SEQUENCE_COPY, STATION_COPY})
"""Files of runs; a folder that has them and no file of a kind is a run, or results, whose main file was removed."""
LARGEST_SEAL_BYTES = 64 << 20
LARGEST_TEXT_BYTES = 1 << 30
"""Seals, and results and reports of ten thousand poses, are smaller; a larger file is not read."""


def too_large(folder: Path, name: str) -> str:
    """Return why a file is not read because of its size.

    Parameters
    ----------
    folder
        The sealed folder.
    name
        Name of the file, which exists.

    Returns
    -------
    str
        The reason; empty if the file may be read.
    """
    limit = LARGEST_SEAL_BYTES if name in NOT_LISTED else LARGEST_TEXT_BYTES
    is_larger = (folder / name).stat().st_size > limit
    return f"the file is too large: more than {limit} bytes" if is_larger else ""


@dataclass
class SealCheck:
    """The seal of one folder, as checked.

    Attributes
    ----------
    found
        What was found.
    manifest
        SHA-256 by file name, as the seal lists them; None if the folder is not sealed.
    signer, fingerprint
        Name of the signer in the list of trusted keys, and fingerprint of the key; None if not known.
    """

    found: Findings = field(default_factory=Findings)
    manifest: dict[str, str] | None = None
    signer: str | None = None
    fingerprint: str | None = None


def check_seal(folder: Path, signers: Sequence[Signer], when: datetime) -> SealCheck:
    """Check the signature of the list of files, and that the folder has exactly these files, unchanged.

    Parameters
    ----------
    folder
        The folder.
    signers
        Trusted keys.
    when
        Moment at which the signer's key must be valid, with its time zone.

    Returns
    -------
    SealCheck
        The findings, the list, and who signed.

    Raises
    ------
    OSError
        When a file cannot be read.
    """
    check = SealCheck()
    _signature(check, folder, signers, when)
    if check.manifest is not None:
        _kind(check.found, check.manifest)
        _files(check.found, folder, check.manifest)
    return check


def _signature(check: SealCheck, folder: Path, signers: Sequence[Signer], when: datetime) -> None:
    found = check.found
    for name in (MANIFEST, SIGNATURE):
        path = folder / name
        if path.is_symlink() or not path.is_file():
            why = "this is a link, not a file" if path.is_symlink() else "the file is missing"
            found.fault("unsealed", name, f"{why}; this folder is not sealed")
            return
        if why := too_large(folder, name):
            found.fault("manifest", name, why)
            check.manifest = {}
            return
    manifest = (folder / MANIFEST).read_bytes()
    try:
        signature = read_signature((folder / SIGNATURE).read_bytes())
        check.fingerprint = fingerprint(signature.public_key)
        if signature.namespace != NAMESPACE:
            found.fault(
                "signature", SIGNATURE, f"the signature is for {signature.namespace!r}, not for a report"
            )
        if not is_valid(signature, manifest):
            found.fault("signature", SIGNATURE, f"the signature does not match this {MANIFEST}")
        _key(check, signature.public_key, signers, when)
    except EvidenceError as error:
        found.fault("signature", SIGNATURE, error.what)
    try:
        check.manifest = read_manifest(manifest)
    except EvidenceError as error:
        found.fault("manifest", error.where, error.what)
        check.manifest = {}


def _key(check: SealCheck, public_key: bytes, signers: Sequence[Signer], when: datetime) -> None:
    known = [signer for signer in signers if signer.public_key == public_key]
    rejections = [signer.rejection(NAMESPACE, when) for signer in known]
    if None in rejections:
        check.signer = known[rejections.index(None)].principal
    elif known:
        check.found.fault("key", SIGNATURE, str(rejections[0]))
    else:
        what = f"the key that signed is not in the list of trusted keys ({check.fingerprint})"
        check.found.fault("key", SIGNATURE, what)


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
        if kind != "file":
            found.fault("link" if kind == "link" else "added", name, f"this is a {kind}, not a file")
        elif name not in manifest and name not in NOT_LISTED:
            found.fault("added", name, "the file was added after sealing")
    for name, sha256 in manifest.items():
        if name not in there:
            found.fault("missing", name, "the file is missing")
        elif there[name] == "file" and sha256_of(folder / name) != sha256:
            found.fault("changed", name, "the file was changed after sealing")
