"""Drawings of a reticle, read by other programs: the right areas at the right places, and every star with its id."""

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from align_browser import running_chromium
from scipy.spatial import cKDTree

from bench.stations.reticle_files import (
    GDS_CELL,
    GDS_OPAQUE,
    GDS_OUTLINE,
    OPAQUE_LAYER,
    OUTLINE_LAYER,
    drawing_file,
)
from bench.stations.station_fields import TargetConfig
from bench.stations.target_shapes import draw_target
from calib.stars.detect import detect_stars
from simulators.optics.outlines import black_polygons

PX_PER_MM = 8
SETTINGS = {"squares": (26, 24), "pitch_mm": 4.0138889, "tag_square": (11, 10), "serial": "r-0042"}
SETTINGS |= {"drawing": {"size_mm": (136, 128)}}
POSITIVE = TargetConfig(**SETTINGS)
NEGATIVE = TargetConfig(**SETTINGS, polarity="negative", tag_family="25h9")


def written(folder: Path, target: TargetConfig, ending: str) -> Path:
    path = folder / f"target{ending}"
    path.write_bytes(drawing_file(target, path))
    return path


def filled(target: TargetConfig, polygons: list[np.ndarray]) -> np.ndarray:
    """Return the picture of polygons in mm, Y up from the middle of the glass: what is filled is dark."""
    finer, width, height = 4 * PX_PER_MM, *target.size_mm
    picture = np.full((round(height * finer), round(width * finer)), 255, np.uint8)
    for polygon in polygons:
        at = (polygon * [1, -1] + [width / 2, height / 2]) * finer - 0.5
        cv2.fillPoly(picture, [np.rint(at * 256).astype(np.int32)], 0, cv2.LINE_8, 8)
    return cv2.resize(picture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)


def assert_every_star_is_found(picture: np.ndarray, target: TargetConfig, off_px: float = 0.1) -> None:
    pattern, drawing = target.pattern(), draw_target(target)
    seen = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0)
    seen += np.random.default_rng(1).normal(0.0, 6.0, seen.shape).astype(np.float32)
    detection = detect_stars(seen, pattern)
    assert detection.named_by == "tag"
    assert detection.view.ids.tolist() == pattern.ids.tolist()
    at_mm = pattern.positions_mm(pattern.ids) + drawing.offset_mm + np.array(target.size_mm) / 2
    assert np.abs(detection.view.points_px - (at_mm * PX_PER_MM - 0.5)).max() < off_px


def assert_black_print(polygons_mm: list[np.ndarray], target: TargetConfig) -> None:
    """Compare corners, Y up from the middle of the glass, with the black print of the simulated target."""
    pattern = target.pattern()
    expected = black_polygons(pattern)
    stars = len(pattern.ids) * pattern.segments // 2
    corners = (expected[:stars] + draw_target(target).offset_mm) * [1, -1]
    read = np.vstack(polygons_mm[:stars])
    assert len(read) == 3 * stars
    for some, others in ((read, corners.reshape(-1, 2)), (corners.reshape(-1, 2), read)):
        apart, _ = cKDTree(others).query(some)
        assert apart.max() < 2e-6  # mm: 0.002 um


@pytest.mark.parametrize(
    ("target", "units"), [(POSITIVE, "um"), (NEGATIVE, "mm"), (POSITIVE, "inch")], ids=["um", "mm", "inch"]
)
def test_gdstk_reads_the_gdsii_file(tmp_path, target, units):
    gdstk = pytest.importorskip("gdstk")
    target = target.model_copy(update={"drawing": target.drawing.model_copy(update={"units": units})})
    library = gdstk.read_gds(written(tmp_path, target, ".gds"))
    assert library.precision == pytest.approx(1e-9)
    (cell,) = library.top_level()
    assert cell.name == GDS_CELL
    scale = library.unit * 1e3
    opaque = [p.points * scale for p in cell.polygons if p.layer == GDS_OPAQUE]
    (edge,) = (p.points * scale for p in cell.polygons if p.layer == GDS_OUTLINE)
    assert np.ptp(edge, axis=0) == pytest.approx(target.size_mm, abs=2e-6)
    if target.polarity == "positive":
        assert_black_print(opaque, target)
    if units != "inch":
        assert_every_star_is_found(filled(target, opaque), target)


@pytest.mark.parametrize("target", [POSITIVE, NEGATIVE], ids=["positive", "negative"])
def test_ezdxf_reads_the_dxf_file(tmp_path, target):
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.readfile(written(tmp_path, target, ".dxf"))
    assert document.header["$INSUNITS"] == 4
    assert not document.audit().has_errors
    lines = list(document.modelspace().query("LWPOLYLINE"))
    assert all(line.closed for line in lines)
    opaque = [np.array(line.get_points("xy")) for line in lines if line.dxf.layer == OPAQUE_LAYER]
    (edge,) = (np.array(line.get_points("xy")) for line in lines if line.dxf.layer == OUTLINE_LAYER)
    assert np.ptp(edge, axis=0) == pytest.approx(target.size_mm, abs=1e-9)
    if target is POSITIVE:
        assert_black_print(opaque, target)
    assert_every_star_is_found(filled(target, opaque), target)


@pytest.mark.parametrize("target", [POSITIVE, NEGATIVE], ids=["positive", "negative"])
def test_poppler_reads_the_pdf_file(tmp_path, target):
    if shutil.which("pdftoppm") is None:
        pytest.skip("pdftoppm (poppler-utils) is not installed")
    path = written(tmp_path, target, ".pdf")
    width, height = (round(side * PX_PER_MM) for side in target.size_mm)
    scale = ["-r", str(PX_PER_MM * 25.4), "-scale-to-x", str(width), "-scale-to-y", str(height)]
    command = ["pdftoppm", "-gray", "-singlefile", *scale, str(path), str(tmp_path / "page")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stderr == ""
    size = subprocess.run(["pdfinfo", str(path)], capture_output=True, text=True, check=True).stdout
    points = [float(word) for word in size.split("Page size:")[1].split()[:3:2]]
    assert points == pytest.approx([side * 72 / 25.4 for side in target.size_mm], abs=0.01)
    picture = cv2.imread(str(tmp_path / "page.pgm"), cv2.IMREAD_GRAYSCALE)
    assert picture.shape == (height, width)
    assert_every_star_is_found(picture, target)


@pytest.mark.parametrize("target", [POSITIVE, NEGATIVE], ids=["positive", "negative"])
def test_chromium_reads_the_svg_file(tmp_path, target):
    path = written(tmp_path, target, ".svg")
    width, height = (round(side * PX_PER_MM) for side in target.size_mm)
    page = tmp_path / "page.html"
    style = f"position:absolute;left:0;top:0;width:{width}px;height:{height}px"
    page.write_text(f'<body style="margin:0"><img src="{path.name}" style="{style}">', encoding="utf-8")
    with running_chromium() as browser:
        tab = browser.new_page(viewport={"width": width, "height": height})
        tab.goto(page.as_uri())
        tab.screenshot(path=tmp_path / "shot.png")
    picture = cv2.imread(str(tmp_path / "shot.png"), cv2.IMREAD_GRAYSCALE)
    assert picture.shape == (height, width)
    assert_every_star_is_found(picture, target)
