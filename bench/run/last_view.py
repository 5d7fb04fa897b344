"""The picture of the last recording, for people who watch a run from another process.

It is one file in ``control/`` of the run folder, no evidence: it is not synced, it is replaced with each
recording, and it goes with ``control/`` when the run ends. If it cannot be written, the run goes on
without it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bench.base.bounded_json import parse_json
from bench.base.errors import StorageError
from bench.record.storage import read_bounded
from bench.run.heartbeat import CONTROL
from drivers.new_output import TEMPORARY

if TYPE_CHECKING:
    from bench.measure.measure import Measurement
    from calib.target import StarTarget


LAST_VIEW = ".last-view"
_DIGITS = 3  # Thousandths of a pixel
_MOST_BYTES = 64 << 20  # A PNG of 16 Mpx and its stars


@dataclass(frozen=True)
class LastView:
    """The picture of a recording."""

    pose: int  # Number of the pose, from 1
    attempt: int  # Number of the attempt, from 1
    nodes: Sequence[Sequence[float]]
    points_px: Sequence[Sequence[float]]  # Place of each star, [x, y], px, to a thousandth
    fault: str  # Why no stars were found; empty if there are some
    png: bytes


def leave_view(folder: Path, pose: int, attempt: int, measurement: Measurement, target: StarTarget) -> None:
    """Leave the picture of a recording for others; nothing happens if there is no image or nobody can be told."""
    if measurement.image is None or not (folder / CONTROL).is_dir():
        return
    stars = (
        {"nodes": [], "points_px": []}
        if measurement.view is None
        else {
            "nodes": target.node_of(measurement.view.ids).tolist(),
            "points_px": measurement.view.points_px.round(_DIGITS).tolist(),
        }
    )
    head = json.dumps({"pose": pose, "attempt": attempt, "fault": measurement.fault, **stars})
    path = folder / CONTROL / LAST_VIEW
    part = path.with_name(f"{LAST_VIEW}{TEMPORARY}")
    with suppress(OSError):
        part.write_bytes(head.encode() + b"\n" + measurement.image.png)
        part.replace(path)


def read_last_view(folder: Path) -> LastView | None:
    """Read the picture of the last recording of a run in progress; None if there is none."""
    try:
        head, _, png = read_bounded(folder / CONTROL / LAST_VIEW, _MOST_BYTES).partition(b"\n")
        content = parse_json(head)
        return LastView(
            int(content["pose"]),
            int(content["attempt"]),
            [[float(column), float(row)] for column, row in content["nodes"]],
            [[float(x), float(y)] for x, y in content["points_px"]],
            str(content["fault"]),
            png,
        )
    except (StorageError, ValueError, KeyError, TypeError):
        return None
