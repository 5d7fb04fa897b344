"""Repetitions of a comparison, kept in a file: one line for all columns that share their images.

After Ctrl-C, the same command continues. Whatever changes the program or a column makes its results again.
"""

import argparse
import hashlib
import sys
from collections import defaultdict
from collections.abc import Callable, Hashable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import measured

from bench.base.program import forms

from .columns import Column, read_comparison
from .methods import Row, rows_of
from .scenes import recordings_key
from .summary import table

Key = tuple[str, int, int, str]
"""Name of the comparison, group of columns, seed, and a hash of all that the result depends on."""


@lru_cache
def columns_here(comparison: str) -> tuple[Column, ...]:
    """Return the columns that can be measured here: those of strangers need a ray tracer, optiland."""
    columns = read_comparison(comparison).columns
    if find_spec("optiland") is None and any(column.collimator == "stranger" for column in columns):
        print("Left out: collimators of strangers. For them: pip install optiland", file=sys.stderr)
        columns = tuple(column for column in columns if column.collimator != "stranger")
    return columns


@lru_cache
def _groups(comparison: str) -> list[list[Column]]:
    """Return the columns that share their images."""
    by_recordings: dict[Hashable, list[Column]] = defaultdict(list)
    for column in columns_here(comparison):
        by_recordings[recordings_key(column)].append(column)
    return list(by_recordings.values())


def keys_of(comparison: str, repetitions: int) -> list[Key]:
    """Return what is to be done: repetition by repetition, so that a short run has some of every column."""
    program, first = forms()["program"], read_comparison(comparison).seed
    asked = [repr((columns, program)).encode() for columns in _groups(comparison)]
    digests = [hashlib.sha256(text).hexdigest()[:16] for text in asked]
    return [
        (comparison, group, first + repetition, digest)
        for repetition in range(repetitions)
        for group, digest in enumerate(digests)
    ]


def _do(*key: Any) -> dict[str, Any]:
    """Do one repetition of a group of columns."""
    comparison, group, seed, _ = key
    return {"key": key, "rows": rows_of(_groups(comparison)[group], seed)}


def _options(described: str | None, kept: str) -> argparse.Namespace:
    parser = measured.options(described)
    parser.add_argument("--repetitions", type=int)
    parser.add_argument("--kept", type=Path, default=Path(kept))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--ready", action="store_true", help="measure nothing: show what the file holds")
    parser.add_argument("--pictures", type=Path, help="the folder in which pictures are written")
    return parser.parse_args()


def _repeated(comparison: str, given: argparse.Namespace) -> list[list[Row]]:
    """Return the rows of each of `columns_here`; what the file does not hold yet is measured and added to it."""
    asked = keys_of(comparison, given.repetitions or read_comparison(comparison).repetitions)
    done = measured.kept(given.kept, lambda line: tuple(line["key"]))
    if not given.ready:
        measured.add_missing(given.kept, done, asked, _do, given.jobs)
    rows: dict[str, list[Row]] = defaultdict(list)
    for key in (wanted for wanted in asked if wanted in done):
        for name, row in done[key]["rows"].items():
            rows[name].append(row)
    return [rows[column.name] for column in columns_here(comparison)]


def compare(comparison: str, described: str | None, draw: Callable[..., None]) -> None:
    """Do a comparison as its benchmark's options say: print its table, and draw its pictures."""
    given = _options(described, f"{comparison}.jsonl")
    rows, columns = _repeated(comparison, given), columns_here(comparison)
    if given.pictures:
        draw(columns, rows, measured.origin(Path(sys.argv[0]).name), given.pictures)
    print(table(columns, rows))
