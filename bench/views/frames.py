"""From the pictures of one pose to one view, and whether they may count: what a frame camera's recording shows.

The stars are looked for in the mean of all pictures, and in the mean of each half, to see that the camera stood
still. Every number is made from the file alone, so that it can be made again from the evidence.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bench.records.events import MeasuredFacts
from bench.views.gates import Gate, at_least, at_most
from bench.views.measure import ExpectedGrid, Measurement, StoredImage, find_stars, motion_px
from calib.errors import CalibrationError
from calib.events.motion import MOVING_PX
from calib.stars.vignetting import downweight_vignetted
from calib.target import StarTarget
from drivers.camera.frames import FrameFacts, read_frames
from drivers.errors import RecordingFileError
from sequences.script import Gates

MOST_SATURATED: Final = 0.001
"""Share of pixels that may be at the highest grey value: some are hot, but the edge of a star that is clipped moves."""


def measure_frames(
    path: Path, *, name: str, target: StarTarget, expect: ExpectedGrid | None = None
) -> Measurement:
    """Read the pictures of a pose and find the stars in them.

    Parameters
    ----------
    path
        File of one picture or several.
    name
        The pose's name.
    target
        The printed target.
    expect
        Where the pose lets the stars be expected; asked only where the tag does not tell which they are.

    Returns
    -------
    Measurement
        Also when the file cannot be read or no stars are found: the fault then says why. Its facts are ``image``
        (``kind``, ``reason``, ``pictures``), ``motion_px``, and what named the stars (`find_stars`).
    """
    facts: MeasuredFacts = {}
    picture: StoredImage | None = None
    try:
        frames = read_frames(path)
        mean = _mean(frames)
        picture = StoredImage.from_image(mean)
        kind = f"mean of {len(frames)} pictures" if len(frames) > 1 else "picture"
        facts["image"] = {"kind": kind, "reason": "", "pictures": len(frames)}
        view = downweight_vignetted(find_stars(mean, target, name, expect, facts), target)
        half = len(frames) // 2
        halves = (_mean(part) for part in (frames[:half], frames[-half:]))
        facts["motion_px"] = motion_px(halves, target, facts) if half else None
    except (CalibrationError, RecordingFileError) as error:
        return Measurement(None, picture, facts, str(error))
    return Measurement(view, picture, facts)


def frame_gates(facts: FrameFacts, gates: Gates, found: Measurement) -> list[Gate]:
    """Judge the pictures of a pose; of the sequence's gates, those that tell of stars apply.

    Parameters
    ----------
    facts
        What the driver states of the capture.
    gates
        What the sequence demands.
    found
        What the pictures showed.
    """
    judged = [
        at_least("stars", found.stars, gates.min_stars, ""),
        at_most("saturated pixels", 100 * facts.saturated_share, 100 * MOST_SATURATED, "%"),
    ]
    motion_px = found.facts.get("motion_px")
    if motion_px is not None:
        judged.append(at_most("stars moved", motion_px, gates.limits.get("max_motion_px", MOVING_PX), "px"))
    return judged


def frame_rejection_reasons(facts: FrameFacts) -> list[str]:
    """Say why pictures do not count, whatever they show; empty when they do."""
    return [] if facts.complete else ["the pictures ended before their number"]


def _mean(frames: NDArray[Any]) -> NDArray[np.float32]:
    return frames.mean(axis=0, dtype=np.float64).astype(np.float32)
