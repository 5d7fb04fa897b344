"""The stars that the ideal simulated station expects at poses, with noise: as views, and as point files."""

from dataclasses import replace

import numpy as np

from bench.solve.forecasts import expected_bench
from bench.stations.station import load_station
from calib.studies.predicted_views import predicted_view

THREE = (("left", -6, 2), ("right", 6, 2), ("below", 0, -3))
"""Name, pan and tilt of poses, degrees."""


def expected_views(poses, *, sigma_px, seed, station=None):
    """Views with the names of the poses."""
    bench = expected_bench(station or load_station("simulated_ideal"))
    rng, views = np.random.default_rng(seed), []
    for name, pan, tilt in poses:
        view, _ = predicted_view(bench, {"pan_deg": pan, "tilt_deg": tilt}, name)
        views.append(replace(view, points_px=view.points_px + rng.normal(0, sigma_px, view.points_px.shape)))
    return views


def write_points(folder, views, every=1):
    """Write every so many stars of each view as a point file, with its origin in the corner; return the folder."""
    folder.mkdir(exist_ok=True)
    for view in views:
        rows = np.column_stack([view.points_px + 0.5, view.target_mm, view.ids])[::every]
        np.savetxt(folder / f"{view.name}.csv", rows, fmt=["%.6f"] * 4 + ["%d"])
    return folder
