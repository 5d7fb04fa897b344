"""The states of many folders for a list: verified once, and again where a file that decides has changed.

The index of runs keeps only states that hold, SEALED and AUTHORISED, each with the identity of its files. Whoever can
write the index can make a list say what it likes, so nothing but a list uses it: `verify` reads all that it judges.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from datetime import datetime
from pathlib import Path

from cryptography.hazmat.primitives.serialization import Encoding

from bench.evidence.findings import State
from bench.evidence.key_trust import Trust
from bench.evidence.seal import AUTHORISATION, AUTHORISATION_TIMESTAMP, TIMESTAMP
from bench.evidence.states import home_trust, shown_state
from bench.record.run_folder import CERTIFICATE, JOURNAL, MANIFEST, RESULTS, SIGNATURE
from bench.record.run_index import COMMIT_EVERY, RunIndex

_OF_SEAL = (".", MANIFEST, SIGNATURE)
_OF_PERSON = (AUTHORISATION, AUTHORISATION_TIMESTAMP, TIMESTAMP, JOURNAL, RESULTS, CERTIFICATE)
"""Files from which it follows, with the trusted keys, whether a person may have authorised a seal."""
_NOTHING = ("", "")
_SETTLED_NS = 2_000_000_000
"""A file that changed so short a time ago may change again without another time: file systems count up to 2 s."""


def listed_states(
    sealed: Iterable[str], home: Path, now: datetime, progress: Callable[[int], object] = lambda _more: None
) -> dict[str, State]:
    """Return the states of folders that have a signature; ``progress`` is told how many more of them are judged."""
    index, trust = RunIndex(home), home_trust(home)
    trusted, settled_ns = _identity(trust), int(now.timestamp() * 1e9) - _SETTLED_NS
    stamps = {folder: _stamp(folder, trusted, settled_ns) for folder in sealed}
    kept = index.states(stamps)
    states = {
        folder: State(kept[folder][1])
        for folder, stamp in stamps.items()
        if stamp and kept.get(folder, _NOTHING)[0] == stamp
    }
    progress(len(states))
    changed = [folder for folder in stamps if folder not in states]
    for begin in range(0, len(changed), COMMIT_EVERY):
        some = changed[begin : begin + COMMIT_EVERY]
        judged = {folder: shown_state(Path(folder), trust, now).state for folder in some}
        index.keep_states(
            {f: (stamps[f], str(state)) for f, state in judged.items() if stamps[f] and _holds(f, state)}
        )
        states |= judged
        progress(len(some))
    return states


def _holds(folder: str, state: State) -> bool:
    """Return whether a state stays while no file changes: an authorisation that is not accepted may be so later."""
    return state is State.AUTHORISED or (
        state is State.SEALED and not os.path.lexists(f"{folder}/{AUTHORISATION}")
    )


def _stamp(folder: str, trusted: str, settled_ns: int) -> str:
    """Return the identity of the files that decide about a seal; empty if it cannot be told that they will change.

    ``st_ctime_ns`` is among it, which no program can set: a file that was replaced by one of the same size and time
    is noticed.
    """
    states = [_stat(f"{folder}/{name}") for name in _OF_SEAL]
    person = _stat(f"{folder}/{AUTHORISATION}")
    if person is not None:
        states += [person, *(_stat(f"{folder}/{name}") for name in _OF_PERSON[1:])]
    if any(state is not None and state.st_ctime_ns > settled_ns for state in states):
        return ""
    numbers = [(s.st_dev, s.st_ino, s.st_size, s.st_mtime_ns, s.st_ctime_ns) if s else None for s in states]
    return f"{numbers}{trusted if person else ''}"


def _stat(path: str) -> os.stat_result | None:
    try:
        return os.lstat(path)
    except OSError:
        return None


def _identity(trust: Trust) -> str:
    """Return what changes with the trusted keys and authorities."""
    authorities = (*trust.authorities.others, *trust.authorities.laboratory)
    parts = trust.signers, trust.revoked, [authority.public_bytes(Encoding.DER) for authority in authorities]
    return hashlib.sha256(repr(parts).encode()).hexdigest()
