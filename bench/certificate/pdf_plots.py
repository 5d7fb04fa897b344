"""The plots of the certificate, as SVG that is the same for the same data, with their descriptions.

The plots are those of the run's report. Without the stars of the poses, only the plots that follow from the camera and
its covariance can be drawn. Touches no files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bench.certificate.certificate_data import Certificate

if TYPE_CHECKING:
    from bench.report.view_picture import ViewPicture

PLOTS = ("uncertainty", "direction", "coverage", "vectors", "radial", "regions", "distortion", "halves")
"""Names of the plots, in their order; the names are those of `bench.report.choice.PLOTS`."""
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
    """A plot on a page.

    Attributes
    ----------
    name
        Its name.
    svg
        The plot.
    alt
        Description for readers who do not see it, with its numbers.
    caption
        Text below it.
    wide
        Whether it takes the width of the page.
    """

    name: str
    svg: str
    alt: str
    caption: str
    wide: bool

    @property
    def file(self) -> str:
        """Name of its file for the layout."""
        return f"{self.name}.svg"


def draw_plots(results: Mapping[str, Any], views: Sequence[ViewPicture] = ()) -> dict[str, str]:
    """Draw the plots of a certificate.

    Parameters
    ----------
    results
        Content of results.json.
    views
        The poses with their stars and residuals; without them the plots of the residuals are missing.

    Returns
    -------
    dict
        SVG by name; a plot without data is missing.
    """
    from bench.report.figures import report_plots

    drawn = report_plots(results, views)
    return {name: drawn[name] for name in PLOTS if drawn.get(name)}


def pictures(certificate: Certificate, plots: Mapping[str, str]) -> list[Picture]:
    """Return the plots with their descriptions.

    Parameters
    ----------
    certificate
        The certificate.
    plots
        SVG by name.

    Returns
    -------
    list of Picture
        The plots, in the order of `PLOTS`.
    """
    numbers = "; ".join(f"{one.name}: {one.text}" for one in certificate.further)
    return [
        Picture(name, plots[name], f"Plot. {caption} {numbers}.".strip(), caption, name in _WIDE)
        for name, caption in _CAPTIONS.items()
        if name in plots
    ]
