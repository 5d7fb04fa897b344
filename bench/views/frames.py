"""From the frames of one pose to one view, and whether they are accepted: the recording of a frame camera.

Stars are detected in the mean of all frames, and in the mean of each half to check that the camera stood still. Every
number is calculated from the file alone, so that it can be calculated again from the evidence.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bench.records.events import MeasuredFacts
from bench.views.gates import Gate, at_least, at_most
from bench.views.measure import ExpectedGrid, Measurement, find_stars, motion_px
from bench.views.stored_image import StoredImage
from calib.errors import CalibrationError
from calib.events.motion import MOVING_PX
from calib.stars.vignetting import downweight_vignetted
from calib.target import StarTarget
from drivers.camera.frames import FrameFacts, read_frames
from drivers.errors import RecordingFileError
from sequences.script import Gates

MOST_SATURATED: Final = 0.001
"""Largest share of pixels at the highest grey value. Some pixels are hot; but saturation displaces a star's edge."""


def measure_frames(
    path: Path, *, name: str, target: StarTarget, expected_grid: ExpectedGrid | None = None
) -> Measurement:
    """Read the frames of a pose and find the stars in them.

    expected_grid: Predicts where the stars lie; used only if the tag does not label them.
    Returns: Also if the file cannot be read or shows no stars; then it holds the fault. Its facts are
      ``image`` (``kind``, ``reason``, ``pictures``), ``motion_px``, and those of `find_stars`.
    """
    facts: MeasuredFacts = {}
    image: StoredImage | None = None
    try:
        frames = read_frames(path)
        mean = _mean(frames)
        image = StoredImage.from_image(mean)
        kind = f"mean of {len(frames)} pictures" if len(frames) > 1 else "picture"
        facts["image"] = {"kind": kind, "reason": "", "pictures": len(frames)}
        view = downweight_vignetted(find_stars(mean, target, name, expected_grid, facts), target)
        half = len(frames) // 2
        halves = (_mean(part) for part in (frames[:half], frames[-half:]))
        facts["motion_px"] = motion_px(halves, target, facts) if half else None
    except (CalibrationError, RecordingFileError) as error:
        return Measurement(None, image, facts, str(error))
    return Measurement(view, image, facts)


def frame_gates(facts: FrameFacts, gates: Gates, found: Measurement) -> list[Gate]:
    """Judge the frames of a pose; of the sequence's gates, those about stars apply."""
    judged = [
        at_least("stars", found.stars, gates.min_stars, ""),
        at_most("saturated pixels", 100 * facts.saturated_share, 100 * MOST_SATURATED, "%"),
    ]
    motion_px = found.facts.get("motion_px")
    if motion_px is not None:
        judged.append(at_most("stars moved", motion_px, gates.limits.get("max_motion_px", MOVING_PX), "px"))
    return judged


def frame_rejection_reasons(facts: FrameFacts) -> list[str]:
    """Return why frames are rejected, whatever they show.

    Returns: Reasons; empty if there is none.
    """
    return [] if facts.complete else ["fewer frames were recorded than asked for"]


def _mean(frames: NDArray[Any]) -> NDArray[np.float32]:
    return frames.mean(axis=0, dtype=np.float64).astype(np.float32)
