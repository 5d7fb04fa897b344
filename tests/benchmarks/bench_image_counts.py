"""Errors by the number of images, the noise and the collimator: the comparison ``sweep``.

    python tests/benchmarks/bench_image_counts.py [--repetitions 3] [--jobs 2] [--pictures docs/pictures] [--kept FILE]

Results are kept in a file: after Ctrl-C, the same command continues.
"""

from __future__ import annotations

from pathlib import Path

import measured
from compared.pictures import draw_image_counts
from compared.repetitions import columns_here, repeated
from compared.summary import table


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("--repetitions", type=int)
    parser.add_argument("--kept", type=Path, default=Path("image_counts.jsonl"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--pictures", type=Path, help="the folder in which the picture is written")
    given = parser.parse_args()
    rows = repeated("sweep", given.repetitions, given.kept, given.jobs)
    columns = columns_here("sweep")
    if given.pictures:
        draw_image_counts(columns, rows, measured.origin("bench_image_counts.py"), given.pictures)
    print(table(columns, rows))


if __name__ == "__main__":
    measured.run(main, "comparison", "Number of images")
