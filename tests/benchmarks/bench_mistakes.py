"""Make the mistakes that people make: is the right cause named first, and is a healthy bench left alone?

    python tests/benchmarks/bench_mistakes.py -o FILE [--only WORD ...] [--seeds 3] [--healthy 100] [--table] [--told] [--page]

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
    parser.add_argument("--only", nargs="+", default=[""], help="those whose name holds one of these words")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds of each mistake")
    parser.add_argument("--healthy", type=int, default=100, help="number of benches without a mistake")
    parser.add_argument("--runs", action="store_true", help="whole runs instead of views")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--table", action="store_true", help="print the table of the file only")
    parser.add_argument("--told", action="store_true", help="print what is told of the first seed too")
    parser.add_argument("--page", action="store_true", help="write into docs/measured/mistakes.md")
    given = parser.parse_args()
    known, work = (RUN_MISTAKES, mistaken_run) if given.runs else (MISTAKES, mistaken)
    names = [name for name in known if any(word in name for word in given.only)]
    done = measured.kept(given.output, lambda line: (line["mistake"], line["seed"]))
    if not given.table:
        keys = [(name, seed) for seed in range(1, given.seeds + 1) for name in names]
        keys += [("healthy", HEALTHY + k) for k in range(given.healthy)]
        measured.add_missing(given.output, done, keys, work, given.jobs)
    print(f"{'mistake':42s} {'N':>3s} {'right':>5s} {'silent':>6s} {'wrong':>5s}")
    counts = {}
    for name in [*names, "healthy"]:
        lines = [line for (mistake, _), line in done.items() if mistake == name]
        right, wrong = (sum(line[what] for line in lines) for what in ("right", "wrong"))
        counts[name] = len(lines), right, len(lines) - right - wrong, wrong
        print("{:42s} {:3d} {:5d} {:6d} {:5d}".format(name, *counts[name]))
        for text in lines[0]["told"] if lines and given.told else ():
            print(f"      {text[:230]}")
    if given.page:
        write_counts("## Whole runs" if given.runs else "## Views and readings", counts)


def write_counts(heading: str, counts: dict[str, tuple[int, ...]]) -> None:
    """Replace the numbers at the ends of the rows of a section of the page, which name the mistakes."""
    mistakes = [own for name, own in counts.items() if name != "healthy"]
    totals = tuple(sum(column) for column in zip(*mistakes, strict=True))
    named = {**counts, "all": totals}
    page = measured.FOLDER / "mistakes.md"
    before, _, rest = page.read_text(encoding="utf-8").partition(heading)
    section, following, after = rest.partition("\n## ")
    rows = section.split("\n")
    for at, row in enumerate(rows):
        cells = row.strip("| ").split(" | ")
        name = "healthy" if cells[0].startswith("nothing: healthy") else cells[0].rstrip(" |")
        if name in named:
            rows[at] = "| " + " | ".join([*cells[:-4], *map(str, named[name])]) + " |"
    page.write_text(before + heading + "\n".join(rows) + following + after, encoding="utf-8")


if __name__ == "__main__":
    main()
