"""What this computer saw of other benches' ledgers when it merged them last: a ledger set back since then is noticed.

``ledgers_seen.json`` in the configuration folder holds one mark for each ledger. It helps where a ledger was set back
together with its bench's own mark. A missing file is no fault.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.history.ledger_sources import LedgerSource
from bench.records.ledger_breaks import breaks_of
from bench.records.ledger_marks import LedgerMark
from bench.records.reading import read_json
from bench.records.storage import make_folder, write_atomic

SEEN = "ledgers_seen.json"
_MOST_BYTES = 1 << 24


def compare_with_seen(home: Path, sources: Iterable[LedgerSource]) -> tuple[list[str], list[str]]:
    """Compare ledgers with what was seen of them before, and remember what is seen now.

    home: This computer's configuration folder.
    Returns: Why marks could not be read or written.
    """
    seen, notes = _read(home)
    faults = []
    before = dict(seen)
    for source in sources:
        if not source.entries:
            continue
        name, folder = source.entries[0].hash, str(source.folder.resolve())
        fault = _set_back(seen, source, name) or _replaced(before, source, name, folder)
        if fault:
            faults.append(fault)
            continue
        last = source.entries[-1]
        if len(source.entries) >= _lines(seen.get(name)):
            seen[name] = {"folder": folder, "lines": len(source.entries), "head": last.hash, "utc": last.utc}
    if seen != before:
        try:
            make_folder(home)
            write_atomic(home / SEEN, (json.dumps(seen, indent=1) + "\n").encode())
        except BenchError as error:
            notes.append(f"What was seen of the ledgers cannot be kept: {error}")
    return faults, notes


def _read(home: Path) -> tuple[dict[str, Any], list[str]]:
    path = home / SEEN
    if not path.exists():
        return {}, []
    try:
        found = read_json(path, _MOST_BYTES)
    except (BenchError, ValueError) as error:
        return {}, [f"{path} cannot be read, so ledgers are not compared with what was seen before: {error}"]
    if not isinstance(found, dict):
        return {}, [f"{path} has another form, so ledgers are not compared with what was seen before."]
    return {name: mark for name, mark in found.items() if _is_mark(mark)}, []


def _is_mark(mark: Any) -> bool:
    named = isinstance(mark, dict) and all(isinstance(mark.get(name), str) for name in ("head", "utc"))
    return named and _lines(mark) > 0


def _lines(mark: Any) -> int:
    lines = mark.get("lines") if isinstance(mark, dict) else 0
    return lines if isinstance(lines, int) and not isinstance(lines, bool) else 0


def _set_back(seen: dict[str, Any], source: LedgerSource, name: str) -> str:
    """Say how a ledger contradicts its mark; empty if it does not, or if a break of it explains that."""
    mark = seen.get(name)
    if mark is None:
        return ""
    disagreement = LedgerMark(mark["lines"], 0, mark["head"], mark["utc"]).disagreement(source.entries)
    excused = {head for one in breaks_of(source.entries) if one.reason is not None for head in one.heads}
    if not disagreement or mark["head"] in excused:
        return ""
    return (
        f"The ledger in {source.folder} {disagreement}; this computer saw them before. Ask who can write to that"
        f" bench's files. If the reason is known, delete the entry {name[:12]} from {SEEN} in the"
        " configuration folder here."
    )


def _replaced(before: dict[str, Any], source: LedgerSource, name: str, folder: str) -> str:
    """Say that a folder held another ledger before; empty if it did not."""
    others = [n for n, mark in before.items() if mark.get("folder") == folder and n != name]
    if not others or name in before:
        return ""
    return (
        f"The folder {source.folder} holds another ledger than before: it was deleted and begun again, or the folder"
        f" now belongs to another bench. If the reason is known, delete the entry {others[0][:12]} from {SEEN} in the"
        " configuration folder here."
    )
