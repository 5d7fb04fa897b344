"""Runs a comparison and keeps what is done: an interrupted comparison continues where it stopped. Others do its tasks.

``rows.jsonl`` has a line for each repetition of each column, used again for the same column, repetition, seed and
program.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from bench.base.bounded_json import parse_json, without_nan
from bench.base.errors import UsageError
from bench.base.home import forms
from bench.compare.spec import ColumnConfig, ComparisonConfig
from bench.records.storage import make_folder, storage_errors, whole_lines

if TYPE_CHECKING:
    from bench.compare.methods import FailedRow, Row
    from bench.compare.scenes import Images

ROWS = "rows.jsonl"
SPEC = "spec.yaml"

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Task:
    """The columns that share the images of one repetition."""

    columns: tuple[ColumnConfig, ...]
    seed: int


def row_key(column: ColumnConfig, seed: int) -> str:
    """Return the key of a repetition of a column: it changes with all that the result depends on, not its name."""
    described: list[Any] = [column.model_dump(exclude={"name"}, exclude_none=True), seed, forms()["program"]]
    if column.data is not None:
        from bench.compare.methods import data_digest

        described.append(data_digest(column.data))
    content = json.dumps(described, sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:24]


def compare(
    spec: ComparisonConfig,
    text: bytes,
    folder: Path,
    *,
    do_tasks: Callable[[Sequence[Task]], Iterator[Mapping[str, Row]]],
    on_progress: Callable[[int, int, float | None], None] = lambda *_: None,
    monotonic: Callable[[], float] = time.monotonic,
) -> dict[str, list[Row]]:
    """Run what is not done yet; return for each column one row for each repetition, in their order.

    ``do_tasks`` yields the rows of tasks in any order; ``on_progress`` gets rows done, all rows, and s left, if known.
    """
    _prepare(folder, text)
    done = _read_rows(folder / ROWS)
    keys = {
        (column.name, n): row_key(column, spec.seed + n)
        for column in spec.columns
        for n in range(spec.repetitions)
    }
    tasks = list(_tasks(spec, done))
    began, first, total = monotonic(), sum(key in done for key in keys.values()), len(keys)
    on_progress(first, total, None)
    with storage_errors(folder), (folder / ROWS).open("ab") as stream:
        for rows in do_tasks(tasks):
            for key, row in rows.items():
                stream.write((json.dumps({"key": key, **row}, allow_nan=False) + "\n").encode())
                done[key] = row
            stream.flush()
            os.fsync(stream.fileno())
            known = sum(key in done for key in keys.values())
            rate = (known - first) / max(monotonic() - began, 1e-6)
            on_progress(known, total, (total - known) / rate if rate else None)
    return {
        column.name: [done[keys[column.name, n]] for n in range(spec.repetitions)] for column in spec.columns
    }


def _prepare(folder: Path, text: bytes) -> None:
    """Make the folder, or check that it holds a comparison."""
    with storage_errors(folder):
        if folder.is_dir() and any(folder.iterdir()) and not (folder / SPEC).is_file():
            raise UsageError(
                "The folder holds something else.", where=str(folder), remedy="Choose a new or empty folder."
            )
    make_folder(folder)
    with storage_errors(folder):
        (folder / SPEC).write_bytes(text)


def _read_rows(path: Path) -> dict[str, Row]:
    """Return the rows that are known."""
    found = {}
    for line in whole_lines(path):
        row = parse_json(line)
        found[row.pop("key")] = row
    return found


def _tasks(spec: ComparisonConfig, done: dict[str, Row]) -> Iterator[Task]:
    """Yield what is to be done, repetition by repetition, so that a short run has some of every column."""
    from bench.compare.scenes import recordings_key

    for n in range(spec.repetitions):
        seed = spec.seed + n
        groups: dict[Any, list[ColumnConfig]] = {}
        for column in spec.columns:
            if row_key(column, seed) not in done:
                groups.setdefault(recordings_key(column), []).append(column)
        for columns in groups.values():
            yield Task(tuple(columns), seed)


def run_task(task: Task) -> dict[str, Row]:
    """Make the images of a task and apply the method of each of its columns."""
    began = time.process_time()
    rows, why = _guarded(lambda: _task_rows(task))
    if rows is not None:
        return rows
    failed: FailedRow = {
        "error": why,
        "views": 0,
        "missed": [],
        "images_cpu_s": time.process_time() - began,
    }
    return {row_key(column, task.seed): failed for column in task.columns}


def _guarded(work: Callable[[], _Result]) -> tuple[_Result | None, str]:
    """Return a result, or None with the reason: a fault of one repetition must not end a night of others."""
    from calib.errors import CalibrationError

    try:
        return work(), ""
    except CalibrationError as error:
        return None, str(error)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is named in the row
        return None, f"Unexpected {type(error).__name__}: {error}"


def _task_rows(task: Task) -> dict[str, Row]:
    """Return the rows of a task whose images can be made."""
    from bench.compare.methods import failed_row, solve
    from bench.compare.scenes import find_targets, finding_key, record

    if task.columns[0].data is not None:
        from bench.compare.methods import solve_data

        return {
            row_key(column, task.seed): without_nan(solve_data(column, task.seed)) for column in task.columns
        }
    began = time.process_time()
    recorded = record(task.columns[0], task.seed)
    record_cpu_s = time.process_time() - began
    found: dict[Any, tuple[Images, float]] = {}
    rows: dict[str, Row] = {}
    for column in task.columns:
        how = finding_key(column)
        if how not in found:
            began = time.process_time()
            images = find_targets(column, recorded)
            found[how] = images, record_cpu_s + time.process_time() - began
        images, images_cpu_s = found[how]
        solved, why = _guarded(partial(solve, column, images, images_cpu_s, task.seed))
        rows[row_key(column, task.seed)] = without_nan(solved or failed_row(images, images_cpu_s, why))
    return rows
