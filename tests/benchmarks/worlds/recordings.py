"""Published views of a real collimator: what the engine finds, and how much it scatters over triples of views."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import calib
from calib.errors import CalibrationError

SIZE = (2448, 2048)
COUNT = 20
TRIPLES_SEED = 90210


def read(folder: Path) -> list[calib.View]:
    """Read the views (tests/data/README.md); their points count from the corner of the first pixel."""
    views = []
    for path in (folder / f"image{i}.txt" for i in range(1, COUNT + 1)):
        rows = np.loadtxt(path)
        points = rows[:, :2] - 0.5
        ids = rows[:, 4].astype(np.int64)
        views.append(calib.View(path.stem, SIZE, ids, points, rows[:, 2:4], 1.0))
    return views


def triples(count: int) -> list[tuple[int, ...]]:
    """Draw sets of three views, always the same."""
    rng = np.random.default_rng(TRIPLES_SEED)
    return [tuple(sorted(rng.choice(COUNT, 3, replace=False).tolist())) for _ in range(count)]


def solved(views: list[calib.View], chosen: tuple[int, ...]) -> dict[str, Any]:
    """Calibrate some of the views with nothing known."""
    try:
        calibration = calib.calibrate([views[i] for i in chosen], calib.CalibrationOptions(model="auto"))
    except CalibrationError as error:
        return {"views": chosen, "refused": str(error)}
    return {
        "views": chosen,
        "model": calibration.model,
        "rms_px": calibration.rms_px,
        "left_out_px": calibration.left_out_rms_px,
        "k": calibration.coverage_factor,
        **{name: getattr(calibration.camera, name) for name in ("fx", "fy", "cx", "cy")},
        **{f"u_{name}": calibration.sigma[name] for name in ("fx", "fy", "cx", "cy")},
    }


def robust(values: NDArray[np.float64]) -> float:
    """Half of the range of the middle 68.27 %."""
    low, high = np.quantile(values, [0.158655, 0.841345])
    return float(high - low) / 2
