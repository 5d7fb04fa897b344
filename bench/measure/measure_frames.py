"""From the frames of one pose to one view, and whether they are accepted: the recording of a frame camera.

Stars are detected in the mean of all frames, and in the mean of each half to check that the camera stood
still. Every number is calculated from the file alone, so that it can be calculated again from the
evidence.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bench.measure.gates import Gate, at_least, at_most
from bench.measure.measure import ExpectedGrid, Measurement, Observed, find_stars, measurement_of, motion_px
from calib.events.event_image import MOVING_PX
from calib.events.grey_image import to_uint8
from calib.stars.motion import Halves
from calib.stars.rim import downweight_vignetted
from calib.target import StarTarget
from calib.view import View
from drivers.camera.frames import FrameFacts, read_frames
from sequences.script import Gates

MOST_SATURATED: Final = 0.001
"""Largest share of pixels at the highest grey value. Some pixels are hot; but saturation displaces a star's edge."""


def measure_frames(
    path: Path, *, name: str, target: StarTarget, expected_grid: ExpectedGrid | None = None
) -> Measurement:
    """Read a pose's frames and find the stars; a fault instead if they are bad.

    Facts are ``image`` (``kind``, ``reason``, ``pictures``), ``motion_px``, and those of `find_stars`.
    """

    def find(seen: Observed) -> View:
        mean, halves = mean_frames(path, seen)
        view = find_stars(mean, target, name, expected_grid, seen.facts)
        seen.facts["motion_px"] = motion_px(halves, view, target)
        return downweight_vignetted(view, target)

    return measurement_of(find)


def mean_frames(path: Path, seen: Observed) -> tuple[NDArray[np.float32], Halves | None]:
    """Return the mean of all frames, and the means of both halves (None for one frame); keep and state it."""
    frames = read_frames(path)
    kind = f"mean of {len(frames)} pictures" if len(frames) > 1 else "picture"
    seen.facts["image"] = {"kind": kind, "reason": "", "pictures": len(frames)}
    half, mean = len(frames) // 2, _mean(frames)
    seen.keep(to_uint8(mean))
    return mean, (_mean(frames[:half]), _mean(frames[-half:])) if half else None


def frame_gates(facts: FrameFacts, gates: Gates, measurement: Measurement) -> list[Gate]:
    """Judge the frames of a pose; of the sequence's gates, those about stars apply."""
    judged = [
        at_least("stars", measurement.stars, gates.min_stars, ""),
        at_most("saturated pixels", 100 * facts.saturated_share, 100 * MOST_SATURATED, "%"),
    ]
    motion_px = measurement.facts.get("motion_px")
    if motion_px is not None:
        judged.append(at_most("stars moved", motion_px, gates.limits.get("max_motion_px", MOVING_PX), "px"))
    return judged


def frame_rejection_reasons(facts: FrameFacts) -> list[str]:
    """Return why frames are rejected, whatever they show."""
    return [] if facts.complete else ["fewer frames were recorded than asked for"]


def _mean(frames: NDArray[Any]) -> NDArray[np.float32]:
    return frames.mean(axis=0, dtype=np.float64).astype(np.float32)
