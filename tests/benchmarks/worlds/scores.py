"""The table of scores: coverage, rms of 2 error/U, largest error/U, errors and U, by world and knowledge."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Line = Mapping[str, Any]

WHAT = ("fx", "fy", "cx", "cy", "corner", "r")


def ratios(lines: Sequence[Line], what: str) -> np.ndarray:
    """Error over U of each result."""
    return np.array([abs(line["error"][what]) / line["U"][what] for line in lines])


def table(lines: Sequence[Line]) -> str:
    """The scores by world and knowledge as a table of docs/measured."""
    text = [
        "| world, stated | number | covered, %: fx fy cx cy corner r | RMS of 2 error / U | largest error / U | named as wrong | fx: error, U | cx | CPU: median, 95 % |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    lines = [line for line in lines if "refused" not in line]
    for key in sorted({(line["world"], line["known"]) for line in lines}):
        solved = [line for line in lines if (line["world"], line["known"]) == key]
        over = [ratios(solved, what) for what in WHAT]
        covered = " ".join(f"{100 * np.mean(ratios <= 1):.0f}" for ratios in over)
        rms = " ".join(f"{2 * np.sqrt(np.mean(ratios**2)):.2f}" for ratios in over)
        largest = max(float(ratios.max()) for ratios in over)
        sizes = [
            f"{np.quantile([abs(line['error'][what]) for line in solved], 0.95):.2f}, "
            f"{np.median([line['U'][what] for line in solved]):.2f} px"
            for what in ("fx", "cx")
        ]
        named = sum(len(line.get("accused", ())) for line in solved)
        cpu = "{:.1f}, {:.1f} s".format(*np.quantile([line["cpu_s"] for line in solved], [0.5, 0.95]))
        cells = ["`{}`, `{}`".format(*key), len(solved), covered, rms, f"{largest:.1f}", named, *sizes, cpu]
        text.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(text)
