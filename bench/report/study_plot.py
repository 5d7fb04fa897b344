"""The plot of a simulation study: histograms of the errors beside the normal distribution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.report.drawing import INK, POSE_COLOURS
from bench.report.plot_frame import Words, axes_in
from bench.report.scales import Scale
from bench.report.svg_plot import Picture

Array = NDArray[np.float64]

_REACH, _BINS = 4.0, 33
_ACROSS = 3
_WIDTH, _HEIGHT, _GAP = 216.0, 140.0, 12.0
_FOOT = 22.0


def study_plot(names: Sequence[str], z: Array, rms: Mapping[str, float]) -> str:
    """Draw the errors of each parameter as a histogram beside the normal distribution.

    z: (N, K) float64: error of each calibration over its stated standard uncertainty.
    rms: Root mean square of each column of ``z``.
    Returns: SVG. Errors beyond four standard uncertainties count in the outermost bins.
    """
    rows = -(-len(names) // _ACROSS)
    about = "; ".join(f"{name}: rms {rms[name]:.2f}" for name in names) + "."
    label = "Errors over their stated standard uncertainties, beside the normal distribution"
    picture = Picture(_ACROSS * _WIDTH, rows * _HEIGHT + _FOOT, "study", label, about)
    edges = np.linspace(-_REACH, _REACH, _BINS)
    curve = np.linspace(-_REACH, _REACH, 101)
    normal = np.exp(-0.5 * curve**2) / np.sqrt(2 * np.pi)
    for number, name in enumerate(names):
        row, column = divmod(number, _ACROSS)
        shown = np.clip(z[:, number], -_REACH, _REACH)
        high, _ = np.histogram(shown, edges, density=True)
        top = 1.08 * max(float(high.max()), float(normal.max()))
        place = (column * _WIDTH, row * _HEIGHT, _WIDTH - _GAP, _HEIGHT - _GAP / 2)
        words = Words((f"{name}: rms {rms[name]:.2f}",))
        axes = axes_in(picture, Scale(-_REACH, _REACH), Scale(0.0, top, ticks=()), words, place=place)
        steps = np.column_stack([np.repeat(edges, 2), np.concatenate([[0.0], np.repeat(high, 2), [0.0]])])
        axes.shapes([steps], POSE_COLOURS[0], 0.35)
        axes.line(np.column_stack([curve, normal]), INK, 1.2)
    foot = "error / stated standard uncertainty; the line is the normal distribution"
    picture.text(picture.width / 2, picture.height - 6.0, foot, anchor="middle")
    return picture.svg()
