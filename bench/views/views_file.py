"""`views.h5`: what was found in each pose, for whoever wants to look closer. Can be rebuilt from the captures."""

from __future__ import annotations

import io
from collections.abc import Sequence

import h5py
import numpy as np
from numpy.typing import NDArray

from bench.views.measure import Measurement


def views_file(
    measurements: Sequence[Measurement],
    residuals_px: Sequence[NDArray[np.float64]],
) -> bytes:
    """Lay out views, residuals and pictures as an HDF5 file.

    Parameters
    ----------
    measurements
        One a pose, each with a view and a picture.
    residuals_px
        For each view (N, 2): star found minus star projected, px.

    Returns
    -------
    bytes
        The file. A group a pose, in order: ``ids`` (N,), ``points_px`` (N, 2), ``target_mm`` (N, 2),
        ``covariances_px2`` (N, 2, 2), ``residuals_px`` (N, 2), ``picture`` (H, W) uint8,
        the event image as the report shows it.
    """
    memory = io.BytesIO()
    with h5py.File(memory, "w") as file:
        file.attrs["format"] = "starbench/views/1"
        for number, (found, residuals) in enumerate(zip(measurements, residuals_px, strict=True), 1):
            view = found.view
            assert view is not None
            assert found.picture is not None
            group = file.create_group(f"pose-{number:03d}")
            group.attrs["name"] = view.name
            group.attrs["image_size"] = view.image_size
            for name in ("ids", "points_px", "target_mm", "covariances_px2"):
                group.create_dataset(name, data=getattr(view, name))
            group.create_dataset("residuals_px", data=residuals)
            group.create_dataset(
                "picture", data=found.picture.unpacked(), compression="gzip", compression_opts=4
            )
    return memory.getvalue()
