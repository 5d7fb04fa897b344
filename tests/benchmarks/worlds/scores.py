"""The table of scores: coverage, rms of 2 error/U, largest error/U, errors and U, by groups of results."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

Line = Mapping[str, Any]

WHAT = ("fx", "fy", "cx", "cy", "corner", "r")
HEAD = (
    f"{'group':34s} {'N':>4s} {'ref':>3s} | {'covered, % of fx fy cx cy corner r':^32s} | "
    f"{'rms of 2 error/U':^29s} | {'largest error/U':^29s} | {'fx 95 %':>8s} {'U':>7s} {'U/95':>5s} | "
    f"{'cx 95 %':>7s} {'U':>6s} | {'cy 95 %':>7s} {'U':>6s} | {'corner':>7s} {'U':>6s} | {'CPU s':>6s}"
)


def ratios(lines: Sequence[Line], what: str) -> np.ndarray:
    """Error over U of each result."""
    return np.array([abs(line["error"][what]) / line["U"][what] for line in lines])


def row(name: str, lines: Sequence[Line]) -> str:
    """One row of the table; results that were refused count apart."""
    solved = [line for line in lines if "refused" not in line]
    start = f"{name:34.34s} {len(lines):4d} {len(lines) - len(solved):3d} | "
    if not solved:
        return start
    over = {what: ratios(solved, what) for what in WHAT}
    covered = " ".join(f"{100 * np.mean(over[what] <= 1):4.0f}" for what in WHAT)
    rms = " ".join(f"{2 * np.sqrt(np.mean(over[what] ** 2)):4.2f}" for what in WHAT)
    largest = " ".join(f"{over[what].max():4.1f}" for what in WHAT)
    error = {what: np.quantile([abs(line["error"][what]) for line in solved], 0.95) for what in WHAT}
    u = {what: np.median([line["U"][what] for line in solved]) for what in WHAT}
    cpu = np.median([line["cpu_s"] for line in solved])
    return (
        f"{start}{covered} | {rms} | {largest} | {error['fx']:8.2f} {u['fx']:7.2f} {u['fx'] / error['fx']:5.2f} | "
        f"{error['cx']:7.2f} {u['cx']:6.2f} | {error['cy']:7.2f} {u['cy']:6.2f} | "
        f"{error['corner']:7.3f} {u['corner']:6.3f} | {cpu:6.2f}"
    )


GROUPS: Mapping[str, Callable[[Line], Any]] = {
    "world": lambda line: line["world"],
    "poses": lambda line: line["poses_asked"],
    "known": lambda line: line["known"],
    "collimator": lambda line: line.get("design", ""),
    "poses as": lambda line: line.get("kind", ""),
    "lens": lambda line: line["lens"],
    "known, poses": lambda line: (line["known"], line["poses_asked"]),
    "known, lens": lambda line: (line["known"], line["lens"]),
    "world, known, poses": lambda line: (line["world"], line["known"], line["poses_asked"]),
}


def page(lines: Sequence[Line]) -> str:
    """The scores by world and knowledge as a table of docs/measured."""
    text = [
        "| world, stated | number | covered, %: fx fy cx cy corner r | RMS of 2 error / U | largest error / U | named as wrong | fx: error, U | cx | CPU: median, 95 % |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for key in sorted({(line["world"], line["known"]) for line in lines}):
        solved = [line for line in lines if (line["world"], line["known"]) == key and "refused" not in line]
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


def table(lines: Sequence[Line]) -> str:
    """The whole table: all results, then by groups, then the results farthest beyond U."""
    text = [HEAD, row("all", lines)]
    for name, of in GROUPS.items():
        for value in sorted({of(line) for line in lines}, key=str):
            label = " ".join(map(str, value)) if isinstance(value, tuple) else f"{name} {value}"
            text.append(row(label, [line for line in lines if of(line) == value]))
        text.append("")
    return "\n".join([*text, _lens(lines), *_worst(lines)])


def _lens(lines: Sequence[Line]) -> str:
    """The coefficients of the lens, of all results whose truth has them: error over U."""
    over: dict[str, list[float]] = {}
    for line in lines:
        for name, over_u in line.get("lens_over", {}).items():
            over.setdefault(name, []).append(abs(over_u))
    text = ["lens: covered, %; rms of 2 error/U; largest error/U"]
    for name, overs in over.items():
        ratio = np.array(overs)
        rms = 2 * np.sqrt(np.mean(ratio**2))
        text.append(
            f"  {name:5s} {len(ratio):4d} {100 * np.mean(ratio <= 1):4.0f} {rms:5.2f} {ratio.max():5.1f}"
        )
    return "\n".join(text)


def _worst(lines: Sequence[Line], count: int = 12) -> list[str]:
    """The results farthest beyond their U, and why benches were refused."""
    solved = [line for line in lines if "refused" not in line]
    far = sorted(solved, key=lambda line: -max(_over(line).values()))[:count]
    text = ["farthest beyond U:"]
    for line in far:
        over = _over(line)
        what = max(over, key=lambda name: over[name])
        text.append(
            f"  {line['world']} seed {line['seed']} poses {line['poses_asked']} {line['known']} {line['lens']} "
            f"{line['model']}: {what} {line['error'][what]:+.3f} +- {line['U'][what]:.3f} = {over[what]:.2f} U"
        )
    refused = [line for line in lines if "refused" in line]
    text += [
        f"refused: {line['world']} seed {line['seed']} poses {line['poses_asked']} {line['known']}: {line['refused'][:110]}"
        for line in refused[:count]
    ]
    return text


def _over(line: Line) -> dict[str, float]:
    return {what: abs(line["error"][what]) / line["U"][what] for what in WHAT}
