"""Reads a rig of two cameras from a file: `rig.json`, or the `extrinsics.json` of Metavision SDK 5.

Nothing is calculated but the conventions; what a file does not state, such as a covariance, stays unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.base.bounded_json import parse_json
from bench.base.errors import BenchError
from bench.records.storage import read_bounded
from calib.model.rotation import exp_map

Array = NDArray[np.float64]

_MOST_BYTES = 20_000_000
_FARTHEST_MM = 1e6
_LARGEST_VARIANCE = 1e12
_OF_OTHER_FORM = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError)


class NotARig(BenchError):
    """A file does not hold one rig of two cameras that can be read."""


@dataclass(frozen=True)
class StatedRig:
    """A rig as a file states it: X_second = rotation X_first + translation."""

    rotation: Array  # (3, 3)
    translation_mm: Array | None  # (3,)
    # (6, 6) of rotation vector on the second camera's side, rad, and translation, mm; (3, 3) without translation.
    covariance: Array | None


def read_rig_file(path: Path) -> StatedRig:
    """Read the rig of a file, which must hold exactly one."""
    try:
        content = parse_json(read_bounded(path, _MOST_BYTES))
        stated = _of_sdk(content) if "T_slave_master" in content else _own(content)
        _require_possible(stated)
    except _OF_OTHER_FORM as error:
        what = (
            f"it has no {error}" if isinstance(error, KeyError) else str(error) or "its form is another one"
        )
        raise NotARig(
            f"This file does not hold a rig: {what}.",
            where=str(path),
            remedy="Known are rig.json of this command, and extrinsics.json of the Metavision SDK.",
        ) from error
    return stated


def _of_sdk(content: Any) -> StatedRig:
    entries = content["T_slave_master"]
    if len(entries) != 1:
        raise ValueError(f"it states {len(entries)} cameras beside the master, not one")
    turn = np.array(entries[0]["rvec"], np.float64).reshape(3)
    return StatedRig(
        exp_map(turn[None])[0], 1000.0 * np.array(entries[0]["tvec"], np.float64).reshape(3), None
    )


def _own(content: Any) -> StatedRig:
    turn = np.deg2rad(np.array(content["vector_deg"], np.float64).reshape(3))
    moved = content["translation"]
    size = 3 if moved is None else 6
    return StatedRig(
        exp_map(turn[None])[0],
        None if moved is None else np.array(moved, np.float64).reshape(3),
        np.array(content["pose_covariance"], np.float64).reshape(size, size),
    )


def _require_possible(stated: StatedRig) -> None:
    if not np.isfinite(stated.rotation).all():
        raise ValueError("its rotation is not finite")
    moved = stated.translation_mm
    if moved is not None and not (np.abs(moved) <= _FARTHEST_MM).all():
        raise ValueError("its translation is not a distance on a rig")
    known = stated.covariance
    if known is not None and not (
        (np.abs(known) <= _LARGEST_VARIANCE).all() and np.linalg.eigvalsh(known)[0] >= -1e-9 * np.trace(known)
    ):
        raise ValueError("its covariance is impossible")
