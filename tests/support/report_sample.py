"""A made-up run, complete enough for every part of a report; not a test."""

import cv2
import numpy as np

from bench.report.html import ReportData
from bench.report.view_picture import ViewPicture
from calib.model.camera import CameraModel
from calib.target import StarTarget

TRUE = {"fx": 3345.06, "fy": 3345.27, "cx": 642.10, "cy": 363.32, "k1": 0.06, "k2": -0.90}
COLLIMATOR = {"x": 96.33, "y": 142.49, "r": 255.0}
SIGMA = {
    "fx": 2.13,
    "fy": 2.14,
    "cx": 1.31,
    "cy": 1.07,
    "k1": 0.0081,
    "k2": 0.117,
    "x": 0.101,
    "y": 0.083,
    "r": 0.163,
}
OFF = {
    "fx": 0.61,
    "fy": 0.66,
    "cx": -1.22,
    "cy": 0.31,
    "k1": 0.44,
    "k2": -0.52,
    "x": -1.12,
    "y": 0.27,
    "r": 0.64,
}
SMALL = (320, 180)
NAMES = ("first", "second & third", "roll <b>$x$")


def sample(*, size=(1280, 720), seed=1, simulated=True):
    """Data of a report with three poses."""
    rng = np.random.default_rng(seed)
    scale = size[0] / 1280
    camera = CameraModel(
        3345.06 * scale, 3345.27 * scale, 642.1 * scale, 363.32 * scale, size, {"k1": 0.06, "k2": -0.9}
    )
    angles = ((0.0, 0.0, 0.0), (0.03, -0.07, 0.02), (-0.05, 0.04, -0.06))
    views = [
        _view(name, camera, cv2.Rodrigues(np.array(a))[0], rng) for name, a in zip(NAMES, angles, strict=True)
    ]
    return ReportData(results(views, simulated=simulated), views, "5f" * 32)


def of_many_poses(views, **pose):
    """Data of a report with these poses, each with all its facts."""
    found = results(views[:3])
    found["poses"] = [_pose(number, view) | pose for number, view in enumerate(views, 1)]
    return ReportData(found, views, "5f" * 32)


def results(views, *, simulated=True):
    """Results of a run with these views."""
    values = {name: (TRUE | COLLIMATOR)[name] + OFF[name] * SIGMA[name] for name in SIGMA}
    return {
        "schema": "starbench/results/1",
        "run": _run(simulated=simulated),
        "devices": _devices(),
        "devices_left": [
            {"device": "stage", "state": "confirmed safe", "said": "stands still"},
            {"device": "light", "state": "not confirmed", "said": "no answer"},
            {"device": "camera", "state": "confirmed safe", "said": "closed"},
        ],
        "conditions": _conditions(),
        "calibration": _calibration(views, values),
        "passport": {
            "source": "station certificate",
            "name": "certificate",
            "collimator": "C-17",
            "number": "T-2041",
            "date": "2026-02-11",
            "valid_until": "2028-02-11",
            "temperature_c": 20.0,
            "values": {"r": 255.03},
            "sigma": {"r": 0.05},
            "sha256": "ab" * 32,
        },
        "gimbal_readings": {
            "entered": False,
            "statement": {
                "source": "data sheet",
                "reading_sigma_deg": 0.002,
                "scale_sigma": 0.0001,
                "eccentricity_deg": 0.0,
            },
            "bound": None,
            "why_not": "The station does not bound the parallax.",
        },
        "projection": {
            "coverage_factor": 2.0,
            "worst_corner": {"corner": "top left", "expanded_px": 0.2512, "expanded_urad": 71.41},
            "median": {"expanded_px": 0.113, "expanded_urad": 33.2},
            "supported": {
                "reach_px": 73.4,
                "share": 0.874,
                "expanded_px": 0.1871,
                "expanded_urad": 53.2,
            },
        },
        "previous": _previous(views, values),
        "planar": _planar(values),
        "poses": [_pose(number, view) for number, view in enumerate(views, 1)],
        "halves": {
            "rms_px": 0.031,
            "worst_px": 0.092,
            "expected_px": 0.035,
            "ratio": 0.89,
            "cameras": [TRUE, TRUE | {"fx": 3345.3, "fy": 3345.5, "k1": 0.0604}],
        },
        "gimbal": {
            "rms_arcsec": 1.83,
            "scale": {"pan_deg": 1.000021},
            "scale_sigma": {"pan_deg": 1.7e-05},
            "agrees": True,
            "excess_arcsec": 0.0,
            "verdict": "agrees",
            "says": ["Readings and rotations agree."],
            "pairs": None,
            "slip": None,
            "faults": [],
        },
        "parallax": {
            "walk_mm": [-2.4, -4.2],
            "walk_covariance_mm2": [[1.2, 0.3], [0.3, 4.0]],
            "pupil_off_pivot_mm": {"value": 2.7, "sigma": 1.0},
            "axes_differ": False,
            "difference_in_sigmas": 0.8,
            "without_rim": ["first"],
            "station_entry": "gimbal: {pupil_off_pivot_mm: {value: 2.7, sigma: 1.0}}",
            "stated_mm": None,
            "defocus": {"value": 0.066, "sigma": 0.01, "source": "station"},
            "parallax": {"value": -0.0007, "sigma": 0.0003},
            "fx_px": {"value": 2.3, "sigma": 1.0},
            "says": ["The disc of the beam moves on the target by -2.4 +- 1.1 mm along x."],
        },
        "gates": _gates(),
        "untils": _untils(),
        "deviations": ["Pose second was recorded twice: the first recording had 31 stars."],
        "holds": [],
        "failures": [
            {
                "kind": "link",
                "what": "The stage does not answer.",
                "where": "/dev/ttyUSB0",
                "remedy": "Check its cable.",
            }
        ],
        "states": _states(),
        "truth": {"camera": TRUE, "collimator": COLLIMATOR} if simulated else None,
        "comparison": _comparison(values) if simulated else [],
    }


def _untils():
    """An `until` that chose one pose and met its goal."""
    head = {
        "until": 2,
        "until_last": 66,
        "wanted": {"expanded_fx_px": 3.0},
        "fixed": {"expanded_fx_px": {}},
        "coverage_factor": 2.0,
        "model": "spherical",
        "lacks": "",
    }
    pose = {
        "pose": 3,
        "pose_name": "chosen 1",
        "angles_deg": {"pan": -2.5, "tilt": 4.0},
        "expected": {"expanded_fx_px": 2.7},
        "why": "it lowers U(fx) most",
    }
    counts = {"recorded": 2, "poses": 2, "worked_s": 9.1}, {"recorded": 3, "poses": 3, "worked_s": 13.7}
    return [
        {**head, **counts[0], "step": 8, "now": {"expanded_fx_px": 4.1}, "chosen": pose},
        {
            **head,
            **counts[1],
            "step": 12,
            "now": {"expanded_fx_px": 2.8},
            "ended": "met",
            "why": "The goals are met.",
        },
    ]


def _calibration(views, values):
    """The calibration of these values."""
    names = list(SIGMA)
    correlation = np.eye(9)
    for a, b, rho in ((0, 1, 0.999), (0, 8, 0.96), (1, 8, 0.96), (4, 5, -0.93), (2, 6, -0.88), (3, 7, -0.86)):
        correlation[a, b] = correlation[b, a] = rho
    sigma = np.array(list(SIGMA.values()))
    return {
        "model": "spherical",
        "converged": True,
        "iterations": 9,
        "image_size": list(views[0].image.shape[::-1]),
        "camera": {name: values[name] for name in TRUE},
        "collimator": {name: values[name] for name in COLLIMATOR},
        "sigma": dict(SIGMA),
        "covariance": {"names": names, "matrix": (correlation * np.outer(sigma, sigma)).tolist()},
        "rms_px": 0.0812,
        "mean_px": 0.0711,
        "variance_factor": 1.07,
        "degrees_of_freedom": 1791,
        "disagreement": 1.12,
        "coverage_factor": 2.0,
        "left_out_rms_px": 0.0931,
        "budget": {
            "noise of the stars": {name: 0.8 * s for name, s in SIGMA.items()},
            "disagreement of the views": {name: 0.6 * s for name, s in SIGMA.items()},
        },
        "budget_rows": _budget_rows(),
        "not_included": [
            "bow of the print: 0.01 mm at 35 mm from the axis would move fx by 5.8 px and an image point by up to 1.3 px",
            "thermal expansion of the print: 5 °C at 9e-6 per °C would move fx and every image point by less than 0.005 px",
            "slopes of the collimator's wavefront: 5 µrad RMS would move fx by 0.17 px and an image point by up to 0.037 px",
        ],
        "views": [{"name": v.name, "n": len(v.ids), "rms_px": 0.08, "mean_px": 0.07} for v in views],
        "candidates": [],
        "notes": ["Three poses only: the distortion coefficients are weakly constrained."],
        "remarks": ["Three poses only: the distortion coefficients are weakly constrained."],
    }


def _previous(views, values):
    """The last calibration of the camera; since then, fx has changed by 1.5 px."""
    sigma = {name: SIGMA[name] for name in TRUE}
    return {
        "run": "three_pose-20260225-090000",
        "number": 9,
        "finished_utc": "2026-02-25T09:01:00.100000Z",
        "sequence": "three_pose",
        "temperature_c": 40.9,
        "seal": "aa" * 32,
        "results_sha256": "bb" * 32,
        "calibration": {
            "image_size": list(views[0].image.shape[::-1]),
            "model": "spherical",
            "camera": {name: values[name] for name in TRUE} | {"fx": values["fx"] - 1.5},
            "sigma": sigma,
            "covariance": {"names": list(sigma), "matrix": np.diag(np.square(list(sigma.values()))).tolist()},
            "coverage_factor": 2.0,
        },
        "change": {
            "rms_px": 0.0231,
            "largest_px": 0.0612,
            "largest_ratio": 0.412,
            "px_there": 0.0533,
            "at_px": [319.0, 88.5],
        },
    }


def _budget_rows():
    """Rows of an uncertainty budget whose squares add up to those of fx."""
    stated = [
        ("stars", "A", "residuals of the stars", "normal", None, "", None, 1791, None, 0.31, 0.084),
        ("disagreement of the views", "A", "differences between the views", "normal", None, "", None, 1791, None, 0.48, 0.11),
        ("passport of the collimator", "B", "certificate 2026-114", "normal", 0.05, "mm", 1.0, None, 13.1, 0.655, 0.148),
        ("scale of the print", "B", "maker's drawing <4711>", "rectangular", 2e-5, "1", 3**0.5, None, 3340.0, 0.0386, 0.0087),
        ("bow of the print", "B", "maker's drawing", "triangular", 0.01, "mm at 40 mm", 6**0.5, None, 0.71, 0.0003, 0.0001),
        ("effective radius", "B", "default of Starbench; not stated", "normal", 6e-4, "1", 1.0, None, 3340.0, 1.942, 0.439),
    ]  # fmt: skip
    sums = [sum(row[at] ** 2 for row in stated) for at in (9, 10)]
    return [
        {
            "name": name,
            "type": kind,
            "source": source,
            "distribution": distribution,
            "value": value,
            "unit": unit,
            "divisor": divisor,
            "degrees_of_freedom": freedom,
            "sensitivity": {}
            if by is None
            else {"fx": by, "fy": by, "cx": 0.1, "cy": 0.2, "worst_corner": by / 4.4},
            "contribution": {"fx": fx, "fy": fx, "cx": 0.01, "cy": 0.01, "worst_corner": corner},
            "share": {
                "fx": fx**2 / sums[0],
                "fy": fx**2 / sums[0],
                "cx": 0.2,
                "cy": 0.2,
                "worst_corner": corner**2 / sums[1],
            },
        }
        for name, kind, source, distribution, value, unit, divisor, freedom, by, fx, corner in stated
    ]


def _planar(values):
    """The planar calibration beside it."""
    return {
        "camera": {name: values[name] + 3 * OFF[name] * SIGMA[name] for name in TRUE},
        "sigma": {name: 2.9 * SIGMA[name] for name in TRUE},
        "rms_px": 0.0799,
    }


def _device(maker, model, serial, firmware):
    return {"maker": maker, "model": model, "serial": serial, "firmware": firmware}


def _devices():
    """Who the devices said they were."""
    camera = _device("Prophesee", "EVK4", "00050423", "3.9.0")
    return {
        "camera": {**camera, "sensor": "IMX636", "width": 1280, "height": 720},
        "stage": [
            {"name": "pan", **_device("Zaber", "X-RST120AK", "100101", "7.38")},
            {"name": "tilt", **_device("Zaber", "X-GSM40E", "100102", "7.38")},
        ],
        "camera_settings": {"biases": {"bias_diff_on": 0}, "trigger_in": True},
        "light": _device("Starbench", "SG1", "SG0042", "1.0"),
        "connections": {
            "camera_link": "USB 3",
            "camera_firmware": "3.9.0",
            "trigger_input": "on",
            "sync_polarity": "not stated by the device",
            "sync_level": "not stated by the device",
        },
    }


def _conditions():
    """Settings as read back."""
    return {
        "light": {
            "waveform": "square",
            "frequency_hz": 60.0,
            "duty_percent": 50.0,
            "low_v": 0.0,
            "high_v": 5.0,
            "sync_output": True,
        },
        "camera": {
            "biases": {"bias_fo": 0, "bias_diff_on": 0},
            "filters": {"afk": False, "erc": False},
            "temperature_c": 41.27,
            "illumination_lux": None,
        },
    }


def _comparison(values):
    """How far from the truth the values lie."""
    return [
        {
            "name": n,
            "value": values[n],
            "sigma": SIGMA[n],
            "truth": (TRUE | COLLIMATOR)[n],
            "error": OFF[n] * SIGMA[n],
            "error_sigmas": OFF[n],
        }
        for n in SIGMA
    ]


def _view(name, camera, rotation, rng):
    target = StarTarget()
    ids = np.asarray(target.ids)
    centre = np.array([96.0, 142.0, -255.0])
    points = np.column_stack([target.positions_mm(ids), np.zeros(len(ids))]) - centre
    reprojected = camera.project(points @ rotation.T)
    width, height = camera.image_size
    inside = np.all((reprojected > 6) & (reprojected < [width - 7, height - 7]), axis=1)
    inside &= np.linalg.norm(points[:, :2] + [0, 2], axis=1) < 54
    reprojected = reprojected[inside]
    return ViewPicture(
        name,
        _image(camera, rotation, centre, target, rng),
        reprojected + rng.normal(0, 0.057, reprojected.shape),
        reprojected,
        ids[inside],
    )


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


def _run(*, simulated):
    return {
        "id": "three_pose-20260301-120000",
        "sequence": "three_pose",
        "station": "simulated",
        "started_utc": "2026-03-01T12:00:00.100000Z",
        "finished_utc": "2026-03-01T12:00:21.900000Z",
        "seed": 1 if simulated else None,
        "operator": None,
        "collimator": {"serial": "C-7", "nominal_r_mm": 255.0, "certificate": "2026-114"},
        "laboratory": "Optics laboratory <b>B</b>",
        "simulated": simulated,
        "camera": "event",
        "resumed": 0,
        "ledger": {"number": 12, "head": "1ed9e4" + "0" * 58, "of_camera": {"finished": 2, "open": 1}},
        "software": {
            "starbench": "0.1.0",
            "python": "3.11.7",
            "numpy": "2.4.6",
            "opencv-python-headless": "5.0.0.93",
        },
    }


def _pose(number, view):
    attempts = [
        _attempt(number, a, accepted=a == (2 if number == 2 else 1))
        for a in range(1, 3 if number == 2 else 2)
    ]
    return {
        "index": number,
        "name": view.name,
        "commanded_deg": {"pan": 1.7 * number, "tilt": -0.5},
        "measured_deg": {"pan": 1.7 * number + 2e-5, "tilt": -0.50001, "pan_encoder": 1.7},
        "measured_after_deg": {"pan": 1.7 * number + 4e-5, "tilt": -0.50001, "pan_encoder": 1.7},
        "attempts": attempts,
        "image": {
            "kind": "fired-per-edge",
            "reason": "2.1 events an edge",
            "window_us": [0, 33333],
            "periods": 2,
            "events_per_edge": 2.13,
            "on_share": 0.497,
            "hot_pixels": 12,
        },
        "flicker_hz": 60.0003,
        "named_by": "tag",
        "stars": len(view.ids),
        "rms_px": 0.0805,
        "mean_px": 0.0703,
    }


def _attempt(pose, attempt, *, accepted):
    return {
        "attempt": attempt,
        "capture": f"captures/pose-{pose:03d}-attempt-{attempt}.raw",
        "sha256": f"{pose}{attempt}" * 32,
        "accepted": accepted,
        "reasons": [] if accepted else ["stars 31, wanted >= 40"],
        "events": 1_234_567,
        "triggers": 8,
        "duration_s": 0.0500123,
        "event_rate_mev_s": 24.7,
        "temperature_c": 41.3,
    }


def _gates():
    kinds = (
        ("stars", (598, 602, 595), "", ">= 40"),
        ("event rate", (24.1, 24.6, 23.9), "Mev/s", "<= 100"),
        ("pan moved", (0.0, 0.00046, 0.0001), "deg", "<= 0.0005"),
    )
    return [
        {
            "name": f"pose {pose}: {name}",
            "value": values[pose - 1],
            "unit": unit,
            "limit": limit,
            "verdict": "marginal" if values[pose - 1] == 0.00046 else "pass",
        }
        for pose in (1, 2, 3)
        for name, values, unit, limit in kinds
    ]


def _states():
    walked = ["preflight", "homing", "lighting"]
    for recordings in (1, 2, 1):
        walked += ["slewing", "settling", *["recording", "checking"] * recordings]
    walked += ["parking", "solving", "reporting"]
    return [
        {"state": s, "utc": f"2026-03-01T12:00:{1.1 * i:09.6f}Z", "mono_s": 1.1 * i}
        for i, s in enumerate(walked)
    ]
