"""Verify a sealed folder: signature, files, authorisation, time stamps, journal.

The verifier writes nothing, trusts nothing in the folder, and reports all faults, not only the first one. The trusted
keys come from outside the folder. What needs the ledger, or the calibration engine for ``--again``, comes in as
callables (`Derivations`); so this package imports no engine.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.base.errors import RunFolderError, StorageError
from bench.evidence.faults import SealFault
from bench.evidence.findings import Derivation, Derivations, Findings, Verification
from bench.evidence.instructions import KINDS, kind_of
from bench.evidence.key_trust import Trust
from bench.evidence.signers import Signer
from bench.evidence.states import standing_of
from bench.evidence.verify_journal import check_journal
from bench.evidence.verify_seal import check_listed
from bench.records.captures import Capture
from bench.records.reading import read_json
from bench.records.run_folder import MANIFEST, RESULTS
from bench.records.storage import storage_errors

__all__ = ["Derivation", "Derivations", "Findings", "SealFault", "Verification", "verify_folder"]

UNREADABLE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""Exceptions raised by reading JSON that is not of the expected form."""


def verify_folder(
    folder: Path,
    trust: Trust | Iterable[Signer],
    *,
    now: datetime | None = None,
    at: datetime | None = None,
    camera_serial: str | None = None,
    derivations: Derivations | None = None,
    again: bool = False,
) -> Verification:
    """Check a sealed folder: a run, a certificate, recalculated results, or any other.

    The content of the folder tells its kind (`bench.evidence.instructions.kind_of`). ``derivations`` gives for each
    kind further checks: ``{"run": [...], "certificate": [check_certificate], ...}``. Each is called with the folder
    alone, and returns `Findings`; further arguments are bound beforehand, for example with `functools.partial`. They
    are called in their order, and only while no check has found a fault, so they may rely on the list of files.
    `bench.commands.verify` puts them together.

    trust: Whom the reader trusts, from `bench.evidence.key_trust.read_trust`; or trusted keys alone.
    now: The present time, with its time zone; None for that of the system.
    at: Moment for which the reader asks whether the keys were valid (``verify --at``), with its time zone. A
      trusted time stamp goes before it. None: the bench's own clock states when the folder was sealed.
    camera_serial: Serial number that the calibrated camera must have; None for any. It reveals a report of
      another camera.
    derivations: Further checks of each kind of folder; None: there are none.
    again: Whether they make the results again from the recordings; it is only stated.
    Returns: All faults, what was not compared, and remarks.
    Raises RunFolderError: When there is no such folder, or it is of none of these kinds.
    Raises StorageError: When a file cannot be read.
    """
    if not folder.is_dir() or not any((folder / name).exists() for name in (MANIFEST, *KINDS)):
        raise RunFolderError(
            "This is not a run folder, and no other folder that Starbench seals.",
            where=str(folder),
            remedy="Name the folder that a run, a certificate or recalculated results were written to.",
        )
    kind = kind_of(folder)
    found = Findings()
    trusted = trust if isinstance(trust, Trust) else Trust(tuple(trust))
    with storage_errors(folder):
        standing = standing_of(folder, trusted, now or datetime.now(UTC), at=at)
        found.faults += standing.faults
        found.not_compared += standing.unchecked
        found.remarks += standing.remarks
        manifest = check_listed(folder, found)
        captures = check_journal(folder, manifest, found) if kind == "run" and manifest is not None else None
        facts = _results(folder, manifest, captures, camera_serial, found)
        derive_with = (derivations or {}).get(kind, ())
        if derivations is not None and not derive_with:
            found.not_compared.append(f"nothing is known of the files of a folder of the kind {kind!r}")
        for derive in derive_with:
            if not found.faults:
                found.add(derive(folder))
    return Verification(
        folder=str(folder),
        kind=kind,
        again=again,
        faults=tuple(found.faults),
        not_compared=tuple(found.not_compared),
        remarks=tuple(found.remarks),
        state=str(standing.state),
        statements=tuple(standing.statements),
        stated=standing.stated.isoformat() if standing.stated else None,
        signer=standing.signer,
        fingerprint=standing.fingerprint,
        person=standing.person,
        person_fingerprint=standing.person_fingerprint,
        files=len(manifest or ()),
        run_id=facts.run_id,
        camera_serial=facts.camera_serial,
        simulated=facts.simulated,
    )


@dataclass(frozen=True)
class _ResultFacts:
    """Run and camera that results name, and the recordings they were made from."""

    run_id: str | None = None
    camera_serial: str | None = None
    simulated: bool | None = None
    captures: tuple[tuple[str, str], ...] = ()


_NO_RESULTS = _ResultFacts()


def _results(
    folder: Path,
    manifest: Mapping[str, str] | None,
    captures: Mapping[str, Capture] | None,
    camera_serial: str | None,
    found: Findings,
) -> _ResultFacts:
    """Check that results, journal and list of files name the same recordings; ``captures`` is None without journal."""
    path = folder / RESULTS
    if path.is_symlink() or not path.is_file():
        return _NO_RESULTS  # the journal tells whether a run must have results
    try:
        facts = _facts_of(read_json(path))
    except StorageError as error:
        found.fault("results", RESULTS, f"{error.what[0].lower()}{error.what[1:].rstrip('.')}")
        return _NO_RESULTS
    except UNREADABLE as error:
        found.fault(
            "results",
            RESULTS,
            f"the file cannot be read ({error if type(error) is ValueError else repr(error)})",
        )
        return _NO_RESULTS
    if captures is not None:
        sources: dict[str, Mapping[str, str]] = {"the journal": {n: c.sha256 for n, c in captures.items()}}
        sources |= {} if manifest is None else {MANIFEST: manifest}
        for name, sha256 in facts.captures:
            for source, hashes in sources.items():
                if hashes.get(name) != sha256:
                    found.fault("results", RESULTS, f"{source} does not name {name} with this hash")
    if camera_serial is not None and facts.camera_serial != camera_serial:
        what = f"the results belong to camera {facts.camera_serial}; {camera_serial} was requested"
        found.fault("item", RESULTS, what)
    return facts


def _facts_of(results: Any) -> _ResultFacts:
    """Read the results of a run or of a recalculation. Raises one of ``UNREADABLE``."""
    camera = results["devices"].get("camera") or {}
    serial = camera.get("serial")
    return _ResultFacts(
        run_id=str(results["run"]["id"]),
        camera_serial=None if serial is None else str(serial),
        simulated=bool(results["run"]["simulated"]),
        captures=tuple(
            (str(attempt["capture"]), str(attempt["sha256"]))
            for pose in results["poses"]
            for attempt in pose.get("attempts") or ()
            if attempt["capture"] is not None
        ),
    )
