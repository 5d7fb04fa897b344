"""Verify a sealed folder: signature, files, authorisation, time stamps, journal.

It writes nothing, trusts nothing in the folder, and reports all faults. Trusted keys come from outside the folder;
ledger and engine come in as callables (`Derivations`), so that this package imports no engine.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.base.bounded_json import canonical_json, parse_json
from bench.base.errors import EvidenceError, RunFolderError, StorageError
from bench.evidence.findings import UNREADABLE, Derivations, Findings, Verification
from bench.evidence.key_trust import Trust
from bench.evidence.seal import KINDS, NOT_LISTED, kind_of, list_files, read_manifest
from bench.evidence.signers import Signer
from bench.evidence.states import LARGEST_SEAL_BYTES, standing_of
from bench.record.events import Event
from bench.record.history import History
from bench.record.journal import (
    CAPTURES,
    CLOCK_JUMP_S,
    CLOCK_JUMPED,
    Capture,
    Entry,
)
from bench.record.run_folder import (
    CHECKED_COPY,
    EXPORTS,
    JOURNAL,
    MANIFEST,
    PASSPORT_COPY,
    PLAN,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    STATION_COPY,
)
from bench.record.storage import read_bounded, read_json, sha256_of, storage_errors
from bench.record.stored_run import StoredRun

_RUN_FILES = frozenset({RESULTS, REPORT, PLAN, SEQUENCE_COPY, STATION_COPY})
"""Files of runs; a folder that has them and no file of a kind is a run, or results, whose main file was removed."""
_EXPORTS = (
    r"exports/(opencv|ros_camera_info|kalibr_camchain|boresight)\.yaml|exports/mrcal\.cameramodel|exports/colmap_cameras\.txt"
    r"|exports/metavision\.json|exports/camera-geometry\.json|exports/not-written\.txt"
)
_RESULT_FILES = rf"results\.json|report\.html|views\.h5|passport\.json|VERIFY\.txt|{_EXPORTS}"
FILES = {
    "run": re.compile(
        rf"{_RESULT_FILES}|journal\.jsonl|sequence\.yaml|station\.yaml|checked-calibration|plan\.json|wire\.jsonl(\.[0-9]{{1,3}})?"
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
    """Check that a sealed folder has exactly its listed files; return SHA-256 by name, None without a list."""
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
    """Check a sealed folder: a run, a certificate, recalculated results, or any other (`bench.evidence.seal.kind_of`).

    ``derivations`` gives for each kind further checks, called in order with the folder alone, while no check has found
    a fault; they return `Findings`. ``trust`` comes from `read_trust`, or is trusted keys alone. ``now`` has its time
    zone, None for the system's; ``at`` is as for `standing_of`. ``camera_serial`` reveals a report of another camera.
    ``again`` is only stated.
    """
    if not folder.is_dir() or not any((folder / name).exists() for name in (MANIFEST, *KINDS)):
        raise RunFolderError(
            "This is not a run folder, and no other folder that Starbench seals.",
            where=str(folder),
            remedy="Name the folder that a run, a certificate or recalculated results were written to.",
        )
    kind = kind_of(folder)
    trusted = trust if isinstance(trust, Trust) else Trust(tuple(trust))
    with storage_errors(folder):
        found = standing_of(folder, trusted, now or datetime.now(UTC), at=at)
        found.kind, found.again = kind, again
        manifest = check_listed(folder, found)
        found.files = len(manifest or ())
        captures = check_journal(folder, manifest, found) if kind == "run" and manifest is not None else None
        _results(folder, manifest, captures, camera_serial, found)
        derive_with = (derivations or {}).get(kind, ())
        if derivations is not None and not derive_with:
            found.not_compared.append(f"nothing is known of the files of a folder of the kind {kind!r}")
        found.derive(folder, derive_with)
    return found


def _results(
    folder: Path,
    manifest: Mapping[str, str] | None,
    captures: Mapping[str, Capture] | None,
    camera_serial: str | None,
    found: Verification,
) -> None:
    """Take run and camera from the results, and check that journal and list of files name the same recordings.

    ``captures`` is None without a journal.
    """
    path = folder / RESULTS
    if path.is_symlink() or not path.is_file():
        return  # the journal tells whether a run must have results
    try:
        recordings = _read_facts(read_json(path), found)
    except StorageError as error:
        found.fault("results", RESULTS, f"{error.what[0].lower()}{error.what[1:].rstrip('.')}")
        return
    except UNREADABLE as error:
        found.fault(
            "results",
            RESULTS,
            f"the file cannot be read ({error if type(error) is ValueError else repr(error)})",
        )
        return
    if captures is not None:
        sources: dict[str, Mapping[str, str]] = {"the journal": {n: c.sha256 for n, c in captures.items()}}
        sources |= {} if manifest is None else {MANIFEST: manifest}
        for name, sha256 in recordings:
            for source, hashes in sources.items():
                if hashes.get(name) != sha256:
                    found.fault("results", RESULTS, f"{source} does not name {name} with this hash")
    if camera_serial is not None and found.camera_serial != camera_serial:
        what = f"the results belong to camera {found.camera_serial}; {camera_serial} was requested"
        found.fault("item", RESULTS, what)


def _read_facts(results: Any, found: Verification) -> list[tuple[str, str]]:
    """Take run and camera from results; return name and SHA-256 of each recording, or raise an ``UNREADABLE``."""
    serial = (results["devices"].get("camera") or {}).get("serial")
    run_id, simulated = str(results["run"]["id"]), bool(results["run"]["simulated"])
    recordings = [
        (str(attempt["capture"]), str(attempt["sha256"]))
        for pose in results["poses"]
        for attempt in pose.get("attempts") or ()
        if attempt["capture"] is not None
    ]
    found.run_id, found.simulated = run_id, simulated
    found.camera_serial = None if serial is None else str(serial)
    return recordings


# An attacker who holds the bench's key can write the whole chain again. The checks here then still find
# what he did not write consistently; `bench.solve.again` compares the journal with what the
# recordings give.

_WRITTEN = {RESULTS: "results", REPORT: "report", "views.h5": "views"}
"""Files that the report step writes, besides the exports, each with the kind of its faults."""
_CLOCK_SLACK_S = 0.05


def check_journal(folder: Path, manifest: Mapping[str, str], found: Findings) -> Mapping[str, Capture]:
    """Check a run's journal, and the files of the folder and of the seal's list against it."""
    path = folder / JOURNAL
    if path.is_symlink() or not path.is_file():
        found.fault("journal", JOURNAL, "the file is missing")
        return {}
    try:
        run = StoredRun(folder)
        entries, torn, captures, history = run.entries, run.torn, run.captures, run.history
    except RunFolderError as error:
        found.fault("journal", error.where.removeprefix(f"{folder}/") or JOURNAL, error.what)
        return {}
    if torn:
        found.fault("journal", JOURNAL, "its last line is incomplete")
        return captures
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        if json.dumps(parse_json(line), separators=(",", ":")).encode() != line:
            found.fault("journal", f"{JOURNAL}:{number}", "its JSON is not written as the program writes it")
            return captures
    _begin_and_end(entries, history, found)
    _clock(entries, found)
    _documents(manifest, history, found)
    _recordings(manifest, captures, entries, found)
    _written(folder, manifest, entries, found)
    return captures


def _begin_and_end(entries: Sequence[Entry], history: History, found: Findings) -> None:
    if not entries or entries[0].event != Event.RUN_STARTED:
        found.fault("journal", f"{JOURNAL}:1", "the first line does not begin a run (run_started)")
    again = [entry for entry in entries[1:] if entry.event == Event.RUN_STARTED]
    if again:
        found.fault("journal", f"{JOURNAL}:{again[0].seq + 1}", "a second line begins the run (run_started)")
    if not entries or entries[-1].event != Event.RUN_ENDED:
        found.fault(
            "journal",
            JOURNAL,
            "its last line does not end the run (run_ended); a bench seals ended runs only",
        )
    elif history.ended != "finished":
        found.fault(
            "journal", JOURNAL, f"the run {history.ended or 'did not end'}; a bench seals finished runs only"
        )


def _clock(entries: Sequence[Entry], found: Findings) -> None:
    """Compare both clocks from line to line; the journal has a line for each jump of the system's clock."""
    for last, entry in itertools.pairwise(entries):
        try:
            passed_s = (_moment(entry) - _moment(last)).total_seconds()
            jumped_s = passed_s - (entry.mono_s - last.mono_s)
            back = entry.mono_s < last.mono_s
        except (TypeError, ValueError):
            found.fault("journal", f"{JOURNAL}:{entry.seq + 1}", "its time cannot be read")
            return
        if entry.event == CLOCK_JUMPED:
            continue
        bound_s = CLOCK_JUMP_S + _CLOCK_SLACK_S
        other_process = entry.event == Event.RUN_RESUMED  # its monotonic clock may begin anew
        if passed_s < -bound_s if other_process else back or abs(jumped_s) > bound_s:
            what = "its time does not follow from the line before, and no line states that the clock jumped"
            found.fault("journal", f"{JOURNAL}:{entry.seq + 1}", what)
            return


def _moment(entry: Entry) -> datetime:
    return datetime.fromisoformat(entry.utc)


def _documents(manifest: Mapping[str, str], history: History, found: Findings) -> None:
    """Compare sequence, station, passport and plan with the hashes in the journal's first line."""
    stated = history.started.get("sha256")
    if not isinstance(stated, dict):
        found.fault("journal", f"{JOURNAL}:1", "it does not state the hashes of the run's documents")
        return
    for name in (SEQUENCE_COPY, STATION_COPY):
        if name not in stated:
            found.fault("journal", f"{JOURNAL}:1", f"it does not state the hash of {name}")
    for name, sha256 in stated.items():
        if name not in manifest:
            found.fault("plan", str(name), "the run began with this file; it is missing")
        elif manifest[name] != sha256:
            found.fault(
                "plan",
                str(name),
                "this is not the file that the run began with (hash in the journal's first line)",
            )
    without = {
        PASSPORT_COPY: "without a passport (the journal's first line names none)",
        CHECKED_COPY: "without it (the journal's first line does not name it)",
    }
    for name, what in without.items():
        if name in manifest and name not in stated:
            found.fault("plan", name, f"the run began {what}")
    if PLAN not in manifest:
        found.fault("plan", PLAN, "the file is missing")


def _recordings(
    manifest: Mapping[str, str], captures: Mapping[str, Capture], entries: Sequence[Entry], found: Findings
) -> None:
    """Compare the recordings in the folder with those that the journal names."""
    gone = {
        str(name)
        for entry in entries
        if entry.event == Event.RECOVERED
        for name in (*entry.data.get("missing", ()), *entry.data.get("changed", ()))
    }
    for name, capture in captures.items():
        if name not in manifest:
            if name not in gone:
                found.fault("recording", name, "the journal names this recording; it is missing")
        elif manifest[name] != capture.sha256:
            found.fault("recording", name, "the journal names this recording with another hash")
    for name in manifest:
        if name.startswith(f"{CAPTURES}/") and name not in captures:
            found.fault("recording", name, "the journal does not name this recording")


def _written(folder: Path, manifest: Mapping[str, str], entries: Sequence[Entry], found: Findings) -> None:
    """Compare results, report, views, exports and wire log with the journal's line that they were written."""
    written = [name for name in manifest if name in _WRITTEN or name.startswith(f"{EXPORTS}/")]
    if not _reported(entries):
        for name in written:
            found.fault("results", name, "the journal has no report step that wrote this file")
        return
    for name in _WRITTEN:
        if name not in manifest:
            found.fault("results", name, "the journal's report step wrote this file; it is missing")
    line = next((entry for entry in reversed(entries) if entry.event == Event.WRITTEN), None)
    if line is None:
        what = "it does not hold the hashes of results, report, views and exports"
        found.fault("journal", JOURNAL, f"{what}, though this version of the program writes them")
        return
    files = line.data.get("files")
    where = f"{JOURNAL}:{line.seq + 1}"
    if not isinstance(files, dict):
        found.fault("journal", where, "it does not state the files that were written")
        return
    for name, sha256 in files.items():
        if manifest.get(name) != sha256:
            what = "is missing" if name not in manifest else "is another file than the one that was written"
            found.fault(_WRITTEN.get(name, "exports"), str(name), f"by the journal, it {what}")
    for name in written:
        if name not in files:
            what = "the journal does not name it among the files that were written"
            found.fault(_WRITTEN.get(name, "exports"), name, what)
    _wire(folder, line.data.get("wire"), where, found)


def _reported(entries: Sequence[Entry]) -> bool:
    """Return whether the report step has ended without an error."""
    return any(
        entry.event == Event.LEFT_OFF and entry.data.get("state") == "reporting" and "error" not in entry.data
        for entry in entries
    )


def _wire(folder: Path, stated: Any, where: str, found: Findings) -> None:
    """Check that no wire log was changed after the results were written. It may only have grown."""
    if not isinstance(stated, dict):
        found.fault("journal", where, "it does not state the wire log")
        return
    for name, one in stated.items():
        try:
            size, sha256 = int(one["size"]), str(one["sha256"])
        except (KeyError, TypeError, ValueError):
            found.fault("journal", where, "it does not state the wire log")
            return
        stem, _, number = str(name).partition(".jsonl")
        rotated = (
            f"{stem}.jsonl.{int(number.lstrip('.') or 0) + 1}"
            if number.lstrip(".").isdigit() or not number
            else name
        )
        if sha256 not in {_hash_of_begin(folder / one_name, size) for one_name in (name, rotated)}:
            found.fault(
                "wire",
                str(name),
                "it does not begin with the bytes that it had when the results were written",
            )


def _hash_of_begin(path: Path, size: int) -> str:
    """Return the SHA-256 of the first bytes of a file; empty if it is shorter or missing."""
    if not path.is_file() or path.stat().st_size < size:
        return ""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        left = size
        while left and (block := file.read(min(left, 1 << 20))):
            digest.update(block)
            left -= len(block)
    return digest.hexdigest()
