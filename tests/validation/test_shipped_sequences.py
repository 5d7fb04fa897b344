"""What the shipped sequences promise, computed: the tag stays in the picture, and the uncertainties of the document.

The stock target stands before the paper's camera, at the collimator's radius.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from flat import flatten

from calib import CalibrationOptions, calibrate
from sequences.reader import read_document
from sequences.schema import Sequence
from sequences.script import RecordStep
from tests.unit.calib.conftest import TARGET, Bench, rotation

ROOT = Path(__file__).parents[2]
BENCH = Bench(
    centre=(*TARGET.tag_centre_mm, -255.0),
    half_angle_deg=11.3,  # stars at the very rim of the 12 degree beam are too dim
)
BORDER_PX = 15


def poses(name: str) -> list[list[float]]:
    """Pan, tilt and roll of each recording."""
    script = flatten(read_document(ROOT / "sequences" / f"{name}.yaml", Sequence))
    angles = [step.pose.angles_deg for step in script if isinstance(step, RecordStep)]
    return [[of_pose.get(axis, 0.0) for axis in ("pan", "tilt", "roll")] for of_pose in angles]


def promised(name: str) -> dict[str, float]:
    """The row of the document's table."""
    text = (ROOT / "docs" / "sequences.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| `{name}` \|(.*)\|$", text, re.MULTILINE)
    assert row, f"docs/sequences.md has no row for {name}"
    return dict(zip(("fx", "cx", "cy", "r"), map(float, row.group(1).split("|")), strict=True))


@pytest.mark.parametrize("name", ["three_pose", "nine_pose", "turntable"])
def test_the_whole_tag_with_its_margin_is_in_the_picture_at_every_pose(name):
    first, last = TARGET.tag_square[0] - 1.5, TARGET.tag_square[0] + TARGET.tag_squares - 0.5
    top, bottom = TARGET.tag_square[1] - 1.5, TARGET.tag_square[1] + TARGET.tag_squares - 0.5
    corners_mm = TARGET.pitch_mm * np.array([[first, top], [last, top], [last, bottom], [first, bottom]])
    for pose in poses(name):
        # a camera mounted half a degree off still sees it
        for pan, tilt in [(0.5, 0.5), (-0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)]:
            corners_px = BENCH.project(
                corners_mm, rotation(*pose) @ rotation(pan, tilt), np.array(BENCH.centre)
            )
            last_px = np.array(BENCH.size) - 1 - BORDER_PX
            assert ((corners_px >= BORDER_PX) & (corners_px <= last_px)).all(), pose


@pytest.mark.parametrize("name", ["three_pose", "nine_pose", "turntable"])
def test_the_uncertainties_in_the_document_are_those_the_engine_finds(name):
    views = BENCH.views(np.random.default_rng(1), 0.05, poses(name))
    calibration = calibrate(views, CalibrationOptions(model="spherical", loss="l2"))
    for key, sigma in promised(name).items():
        assert calibration.sigma[key] == pytest.approx(sigma, rel=0.2), key
        assert abs(calibration.values[key] - BENCH.truth[key]) < 4 * calibration.sigma[key]
