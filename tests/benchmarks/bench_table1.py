"""Methods compared on the simulated bench, where the truth is known: Table 1 of arXiv:2512.16092 again.

    python tests/benchmarks/bench_table1.py [--of sweep] [--repetitions 3] [--kept FILE]

Each repetition records new event images of a star target or a board, and every method gets the same images. Results are
kept in a file, one line for all columns that share their images: after Ctrl-C, the same command continues. Whatever
changes the program or a column makes its results again. All 30 repetitions take 76 minutes of one core.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Hashable
from functools import lru_cache
from pathlib import Path
from typing import Any

import measured
from compared.columns import Column, read_comparison
from compared.methods import rows_of
from compared.scenes import recordings_key
from compared.summary import table

from bench.base.program import forms

Key = tuple[str, int, int, str]
"""Name of the comparison, group of columns, seed, and a hash of all that the result depends on."""


@lru_cache
def groups(comparison: str) -> list[list[Column]]:
    """Return the columns that share their images."""
    by_recordings: dict[Hashable, list[Column]] = defaultdict(list)
    for column in read_comparison(comparison).columns:
        by_recordings[recordings_key(column)].append(column)
    return list(by_recordings.values())


def keys(comparison: str, repetitions: int) -> list[Key]:
    """Return what is to be done: repetition by repetition, so that a short run has some of every column."""
    program, first = forms()["program"], read_comparison(comparison).seed
    digests = [
        hashlib.sha256(repr((columns, program)).encode()).hexdigest()[:16] for columns in groups(comparison)
    ]
    return [
        (comparison, group, first + repetition, digest)
        for repetition in range(repetitions)
        for group, digest in enumerate(digests)
    ]


def do(*key: Any) -> dict[str, Any]:
    """Do one repetition of a group of columns."""
    comparison, group, seed, _ = key
    return {"key": key, "rows": rows_of(groups(comparison)[group], seed)}


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("--of", default="table1", choices=("table1", "sweep"))
    parser.add_argument("--repetitions", type=int)
    parser.add_argument("--kept", type=Path, default=Path("table1.jsonl"))
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    asked = keys(given.of, given.repetitions or read_comparison(given.of).repetitions)
    done = measured.kept(given.kept, lambda line: tuple(line["key"]))
    measured.add_missing(given.kept, done, asked, do, given.jobs)
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for key in asked:
        for name, row in done[key]["rows"].items():
            rows[name].append(row)
    columns = read_comparison(given.of).columns
    print(table(columns, [rows[column.name] for column in columns]))


if __name__ == "__main__":
    measured.run(main, "comparison", "Table 1 again")
