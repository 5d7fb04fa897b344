"""Comparison of an answer with the truth: errors and expanded uncertainties of fx, fy, cx, cy, the worst corner, and r.

The corner is that with the largest stated uncertainty, along the direction of the largest; errors and uncertainties are
those that the best common rotation of the camera leaves.
"""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibrationError

from .bench import Bench, Camera
from .geometry import SIZE, by_names
from .knowledge import Answer, options_for, passport_of, solve

Array = NDArray[np.float64]

CENTRE = ("fx", "fy", "cx", "cy")
ACROSS = (33, 19)


def sensor_points() -> tuple[Array, Array]:
    """Points (N, 2) px over the sensor, and the places of its four corners among them."""
    u, v = np.meshgrid(np.linspace(0, SIZE[0] - 1, ACROSS[0]), np.linspace(0, SIZE[1] - 1, ACROSS[1]))
    corners = np.array([0, ACROSS[0] - 1, ACROSS[0] * (ACROSS[1] - 1), ACROSS[0] * ACROSS[1] - 1])
    return np.stack([u.ravel(), v.ravel()], axis=1), corners


def corner(answer: Answer, camera: Camera) -> tuple[float, float]:
    """Error and standard uncertainty, px, of the corner with the largest uncertainty."""
    px, corners = sensor_points()
    rays = camera.rays(px)
    without = _without_turn(answer.values, rays)
    columns = np.stack([_by(answer.values, name, rays) for name in answer.values], axis=1)
    left = (without @ columns).reshape(len(px), 2, -1)[corners]
    off = (without @ (by_names(answer.values, rays) - px).ravel()).reshape(-1, 2)[corners]
    variances, directions = np.linalg.eigh(left @ answer.covariance @ np.swapaxes(left, 1, 2))
    worst = int(np.argmax(variances[:, 1]))
    return float(directions[worst, :, 1] @ off[worst]), float(np.sqrt(max(variances[worst, 1], 0.0)))


def _by(values: Mapping[str, float], name: str, rays: Array) -> Array:
    """Derivative (2 N,) of the image points by a parameter."""
    step = 1e-3 if name in CENTRE else 1e-5
    more, less = ({**values, name: values[name] + sign * step} for sign in (1, -1))
    return (by_names(more, rays) - by_names(less, rays)).ravel() / (2 * step)


def _without_turn(values: Mapping[str, float], rays: Array) -> Array:
    """The projection (2 N, 2 N) that takes out what a rotation of the camera does."""
    step, turns = 1e-6, []
    for axis in np.eye(3):
        more, less = (by_names(values, rays + sign * step * np.cross(axis, rays)) for sign in (1, -1))
        turns.append((more - less).ravel() / (2 * step))
    q = np.linalg.qr(np.array(turns).T)[0]
    return np.eye(len(q)) - q @ q.T


def compared(answer: Answer, bench: Bench) -> dict[str, Any]:
    """Errors and expanded uncertainties, as numbers of a line."""
    camera = bench.camera
    k, names = answer.coverage_factor, list(answer.values)
    sigmas = dict(zip(names, np.sqrt(np.diag(answer.covariance)).tolist(), strict=True))
    expanded = {name: answer.factors.get(name, k) * sigmas[name] for name in names}
    off = {name: value - camera.values.get(name, 0.0) for name, value in answer.values.items()}
    error, u = {name: off[name] for name in CENTRE}, {name: expanded[name] for name in CENTRE}
    has_lens = camera.image_of is None or camera.exact  # else no coefficients describe it
    error["corner"], sigma = corner(answer, camera)
    u["corner"] = k * sigma
    error["r"], u["r"] = answer.raw.values["r"] - bench.facts["r"], answer.raw.U["r"]
    return {
        "error": {name: round(value, 5) for name, value in error.items()},
        "U": {name: round(value, 5) for name, value in u.items()},
        "lens_over": {
            name: round(off[name] / expanded[name], 3) for name in off if has_lens and name not in CENTRE
        },
        "k": round(k, 3),
        "rms_px": round(answer.rms_px, 4),
        "left_out_px": answer.left_out_rms_px and round(answer.left_out_rms_px, 4),
        "model": answer.model,
        "notes": list(answer.notes),
        "accused": [w.name for w in getattr(answer.raw, "witnesses", ()) if w.fault_probability > 0.5],
    }


def judged(
    bench: Bench, known: str, before: tuple[Bench, str] | None = None, lens: str = "shipped"
) -> dict[str, Any]:
    """Calibrate a bench and compare; a refusal is a result too.

    before: Bench and knowledge of an earlier calibration whose passport is used; its time does not count.
    """
    line: dict[str, Any] = {"known": known, "lens": bench.camera.family, "poses": len(bench.views)}
    line |= bench.facts
    try:
        passport = None
        if before is not None:
            passport = passport_of(solve(before[0], options_for(*before, lens)))
        begun = time.process_time()
        answer = solve(bench, options_for(bench, known, lens, passport))
        line["cpu_s"] = round(time.process_time() - begun, 3)
        return {**line, **compared(answer, bench)}
    except CalibrationError as error:
        return {**line, "refused": str(error)}
