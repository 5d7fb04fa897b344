"""Is a calibration still right? The camera that new views give, against the camera that was stated.

Both are compared where they are used: in the projection over the sensor, after the best rotation between them, because
a camera that is mounted again is the same camera (`projection_uncertainty`). The difference is judged by the largest
E_n number over the sensor (ISO 13528:2022, 9.7), with an expanded uncertainty that holds at all places at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.arrays import Array
from calib.compiled import on_one_thread
from calib.errors import InputMismatch
from calib.model.camera import PINHOLE, CameraModel
from calib.uncertainty.projection_uncertainty import camera_difference, projection_derivatives, sensor_grid

#: Coverage of the expanded uncertainty over the whole sensor.
_COVERAGE = 0.95
_DRAWS = 1000
_POINTS_ACROSS = 17
_REGIONS = 3
#: A single kind of change is named if it explains this share of the squared difference.
_EXPLAINS = 0.8
_ROWS, _COLUMNS = ("top", "middle", "bottom"), ("left", "centre", "right")


@dataclass(frozen=True)
class RegionCheck:
    """The worst place of one part of the sensor."""

    name: str
    at_px: tuple[float, float]
    offset_px: float  # Length of the change of the projection
    expanded_px: float  # Its expanded uncertainty, for the whole sensor at once

    @property
    def normalised(self) -> float:
        """The E_n number: above 1, the change is larger than its expanded uncertainty."""
        return self.offset_px / self.expanded_px


@dataclass(frozen=True)
class CameraCheck:
    """What a check of a camera found."""

    regions: tuple[RegionCheck, ...]  # Three rows of three
    rms_px: float  # Root mean square of the change over the sensor
    coverage_factor: float  # k of the expanded uncertainties, for the whole sensor at once
    # Share of the squared change that each kind explains alone: ``scale``, ``principal point``, ``lens``.
    shares: Mapping[str, float]

    @property
    def worst(self) -> RegionCheck:
        """The region with the largest E_n."""
        return max(self.regions, key=lambda region: region.normalised)

    @property
    def right(self) -> bool:
        """Whether the stated camera is right within its expanded uncertainty everywhere on the sensor."""
        return self.worst.normalised <= 1.0

    @property
    def cause(self) -> str:
        """The one kind of change that explains the difference; empty if it is right, or if no kind does alone."""
        if self.right:
            return ""
        name, share = max(self.shares.items(), key=lambda item: item[1])
        return name if share >= _EXPLAINS else ""

    def to_dict(self) -> dict[str, Any]:
        """Return the content as JSON holds it."""
        return {
            "right": self.right,
            "cause": self.cause or None,
            "rms_px": self.rms_px,
            "coverage_factor": self.coverage_factor,
            "shares": dict(self.shares),
            "regions": [
                {
                    "name": one.name,
                    "at_px": list(one.at_px),
                    "offset_px": one.offset_px,
                    "expanded_px": one.expanded_px,
                    "normalised": one.normalised,
                }
                for one in self.regions
            ],
        }


@on_one_thread
def check_camera(
    stated: CameraModel,
    stated_covariance: Array | None,
    found: CameraModel,
    found_covariance: Array,
    rng: np.random.Generator,
) -> CameraCheck:
    """Compare the camera of new views with a stated one, both with the same image size.

    Covariances are in the order of `CameraModel.parameter_names`; None is exact. The generator draws the changes that
    the uncertainties allow; the factor k follows from their largest ones.
    """
    if stated.image_size != found.image_size:
        sizes = [" x ".join(str(side) for side in one.image_size) for one in (stated, found)]
        raise InputMismatch(
            f"The stated camera has {sizes[0]} px, these views have {sizes[1]} px.",
            remedy="Check a calibration of the same sensor and the same region of interest.",
        )
    grid = sensor_grid(found.image_size, _POINTS_ACROSS).reshape(-1, 2)
    offset = camera_difference(found, stated, _POINTS_ACROSS).offset_px.reshape(-1, 2)
    allowed, slopes = np.zeros((_DRAWS, len(grid), 2)), {}
    covariances = {"stated": (stated, stated_covariance), "found": (found, found_covariance)}
    for name, (camera, covariance) in covariances.items():
        derivatives, at = projection_derivatives(camera, _POINTS_ACROSS)
        slope = np.full((len(grid), 2, derivatives.shape[2]), np.nan)
        slope[at] = derivatives
        slopes[name] = slope
        if covariance is not None:
            drawn = rng.multivariate_normal(np.zeros(len(covariance)), covariance, _DRAWS, method="eigh")
            allowed += np.einsum("pik,dk->dpi", slope, drawn)
    seen = np.isfinite(offset).all(axis=1) & np.isfinite(allowed[0]).all(axis=1)
    spread = np.sqrt((allowed[:, seen] ** 2).sum(axis=2).mean(axis=0))
    factor = float(np.quantile((np.linalg.norm(allowed[:, seen], axis=2) / spread).max(axis=1), _COVERAGE))
    length = np.linalg.norm(offset[seen], axis=1)
    return CameraCheck(
        _regions(grid[seen], length, factor * spread, found.image_size),
        float(np.sqrt(np.mean(length**2))),
        factor,
        _shares(found, slopes["found"][seen], offset[seen]),
    )


def _regions(
    places: Array, length: Array, expanded: Array, image_size: Sequence[int]
) -> tuple[RegionCheck, ...]:
    """Return the worst place of each of the nine parts of the sensor; a part without a ray is left out."""
    cell = np.minimum((places / np.array(image_size) * _REGIONS).astype(int), _REGIONS - 1)
    found = []
    for row, of_row in enumerate(_ROWS):
        for column, of_column in enumerate(_COLUMNS):
            here = np.flatnonzero((cell[:, 0] == column) & (cell[:, 1] == row))
            if len(here):
                worst = here[np.argmax(length[here] / expanded[here])]
                x, y = places[worst].tolist()
                name = f"{of_row} {of_column}"
                found.append(RegionCheck(name, (x, y), float(length[worst]), float(expanded[worst])))
    return tuple(found)


def _shares(camera: CameraModel, slope: Array, offset: Array) -> dict[str, float]:
    """Return the share of the squared change that a change of one kind explains, by least squares."""
    names = camera.parameter_names
    flat, total = offset.ravel(), float((offset**2).sum())
    by_name = {name: slope[:, :, at].ravel() for at, name in enumerate(names)}
    kinds = {
        "scale": [by_name["fx"] * camera.fx + by_name["fy"] * camera.fy],
        "principal point": [by_name["cx"], by_name["cy"]],
        "lens": [by_name[name] for name in names if name not in PINHOLE],
    }
    shares = {}
    for kind, columns in kinds.items():
        if columns and total > 0:
            basis = np.stack(columns, axis=1)
            left = flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]
            shares[kind] = 1.0 - float(left @ left) / total
    return shares
