"""Errors by the number of images, the noise and the collimator: the comparison ``sweep``.

    python tests/benchmarks/bench_image_counts.py [--repetitions 3] [--jobs 2] [--pictures docs/pictures] [--kept FILE]

Results are kept in a file: after Ctrl-C, the same command continues, and ``--ready`` shows what is there.
"""

import measured
from compared.pictures import draw_image_counts
from compared.repetitions import compare


def main() -> None:
    compare("sweep", __doc__, draw_image_counts)


if __name__ == "__main__":
    measured.run(main, "comparison", "Number of images")
