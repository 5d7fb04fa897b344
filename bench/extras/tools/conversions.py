"""Many event files converted into one folder: one piece of work each; what is done is known by its content.

A worker writes under a temporary name. The command keeps the row and then gives the file its name, so a
file with its name is complete, and its row says which bytes it was made of.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError, UsageError
from bench.base.failure import Failure
from bench.base.program import forms
from bench.record.storage import sha256_of, storage_errors
from bench.work.kept_rows import KeptRows, content_hash, require_program_of
from bench.work.workers import Finished, Workers, map_work
from drivers.camera.event_arrays import ReadingChoices
from drivers.camera.formats.event_conversion import ENDINGS, Kind, convert
from drivers.durable import sync_folder

CONVERTED = "converted.jsonl"
_PART = ".part-"


@dataclass(frozen=True)
class Converted:
    """The end of one conversion."""

    source: Path
    target: Path
    before: bool = False  # Whether an earlier command made it
    # What was written, as of ``ExportSummary``; None if it failed.
    summary: Mapping[str, Any] | None = None
    failure: Failure | None = None  # Why it failed; None if it did not


def plan_targets(sources: Sequence[Path], folder: Path, kind: Kind) -> list[tuple[Path, Path]]:
    """Return each source with its new file. Raises UsageError if two would have the same name."""
    pairs = [(source, folder / f"{source.stem}{ENDINGS[kind]}") for source in dict.fromkeys(sources)]
    taken: dict[Path, Path] = {}
    for source, target in pairs:
        if target in taken:
            raise UsageError(
                f"Two files would become {target.name}: {taken[target]} and {source}.",
                where=str(folder),
                remedy="Convert them into two folders.",
            )
        taken[target] = source
    return pairs


def convert_many(
    pairs: Sequence[tuple[Path, Path]],
    kind: Kind,
    workers: Workers,
    kept: KeptRows,
    ended: Callable[[Converted], None],
    choices: ReadingChoices | None = None,
) -> None:
    """Convert files. One that fails stops no other; ``choices`` say what the sources do not state themselves."""
    folder, program = kept.path.parent, forms()["program"]
    for left in (*folder.glob(f"{_PART}*"), *folder.glob(f".{_PART}*")):  # of a process that was killed
        left.unlink()
    rows = [kept.get(target.name) for _, target in pairs]
    work = (
        (source.absolute(), target.absolute(), kind, row, program, choices or ReadingChoices())
        for (source, target), row in zip(pairs, rows, strict=True)
    )
    for number, end in map_work(convert_one, work, workers):
        source, target = pairs[number]
        ended(_taken(source, target, end, kept))


def _taken(source: Path, target: Path, end: Finished, kept: KeptRows) -> Converted:
    if end.failure is not None:
        return Converted(source, target, failure=end.failure)
    row, before = end.value
    if not before:
        kept.add(target.name, row)
        with storage_errors(target):
            _part_of(target).rename(target)
            sync_folder(target.parent)
    return Converted(source, target, before=before, summary=row["summary"])


def convert_one(
    source: Path,
    target: Path,
    kind: Kind,
    known: Mapping[str, Any] | None,
    program: str,
    choices: ReadingChoices,
) -> tuple[dict[str, Any], bool]:
    """Convert one file, unless ``known`` is the row of an earlier conversion of it; also return whether it is."""
    require_program_of(program)
    with storage_errors(source):
        decided_by = {"source_sha256": content_hash(source), "kind": kind, **choices.as_json()}
    if target.exists():
        ours = known is not None and {**known, **decided_by} == known and sha256_of(target) == known["sha256"]
        if not ours:
            raise BenchError(
                "A file with this name exists, and it is not the conversion of this source.",
                where=str(target),
                remedy="Choose a new folder, or remove the file.",
            )
        if known is not None and known["program"] == program:
            return dict(known), True
    part = _part_of(target)
    part.unlink(missing_ok=True)  # of a worker that died
    written = convert(source, part, kind, choices)
    made = {"source": str(source), "sha256": sha256_of(part), "program": program, "summary": asdict(written)}
    return {**decided_by, **made}, False


def _part_of(target: Path) -> Path:
    return target.with_name(f"{_PART}{target.name}")
