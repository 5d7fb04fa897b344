"""Make the mistakes that people make: is the right cause named first, and is a healthy bench left alone?

    python tests/benchmarks/bench_mistakes.py -o FILE [--seeds 3] [--healthy 100]

Views and readings of drawn benches (`worlds.mistakes`), nine poses, a certificate and readings with a bound; with
--runs, whole runs on the simulated bench, each after a healthy one of the same bench (`worlds.mistaken_runs`). Each
result is a line of JSON; a later run goes on. Columns: results, right cause first (or refused with the right words, or
rightly none), silent, wrong cause first.
"""

from pathlib import Path

import measured
from worlds.mistaken_runs import RUN_MISTAKES, mistaken_run
from worlds.mistakes import MISTAKES, mistaken

#: Seeds of healthy benches begin here, so that none is also one with a mistake.
HEALTHY = 2000


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds of each mistake")
    parser.add_argument("--healthy", type=int, default=100, help="number of benches without a mistake")
    parser.add_argument("--runs", action="store_true", help="whole runs instead of views")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    known, work = (RUN_MISTAKES, mistaken_run) if given.runs else (MISTAKES, mistaken)
    done = measured.kept(given.output, lambda line: (line["mistake"], line["seed"]))
    keys = [(name, seed) for seed in range(1, given.seeds + 1) for name in known]
    keys += [("healthy", HEALTHY + k) for k in range(given.healthy)]
    measured.add_missing(given.output, done, keys, work, given.jobs)
    print(f"{'mistake':42s} {'N':>3s} {'right':>5s} {'silent':>6s} {'wrong':>5s}")
    for name in [*known, "healthy"]:
        lines = [line for (mistake, _), line in done.items() if mistake == name]
        right, wrong = (sum(line[what] for line in lines) for what in ("right", "wrong"))
        print(f"{name:42s} {len(lines):3d} {right:5d} {len(lines) - right - wrong:6d} {wrong:5d}")


if __name__ == "__main__":
    main()
