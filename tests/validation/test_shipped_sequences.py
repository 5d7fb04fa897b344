"""What the shipped sequences promise, computed: the tag stays in the picture, and the uncertainties of the document.

The geometry here is its own: a pinhole with distortion, turned by the sequence's angles, in front of the stock
target at the paper's focal length and the collimator's radius.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from flat import flatten

from calib import CalibrationOptions, StarTarget, View, calibrate
from sequences.reader import read_document
from sequences.schema import Sequence
from sequences.script import RecordStep

ROOT = Path(__file__).parents[2]
TARGET = StarTarget()
SIZE = (1280, 720)
FX, FY, CX, CY, K1, K2 = 3345.06, 3345.27, 642.10, 363.32, 0.06, -0.90
CENTRE_MM = (24 * TARGET.pitch_mm, 35 * TARGET.pitch_mm, -255.0)
BEAM_DEG = 11.3  # stars at the very rim of the 12 degree beam are too dim
BORDER_PX = 15
NOISE_PX = 0.05


def poses(name: str) -> list[dict[str, float]]:
    script = flatten(read_document(ROOT / "sequences" / f"{name}.yaml", Sequence))
    return [dict(step.pose.angles_deg) for step in script if isinstance(step, RecordStep)]


def turned(angles_deg: dict[str, float]) -> np.ndarray:
    """R = Rz(roll) Rx(tilt) Ry(pan), camera from target."""
    pan, tilt, roll = (np.radians(angles_deg.get(axis, 0.0)) for axis in ("pan", "tilt", "roll"))
    ry = np.array([[np.cos(pan), 0, np.sin(pan)], [0, 1, 0], [-np.sin(pan), 0, np.cos(pan)]])
    rx = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    rz = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    return rz @ rx @ ry


def image_of(target_mm: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    rays = (np.column_stack([target_mm, np.zeros(len(target_mm))]) - CENTRE_MM) @ rotation.T
    x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
    r2 = x**2 + y**2
    bent = 1 + K1 * r2 + K2 * r2**2
    return np.column_stack([FX * x * bent + CX, FY * y * bent + CY])


def in_picture(points_px: np.ndarray) -> np.ndarray:
    return ((points_px >= BORDER_PX) & (points_px <= np.array(SIZE) - 1 - BORDER_PX)).all(axis=1)


def view(name: str, rotation: np.ndarray, noise: np.random.Generator) -> View:
    ids = TARGET.ids
    target_mm = TARGET.positions_mm(ids)
    points_px = image_of(target_mm, rotation)
    off_axis = np.hypot(*(target_mm - CENTRE_MM[:2]).T)
    seen = in_picture(points_px) & (off_axis < -CENTRE_MM[2] * np.tan(np.radians(BEAM_DEG)))
    points_px = points_px[seen] + noise.normal(0, NOISE_PX, (seen.sum(), 2))
    covariances = np.tile(NOISE_PX**2 * np.eye(2), (seen.sum(), 1, 1))
    return View(name, SIZE, ids[seen], points_px, target_mm[seen], covariances)


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
    for angles_deg in poses(name):
        # a camera mounted half a degree off still sees it
        for pan, tilt in [(0.5, 0.5), (-0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)]:
            rotation = turned(angles_deg) @ turned({"pan": pan, "tilt": tilt})
            assert in_picture(image_of(corners_mm, rotation)).all(), angles_deg


@pytest.mark.parametrize("name", ["three_pose", "nine_pose", "turntable"])
def test_the_uncertainties_in_the_document_are_those_the_engine_finds(name):
    noise = np.random.default_rng(1)
    views = [view(f"pose {i}", turned(angles_deg), noise) for i, angles_deg in enumerate(poses(name))]
    calibration = calibrate(views, CalibrationOptions(model="spherical", loss="l2"))
    for key, sigma in promised(name).items():
        assert calibration.sigma[key] == pytest.approx(sigma, rel=0.2), key
    truth = {"fx": FX, "fy": FY, "cx": CX, "cy": CY, "r": -CENTRE_MM[2]}
    values = calibration.values
    assert all(abs(values[key] - true) < 4 * calibration.sigma[key] for key, true in truth.items())
