"""Tables of docs/measured, each written by the benchmark that measures it.

A benchmark ends with ``measured.run(main, PAGE, TITLE)``. With ``--write`` on its command line, what it prints also
replaces the table below ``## TITLE`` in docs/measured/PAGE.md, with a line above it: the command, the commit, the date.
What stands between the heading and this line (what is measured, and how to read it) stays.
"""

from __future__ import annotations

import contextlib
import io
import re
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "measured"
ORIGIN = "Measured by `"


class _Tee(io.StringIO):
    """A text that is kept, and that is printed at once too."""

    def __init__(self, printed: TextIO) -> None:
        super().__init__()
        self.printed = printed

    def write(self, text: str) -> int:
        """See `io.StringIO.write`."""
        self.printed.write(text)
        return super().write(text)

    def flush(self) -> None:
        """See `io.StringIO.flush`."""
        self.printed.flush()


def run(main: Callable[[], int | None], page: str, title: str) -> None:
    """Run a benchmark and exit with its status. With ``--write``, write what it printed; not if it failed."""
    words = [word for word in sys.argv[1:] if word != "--write"]
    wanted = len(words) < len(sys.argv) - 1
    sys.argv[1:] = words
    kept = _Tee(sys.stdout)
    with contextlib.redirect_stdout(kept) if wanted else contextlib.nullcontext():
        status = main()
    if wanted and not status:
        program = Path(sys.argv[0]).resolve().relative_to(ROOT).as_posix()
        write(page, title, kept.getvalue(), " ".join(("python", program, *words)))
    sys.exit(status)


def write(page: str, title: str, table: str, command: str, folder: Path = FOLDER) -> None:
    """Replace the table below ``## title`` of a page. A heading that is missing is added at the end of the page."""
    path = folder / f"{page}.md"
    text = path.read_text(encoding="utf-8") if path.exists() else f"# Measured: {page}\n"
    heading = f"\n## {title}\n"
    if heading not in text:
        text += heading
    before, _, rest = text.partition(heading)
    section, following = re.match(r"(.*?)(\n## .*|\Z)", rest, re.DOTALL).groups()  # type: ignore[union-attr]
    words = section.partition(ORIGIN)[0].strip("\n")
    shown = table.strip("\n")
    if not shown.startswith("|"):
        shown = f"```text\n{shown}\n```"
    parts = [part for part in (words, _origin(command), shown) if part]
    path.parent.mkdir(exist_ok=True)
    path.write_text(before + heading + "\n" + "\n\n".join(parts) + "\n" + following, encoding="utf-8")


def _origin(command: str) -> str:
    commit = _git("rev-parse", "--short=8", "HEAD")
    changed = " with changes" if _git("status", "--porcelain", "--untracked-files=no") else ""
    return f"{ORIGIN}{command}`, commit {commit}{changed}, {datetime.now(UTC).date().isoformat()}."


def _git(*words: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=True)
    return done.stdout.strip()
