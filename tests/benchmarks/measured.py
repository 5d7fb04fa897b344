"""What benchmarks share; above all, tables of docs/measured, each written by the benchmark that measures it.

Whoever imports this module before numpy has linear algebra on one thread (on small matrices, threads cost more than they
gain), and finds the modules of this checkout and of tests/support.

A benchmark ends with ``measured.run(main, PAGE, TITLE)``. With ``--write`` on its command line, what it prints also
replaces the table below ``## TITLE`` in docs/measured/PAGE.md, with a line above it: the command, the commit, the date.
What stands between the heading and this line (what is measured, and how to read it) stays.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT), str(ROOT / "tests" / "support"), str(ROOT / "tests" / "extras" / "support")]
FOLDER = ROOT / "docs" / "measured"
ORIGIN = "Measured by `"
_WRITE = "--write"


def options(described: str | None) -> argparse.ArgumentParser:
    """Return the parser of a benchmark's options; its description is the head of the module."""
    return argparse.ArgumentParser(
        description=described, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def seeds(text: str) -> range:
    """Read seeds: first-last, or one seed."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def kept(path: Path | None, key: Callable[[dict[str, Any]], Hashable]) -> dict[Any, dict[str, Any]]:
    """Read the results that a file holds, one a line, by their keys; none if there is no such file."""
    texts = path.read_text(encoding="utf-8").splitlines() if path and path.exists() else []
    return {key(line): line for line in map(json.loads, texts)}


def add_missing(
    path: Path, done: dict[Any, dict[str, Any]], keys: Iterable[Any], work: Callable[..., Any], jobs: int
) -> None:
    """Do the work of each key that is not done yet, and add its result to the file, so that nothing is lost."""
    with path.open("a") as file, ProcessPoolExecutor(jobs) as pool:
        running = {pool.submit(work, *key): key for key in keys if key not in done}
        for future in as_completed(running):
            try:
                line = future.result()
            except ArithmeticError as error:  # glass through which a ray of this bench does not get
                print("not drawn:", *running[future], error, file=sys.stderr)
                continue
            done[running[future]] = line
            file.write(json.dumps(line, ensure_ascii=False) + "\n")
            file.flush()


class Spread(NamedTuple):
    """Times of the same work, s: what half of them do not exceed, and what 95 of 100 do not."""

    median_s: float
    p95_s: float

    def __truediv__(self, parts: float) -> Spread:
        """Return the times of one of some equal parts of the work."""
        return Spread(self.median_s / parts, self.p95_s / parts)

    def cells(self, digits: int) -> str:
        """Return both as two cells of a table."""
        return f"{self.median_s:.{digits}f} s | {self.p95_s:.{digits}f} s"

    def text(self, digits: int) -> str:
        """Return both in words."""
        return f"{self.median_s:.{digits}f} s, 95 %: {self.p95_s:.{digits}f} s"


def spread(times_s: Iterable[float]) -> Spread:
    """Return the spread of some times, s; between two of them it is interpolated."""
    return Spread(*np.percentile(list(times_s), (50, 95)).tolist())


def cpu_times(rounds: int, work: Callable[[], object]) -> Spread:
    """Do some work once, and then in rounds whose CPU time is taken."""
    work()
    times = []
    for _ in range(rounds):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return spread(times)


def run(main: Callable[[], int | None], page: str, title: str) -> None:
    """Run a benchmark and exit with its status. With ``--write``, write what it prints; not if it failed."""
    words = [word for word in sys.argv[1:] if word != _WRITE]
    wanted = len(words) < len(sys.argv) - 1
    sys.argv[1:] = words
    kept = io.StringIO()
    with contextlib.redirect_stdout(kept) if wanted else contextlib.nullcontext():
        status = main()
    if wanted and not status:
        program = Path(sys.argv[0]).resolve().relative_to(ROOT).as_posix()
        shown = ["PATH" if Path(word).is_absolute() else word for word in words]  # a folder of this computer
        write(page, title, kept.getvalue(), " ".join(("python", program, *shown)))
    sys.exit(status)


def write(page: str, title: str, table: str, command: str) -> None:
    """Replace the table below ``## title`` of a page."""
    path, heading = FOLDER / f"{page}.md", f"\n## {title}\n"
    before, _, rest = path.read_text(encoding="utf-8").partition(heading)
    section, following = re.match(r"(.*?)(\n## .*|\Z)", rest, re.DOTALL).groups()  # type: ignore[union-attr]
    words = section.partition(ORIGIN)[0].strip("\n")
    shown = table.strip("\n")
    if not shown.startswith("|"):
        shown = f"```text\n{shown}\n```"
    parts = [part for part in (words, origin(command), shown) if part]
    path.write_text(before + heading + "\n" + "\n\n".join(parts) + "\n" + following, encoding="utf-8")


def origin(command: str) -> str:
    """Return the line above a table: the command, the commit, the date."""
    commit = _git("rev-parse", "--short=8", "HEAD")
    changed = " with changes" if _git("status", "--porcelain", "--untracked-files=no") else ""
    return f"{ORIGIN}{command}`, commit {commit}{changed}, {datetime.now(UTC).date().isoformat()}."


def _git(*words: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=True)
    return done.stdout.strip()
