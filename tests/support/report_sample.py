"""A made-up run, complete enough for every part of a report; not a test."""

import json
from pathlib import Path

import cv2
import numpy as np

from bench.measure.view_picture import ViewPicture
from bench.record.stored_run import results_of
from bench.report.html import ReportData
from calib import CameraModel, StarTarget
from calib.model.result_parts import Boresight
from calib.model.rotation import exp_map

RESULTS = Path(__file__).with_name("report_results.json")
"""results.json of the made-up run, without what follows from its views."""
STORED = json.loads(RESULTS.read_bytes())
TRUE, COLLIMATOR = STORED["truth"]["camera"], STORED["truth"]["collimator"]
SIGMA = STORED["calibration"]["sigma"]
SMALL = (320, 180)
CENTRE_MM = [96.0, 142.0, -255.0]
TURNS = {"first": (0.0, 0.0, 0.0), "second & third": (0.03, -0.07, 0.02), "roll <b>$x$": (-0.05, 0.04, -0.06)}
"""Name of each pose, and the camera's rotation vector."""
BORESIGHT = Boresight(
    exp_map(np.radians([0.5, -1.25, 3.0])),
    np.diag([1e-4, 4e-4, 9e-4]) ** 2,
    np.degrees([2e-4, 8e-4, 18e-4]),
    np.array([0.02, -0.01, 1.0]) / np.linalg.norm([0.02, -0.01, 1.0]),
    np.diag([1e-4, 2e-4]) ** 2,
    np.degrees([2e-4, 4e-4]),
)


def sample(*, size=(1280, 720), seed=1, simulated=True):
    """Data of a report with three poses."""
    rng = np.random.default_rng(seed)
    scale = size[0] / 1280
    camera = CameraModel(
        3345.06 * scale, 3345.27 * scale, 642.1 * scale, 363.32 * scale, size, {"k1": 0.06, "k2": -0.9}
    )
    views = [_view(name, camera, cv2.Rodrigues(np.array(turn))[0], rng) for name, turn in TURNS.items()]
    return ReportData(_results(views, simulated=simulated), views, "5f" * 32)


def of_many_poses(views):
    """Data of a report with these poses, each with all its facts."""
    results = _results(views[:3], simulated=True)
    results["poses"] = [_pose(number, view) for number, view in enumerate(views, 1)]
    return ReportData(results, views, "5f" * 32)


def _results(views, *, simulated):
    """Results of a run with these views."""
    results = json.loads(RESULTS.read_bytes())
    for part in (results["calibration"], results["previous"]["calibration"]):
        part["image_size"] = list(views[0].image.shape[::-1])
    turned = zip(results["calibration"]["views"], results["poses"], views, TURNS.values(), strict=True)
    for row, pose, view, turn in turned:
        rotation = cv2.Rodrigues(np.array(turn))[0].tolist()
        row |= {"name": view.name, "n": len(view.ids), "rotation": rotation, "centre_mm": CENTRE_MM}
        pose |= {"name": view.name, "stars": len(view.ids)}
    if not simulated:
        results["run"] |= {"simulated": False, "seed": None}
        results |= {"truth": None, "comparison": []}
    return results_of(json.dumps(results).encode(), RESULTS)


def _pose(number, view):
    """A pose like the first one of the run, with recordings of its own."""
    pose = json.loads(RESULTS.read_bytes())["poses"][0]
    (attempt,) = pose["attempts"]
    attempt |= {"capture": f"captures/pose-{number:03d}-attempt-1.raw", "sha256": f"{number}1" * 32}
    return pose | {"index": number, "name": view.name, "stars": len(view.ids)}


def _view(name, camera, rotation, rng):
    target = StarTarget()
    ids = np.asarray(target.ids)
    centre = np.array(CENTRE_MM)
    points = np.column_stack([target.positions_mm(ids), np.zeros(len(ids))]) - centre
    reprojected = camera.project(points @ rotation.T)
    width, height = camera.image_size
    inside = np.all((reprojected > 6) & (reprojected < [width - 7, height - 7]), axis=1)
    inside &= np.linalg.norm(points[:, :2] + [0, 2], axis=1) < 54
    reprojected = reprojected[inside]
    image = _image(camera, rotation, centre, target, rng)
    detected = reprojected + rng.normal(0, 0.057, reprojected.shape)
    return ViewPicture(name, image, detected, reprojected, ids[inside])


def _image(camera, rotation, centre, target, rng):
    width, height = camera.image_size
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = (
        np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
        @ rotation
    )
    at = centre + rays * (255.0 / rays[..., 2:])
    bright = target.reflectance(at[..., 0], at[..., 1])
    lit = np.hypot(at[..., 0] - 96, at[..., 1] - 144) < 54
    noise = rng.random(u.shape)
    image = np.where(lit & (noise > 0.02), np.where(bright > 0.5, 255, 128), 128)
    return np.where(noise > 0.999, 0, image).astype(np.uint8)
