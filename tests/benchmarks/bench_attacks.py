"""Make statements and data wrong, one at a time: is the result right within 1.3 U, or the wrong one named?

    python tests/benchmarks/bench_attacks.py -o FILE [--only WORD ...] [--seeds 5] [--jobs 1] [--table] [--notes]

Benches are those of the polynomial world whose lens needs k1 and k2 only. Each result is a line of JSON; a later run goes
on. Columns: results, right, not right but named, wrong and silent, refused with and without the right words; medians of
the error of fx over U and of the worst of fx, fy, cx, cy and corner; cases that nothing could show are marked.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import measured
import numpy as np
from worlds.attacks import ATTACKS, attacked
from worlds.polynomial import SEEDS


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--only", nargs="+", default=[""], help="attacks whose name holds one of these words")
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--table", action="store_true", help="print the table of the file only")
    parser.add_argument("--notes", action="store_true", help="print the notes of the first seed too")
    given = parser.parse_args()
    names = [name for name in ATTACKS if any(word in name for word in given.only)]
    done = measured.kept(given.output, lambda line: (line["attack"], line["seed"]))
    if not given.table:
        keys = [(name, seed) for seed in SEEDS[: given.seeds] for name in names]
        measured.add_missing(given.output, done, keys, attacked, given.jobs)
    print(
        f"{'attack':42s} {'N':>3s} {'right':>5s} {'named':>5s} {'SILENT':>6s} {'ref':>4s} {'fx/U':>6s} {'worst/U':>7s}"
    )
    silent = sum(
        show(name, [line for key, line in done.items() if key[0] == name], given.notes) for name in names
    )
    print(f"{silent} results are wrong and silent, of those that the bench could show")


def show(name: str, lines: list[dict[str, Any]], notes: bool) -> int:
    """Print a row; the number of results that are wrong and silent although something could show it."""
    solved = [line for line in lines if "refused" not in line]
    right = [line for line in solved if line["right"]]
    named = [line for line in solved if not line["right"] and line["named"]]
    refused = [line for line in lines if "refused" in line]
    unexplained = [line for line in refused if not line["named"]]
    silent = len(solved) - len(right) - len(named)
    fx = np.median([abs(line["error"]["fx"]) / line["U"]["fx"] for line in solved]) if solved else np.nan
    worst = np.median([line["worst"] for line in solved]) if solved else np.nan
    also = f" ({len(unexplained)} refused without the cause)" if unexplained else ""
    seen = "" if ATTACKS[name].seen else " (nothing could show it)"
    print(
        f"{name:42s} {len(lines):3d} {len(right):5d} {len(named):5d} {silent:6d} {len(refused):4d} {fx:6.2f} {worst:7.2f}{seen}{also}"
    )
    if notes and lines:
        for text in [*lines[0].get("notes", ()), lines[0].get("refused", "")]:
            print(f"      {text[:170]}")
    return silent + len(unexplained) if ATTACKS[name].seen else 0


if __name__ == "__main__":
    main()
