"""The kinds of blocks that a page of the certificate is made of, and the printed form of its numbers.

A block is plain data for `certificate.typ`: it holds text, never markup. Touches no files.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from bench.certificate.certificate_data import Certificate
from bench.records.results import Results
from bench.records.run_facts import coverage_factor
from bench.report.text import MINUS, NOTHING, STARS, TargetWords, exact, number, words_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from bench.report.view_picture import ViewPicture

    Array = NDArray[np.float64]

# The plots of the certificate, as SVG that is the same for the same data, with their descriptions.
#
# The plots are those of the run's report. Without the stars of the poses, only the plots that follow from
# the camera and its covariance can be drawn. Of a run folder it reads `views.h5`, and nothing else.

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
    """Draw the plots of a certificate from a run.

    run: The run's folder.
    Returns: SVG by name; without `views.h5`, the plots of the stars are missing.
    Raises RunFolderError: If `views.h5` cannot be read.
    """
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
    """Draw the plots of a certificate.

    views: The poses with their stars and residuals; without them the plots of the residuals are missing.
    Returns: SVG by name; a plot without data is missing.
    """
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
    """Return the plots with their descriptions.

    Returns: The plots, in the order of `PLOTS`.
    """
    numbers = "; ".join(f"{one.name}: {one.text}" for one in certificate.further)
    return [
        Picture(name, plots[name], f"Plot. {caption} {numbers}.".strip(), caption, name in _WIDE)
        for name, caption in ((name, words.fitting(caption)) for name, caption in _CAPTIONS.items())
        if name in plots
    ]


Block = dict[str, Any]
Cell = str | dict[str, Any]
Align = Literal["left", "right"]

_DIGIT_EM, _POINT_EM = 0.636, 0.318
"""Widths of a digit and of the decimal point in DejaVu Sans, em."""
NU = "\N{GREEK SMALL LETTER NU}"
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_PLAIN_FROM, _PLAIN_TO = 1e-4, 1e7


def paragraph(text: str, tone: Literal["plain", "note", "lead"] = "plain", *, sticky: bool = False) -> Block:
    """Return a paragraph.

    tone: ``note`` for small print, ``lead`` for the first line of the certificate.
    sticky: Whether it stays on one page with the block after it.
    """
    return {"kind": "paragraph", "text": text, "tone": tone, "sticky": sticky}


def heading(text: str) -> Block:
    """Return a heading of second rank."""
    return {"kind": "heading", "text": text}


def notice(title: str, lines: Sequence[str], *, warning: bool = False) -> Block:
    """Return a box that a reader must not overlook.

    warning: Whether it is a warning: red.
    """
    return {"kind": "notice", "title": title, "lines": list(lines), "tone": "warning" if warning else "plain"}


def pairs(rows: Iterable[tuple[Cell, Cell]], label_mm: float = 42.0, **layout: Any) -> Block:
    """Return names with their values; a row without a value is left out.

    label_mm: Width of the names, mm.
    layout: ``columns`` and ``size`` (points).
    """
    return {"kind": "pairs", "rows": filled(rows), "label_mm": label_mm, **layout}


def filled(rows: Iterable[tuple[Cell, Cell]]) -> list[tuple[Cell, Cell]]:
    """Return the rows that have a value."""
    return [(name, value) for name, value in rows if value]


def table(
    head: Sequence[Cell],
    rows: Sequence[Sequence[Cell]],
    widths: Sequence[float | Literal["auto"]],
    align: Sequence[Align] | None = None,
    **layout: Any,
) -> Block:
    """Return a table; its head is repeated on every page.

    widths: ``auto``, or a share of the width that is left.
    align: Alignment of each column; None for left everywhere.
    layout: ``size`` (points), ``gap`` and ``pad`` (space beside and above the text, mm), ``break`` (a word of
      this length may break anywhere) and ``foot`` (text of a last row over all columns).
    """
    assert all(len(row) == len(head) == len(widths) for row in rows)
    return {
        "kind": "table",
        "head": list(head),
        "rows": [list(row) for row in rows],
        "widths": list(widths),
        "align": list(align or ["left"] * len(head)),
        **layout,
    }


def bullets(items: Sequence[Cell]) -> Block:
    """Return a list."""
    return {"kind": "list", "items": list(items)}


def together(*blocks: Block) -> Block:
    """Return blocks that stay on one page.

    blocks: The blocks; together they are shorter than a page.
    """
    return {"kind": "together", "blocks": list(blocks)}


def mono(text: str) -> Cell:
    """Return a cell for a hash, a fingerprint or a file name.

    Returns: The cell; an empty text stays empty.
    """
    return {"text": text, "mono": True} if text else ""


def with_index(text: str, index: str) -> Cell:
    """Return a cell with a lowered index."""
    return {"text": text, "sub": index}


def with_note(text: str, note: str, **style: Any) -> Cell:
    """Return a cell with small print under its text.

    style: ``bold`` or ``mono``.
    """
    return {"text": text, "note": note, **style}


def at_the_point(texts: Sequence[str]) -> list[Cell]:
    """Return cells of a column, aligned to the right, whose decimal points stand below each other."""
    decimals = [len(text.partition(".")[2]) if _is_plain(text) else 0 for text in texts]
    most = max(decimals, default=0)
    cells: list[Cell] = []
    for text, own in zip(texts, decimals, strict=True):
        point = _POINT_EM if most and not own else 0.0
        pad = round((most - own) * _DIGIT_EM + point, 4) if _is_plain(text) else 0.0
        cells.append({"text": text, "pad": pad} if pad else text)
    return cells


def _is_plain(text: str) -> bool:
    return bool(text) and set(text) <= set("0123456789.-+" + MINUS)


def printed(text: str) -> str:
    """Return a printed number of the certificate with a true minus sign.

    text: The number, with ``-`` for minus.
    """
    return MINUS + text[1:] if text.startswith("-") else text


def compact(value: float | None, digits: int = 3) -> str:
    """Print a computed number with a number of significant digits, as a power of ten where it is very small or large.

    value: The number; None is printed as a dash.
    Returns: The number with a true minus sign.

    Examples
    --------
    >>> compact(0.4149821), compact(-1.2345e-7), compact(0.0), compact(None)
    ('0.415', '−1.23·10⁻⁷', '0', '–')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    if value == 0 or _PLAIN_FROM <= abs(value) < _PLAIN_TO:
        return number(float(value), digits)
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    return f"{printed(mantissa)}·10{str(int(power)).translate(SUPERSCRIPTS)}"


def stated(value: float | None, digits: int = 9) -> str:
    """Print a number that somebody stated, with all its digits.

    value: The number; None is printed as a dash.
    Returns: The number with a true minus sign.

    Examples
    --------
    >>> stated(255.0), stated(4.5e-06), stated(-0.5)
    ('255', '4.5·10⁻⁶', '−0.5')
    """
    if value is None:
        return NOTHING
    text = exact(float(f"{value:.{digits}g}"))
    if "e" not in text:
        return text
    mantissa, power = text.replace(MINUS, "-").split("e")
    return f"{printed(mantissa)}·10{str(int(power)).translate(SUPERSCRIPTS)}"


def with_unit(text: str, unit: str) -> str:
    """Return a printed number with its unit.

    unit: The unit; ``1`` and an empty text are not printed.
    """
    return text if unit in ("", "1") or text == NOTHING else f"{text} {unit}"


def freedom(value: float | None) -> str:
    """Print degrees of freedom.

    value: The degrees of freedom; None for infinite.
    """
    return "∞" if value is None else compact(value)


def percent(share: float) -> str:
    """Print a share in percent, with one decimal.

    share: The share, 0 to 1.
    Returns: The share; a share below 0.05 % as ``< 0.1``.

    Examples
    --------
    >>> percent(0.3731), percent(1e-7), percent(0.0), percent(1.0)
    ('37.3', '< 0.1', '0', '100.0')
    """
    if share == 0:
        return "0"
    return f"{100 * share:.1f}" if share >= 0.0005 else "< 0.1"
