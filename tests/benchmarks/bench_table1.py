"""Methods compared on the simulated bench, where the truth is known: Table 1 of arXiv:2512.16092 again.

    python tests/benchmarks/bench_table1.py [--repetitions 3] [--jobs 2] [--pictures docs/pictures] [--kept FILE]

Each repetition records new event images of a star target, a board or a box, and every method gets the same images.
Results are kept in a file: after Ctrl-C, the same command continues, and ``--ready`` shows what is there.
"""

import measured
from compared.pictures import draw_errors
from compared.repetitions import compare


def main() -> None:
    compare("table1", __doc__, draw_errors)


if __name__ == "__main__":
    measured.run(main, "comparison", "Table 1 again")
