"""The plots of a certificate, as SVG that is the same for the same data, with their descriptions.

The plots are those of the run's report. Without the stars of the poses, only the plots that follow from the camera and
its covariance can be drawn. Of a run folder it reads `views.h5`, and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bench.certificate.certificate_data import Certificate
from bench.records.results import Results
from bench.records.run_facts import coverage_factor
from bench.report.text import STARS, TargetWords, words_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from bench.report.view_picture import ViewPicture

    Array = NDArray[np.float64]

PLOTS = ("uncertainty", "direction", "coverage", "vectors", "radial", "regions", "distortion", "halves")
"""Names of the plots, in their order; the directions only of a wide lens, the halves only of many poses."""
_WIDE_ANGLE_DEG = 25.0
_WIDE = frozenset({"vectors"})
_CAPTIONS = {
    "uncertainty": "Expanded uncertainty U of an image point over the sensor.",
    "direction": "Expanded uncertainty U of the direction that belongs to a pixel.",
    "coverage": "Stars of all poses on the sensor. The results are extrapolated where no star supports them.",
    "vectors": "Residual of each star at its place on the sensor, magnified.",
    "radial": "Length of the residuals against the distance from the principal point.",
    "regions": "RMS residual and number of stars for each region of the sensor.",
    "distortion": "Radial displacement by the lens against the field angle, with its expanded uncertainty.",
    "halves": "Difference between the cameras from two halves of the poses.",
}


@dataclass(frozen=True)
class Picture:
    """A plot on a page."""

    name: str
    svg: str
    alt: str  # Description for readers who do not see it, with its numbers
    caption: str
    wide: bool  # Whether it takes the width of the page

    @property
    def file(self) -> str:
        """Name of its file for the layout."""
        return f"{self.name}.svg"


def plots_of_run(run: Path, results: Results) -> dict[str, str]:
    """Draw the plots of a certificate from a run's folder: SVG by name. Those of stars need `views.h5`."""
    from bench.report.view_picture import ViewPicture
    from bench.views.views_file import VIEWS, read_views

    stored = read_views(run / VIEWS) if (run / VIEWS).exists() else []
    views = [
        ViewPicture(
            one.view.name, None, one.view.points_px, one.view.points_px - one.residuals_px, one.view.ids
        )
        for one in stored
    ]
    return draw_plots(results, views)


def draw_plots(results: Results, views: Sequence[ViewPicture] = ()) -> dict[str, str]:
    """Draw the plots of a certificate: SVG by name. A plot without data, or without ``views``, is missing."""
    seen = [view for view in views if len(view.detected)]
    drawn = _camera_plots(results, [view.detected for view in seen]) | (
        _star_plots(results, seen) if seen else {}
    )
    return {name: drawn[name] for name in PLOTS if name in drawn}


def _camera_plots(results: Results, stars: Sequence[Array]) -> dict[str, str]:
    """Draw what follows from the camera and its covariance; nothing if the covariance is not stated."""
    import numpy as np

    from bench.report.maps import sensor_map
    from bench.report.pose_plot import (
        camera_covariance,
        camera_of,
        distortion_curve,
        field_angles_deg,
        outermost_deg,
    )
    from calib.uncertainty.projection_uncertainty import camera_difference, projection_uncertainty

    calibration = results["calibration"]
    covariance = camera_covariance(calibration)
    if covariance is None:
        return {}
    camera, k = camera_of(calibration["camera"], calibration["image_size"]), coverage_factor(calibration)
    found, points = projection_uncertainty(camera, covariance), np.concatenate(stars) if stars else None
    outermost = outermost_deg(camera, stars) if stars else None
    plots = {
        "uncertainty": sensor_map(
            found.grid_px, k * found.sigma_px, "U of an image point, px", "uncertainty", "", stars=points
        ),
        "distortion": distortion_curve(camera, covariance, k, outermost, words_of(results)),
    }
    if max(field_angles_deg(camera).values()) > _WIDE_ANGLE_DEG:  # else it looks as that of the image points
        plots["direction"] = sensor_map(
            found.grid_px, k * found.sigma_arcsec, "U of a direction, arcsec", "direction", "", stars=points
        )
    halves = results.get("halves")
    if halves and (cameras := halves.get("cameras")):
        first, second = (camera_of(half, calibration["image_size"]) for half in cameras)
        difference = camera_difference(first, second)
        lengths = np.linalg.norm(difference.offset_px, axis=2)
        plots["halves"] = sensor_map(
            difference.grid_px, lengths, "Difference of the halves, px", "halves", "", arrows=difference
        )
    return plots


def _star_plots(results: Results, seen: Sequence[ViewPicture]) -> dict[str, str]:
    from bench.report.plots import coverage, regions, residual_radial, residual_vectors

    width, height = results["calibration"]["image_size"]
    camera = results["calibration"]["camera"]
    centre, words = (camera["cx"], camera["cy"]), words_of(results)
    return {
        "coverage": coverage(seen, (width, height), centre, words),
        "vectors": residual_vectors(seen, (width, height), words),
        "radial": residual_radial(seen, centre),
        "regions": regions(seen, (width, height), words),
    }


def pictures(certificate: Certificate, plots: Mapping[str, str], words: TargetWords = STARS) -> list[Picture]:
    """Return the plots with their descriptions, in the order of `PLOTS`."""
    numbers = "; ".join(f"{one.name}: {one.text}" for one in certificate.further)
    return [
        Picture(name, plots[name], f"Plot. {caption} {numbers}.".strip(), caption, name in _WIDE)
        for name, caption in ((name, words.fitting(caption)) for name, caption in _CAPTIONS.items())
        if name in plots
    ]
