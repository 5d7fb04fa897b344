"""What the paper prints for its one real camera: Table 1 of arXiv:2512.16092. There is no truth, and no error bar."""

from __future__ import annotations

PAPER_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "reprojection error, px", "images")

PAPER_TABLE_1: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "paper: Prophesee toolbox, checkerboard on a screen",
        ("3365.18", "3364.93", "633.21", "362.05", "0.65", "-1.39", "0.45", "20"),
    ),
    (
        "paper: MATLAB toolbox, the same images",
        ("3337.61", "3337.25", "624.07", "369.07", "-0.07", "5.43", "0.41", "20"),
    ),
    (
        "paper: Zhang, collimator",
        ("3412.76", "3412.75", "647.06", "366.26", "0.06", "-0.08", "0.10", "3"),
    ),
    (
        "paper: its own method, the same images",
        ("3345.06", "3345.27", "642.10", "363.32", "0.06", "-0.90", "0.08", "3"),
    ),
)
"""Rows of the table: the method, and its values in the order of `PAPER_NAMES`."""
