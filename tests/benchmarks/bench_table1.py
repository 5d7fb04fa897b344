"""Methods compared on the simulated bench, where the truth is known: Table 1 of arXiv:2512.16092 again.

    python tests/benchmarks/bench_table1.py [--repetitions 3] [--jobs 2] [--pictures docs/pictures] [--kept FILE]

Each repetition records new event images of a star target, a board or a box, and every method gets the same images.
Results are kept in a file: after Ctrl-C, the same command continues.
"""

from __future__ import annotations

from pathlib import Path

import measured
from compared.pictures import draw_errors
from compared.repetitions import columns_here, repeated
from compared.summary import table


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("--repetitions", type=int)
    parser.add_argument("--kept", type=Path, default=Path("table1.jsonl"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--pictures", type=Path, help="the folder in which two pictures are written")
    given = parser.parse_args()
    rows = repeated("table1", given.repetitions, given.kept, given.jobs)
    columns = columns_here("table1")
    if given.pictures:
        draw_errors(columns, rows, measured.origin("bench_table1.py"), given.pictures)
    print(table(columns, rows))


if __name__ == "__main__":
    measured.run(main, "comparison", "Table 1 again")
