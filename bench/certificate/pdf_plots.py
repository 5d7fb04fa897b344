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
from bench.report.text import STARS, TargetWords

if TYPE_CHECKING:
    from bench.report.view_picture import ViewPicture

PLOTS = ("uncertainty", "direction", "coverage", "vectors", "radial", "regions", "distortion", "halves")
"""Names of the plots, in their order; the directions only of a wide lens, the halves only of many poses."""
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
    from bench.report.plots import camera_plots, star_plots

    seen = [view for view in views if len(view.detected)]
    k = coverage_factor(results["calibration"])
    drawn = camera_plots(results, [view.detected for view in seen], k, certificate=True)
    drawn |= star_plots(results, seen) if seen else {}
    return {name: drawn[name] for name in PLOTS if name in drawn}


def pictures(certificate: Certificate, plots: Mapping[str, str], words: TargetWords = STARS) -> list[Picture]:
    """Return the plots with their descriptions, in the order of `PLOTS`."""
    numbers = "; ".join(f"{one.name}: {one.text}" for one in certificate.further)
    return [
        Picture(name, plots[name], f"Plot. {caption} {numbers}.".strip(), caption, name in _WIDE)
        for name, caption in ((name, words.fitting(caption)) for name, caption in _CAPTIONS.items())
        if name in plots
    ]
