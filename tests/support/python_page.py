"""Run the code of docs/python.md below "A run", and write its output into the page.

starbench run three_pose --station simulated --seed 1 --output runs/demo
python tests/support/python_page.py FOLDER_OF_runs
"""

import contextlib
import io
import os
import re
import sys
import textwrap
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "python.md"
BLOCK = re.compile(r"(```python\n(.*?)```\n)(\n```text\n.*?```\n)?", re.DOTALL)
RUN = "## A run\n"
_WIDTH = 120


def written(text: str) -> str:
    """Return the page with the output of each block behind it; the blocks run in order in the current folder."""
    names: dict[str, object] = {}

    def run(block: re.Match[str]) -> str:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(block[2], PAGE.name, "exec"), names)
        if not printed.getvalue():
            return block[1]
        lines = [
            part
            for line in printed.getvalue().splitlines()
            for part in textwrap.wrap(
                line, _WIDTH, subsequent_indent="  ", drop_whitespace=False, break_on_hyphens=False
            )
        ]
        return block[1] + "\n```text\n" + "\n".join(line.rstrip() for line in lines) + "\n```\n"

    return BLOCK.sub(run, text)


if __name__ == "__main__":
    os.environ.setdefault("MPLBACKEND", "agg")
    os.chdir(sys.argv[1])
    views, heading, run = PAGE.read_text(encoding="utf-8").partition(RUN)
    PAGE.write_text(views + heading + written(run), encoding="utf-8")
