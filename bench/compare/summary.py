"""Statistics of a comparison: for each column the spread over the repetitions, errors against truth, and coverage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.compare.outside_check import bench_time_s
from bench.compare.spec import ComparisonConfig

Row = Mapping[str, Any]

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2")


def summarise(spec: ComparisonConfig, rows: Sequence[Row]) -> dict[str, Any]:
    """Summarise the rows of a comparison.

    Returns: ``columns``: for each column its statistics, in the order of the specification.
    """
    return {
        "schema": "starbench/comparison-results/1",
        "name": spec.name,
        "about": spec.about,
        "seed": spec.seed,
        "repetitions": spec.repetitions,
        "columns": [
            {
                "settings": column.model_dump(),
                "bench_time_s": None if column.data else bench_time_s(column),
                **_column([row for row in rows if row["column"] == column.name]),
            }
            for column in spec.columns
        ],
    }


def _column(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the statistics of one column."""
    good = [row for row in rows if "error" not in row]
    failures: dict[str, int] = {}
    for row in rows:
        if "error" in row:
            failures[row["error"]] = failures.get(row["error"], 0) + 1
    found: dict[str, Any] = {
        "solved": len(good),
        "failed": [{"why": why, "times": times} for why, times in failures.items()],
        "images_cpu_s": _mean([row["images_cpu_s"] for row in rows]),
    }
    if not good:
        return found
    found["parameters"] = {
        name: {
            "mean": _mean([row["camera"][name] for row in good]),
            "spread": _deviation([row["camera"][name] for row in good]),
            "rms_error": _rms([row["errors"].get(name) for row in good]),
            "stated_sigma": _rms([row["sigma"].get(name) for row in good]),
        }
        for name in PARAMETERS
        if name in good[0]["camera"]
    }
    for key in ("rms_px", "mean_px", "left_out_px", "direction_rms_urad", "centre_urad"):
        found[key] = _rms([row[key] for row in good])
    found["gimbal_ratio_error"] = _rms([row.get("gimbal_ratio_error") for row in good])
    found["halves_urad"] = _rms([row.get("halves_urad") for row in good])
    found["direction_worst_urad"] = _largest([row["direction_worst_urad"] for row in good])
    found["corner_rms_urad"] = _rms([row["corner_urad"] for row in good])
    found["corner_worst_urad"] = _largest([row["corner_urad"] for row in good])
    found["expanded_fx_px"] = _mean([row["k"] * row["sigma"]["fx"] for row in good if "fx" in row["sigma"]])
    found["coverage"] = {
        what: _mean([float(row["covered"][what]) for row in good if what in row["covered"]])
        for what in ("fx", "fy", "cx", "cy", "corner")
        if any(what in row["covered"] for row in good)
    }
    found["models"] = {
        str(model): sum(row.get("model") == model for row in good)
        for model in {row.get("model") for row in good}
    }
    found["views"] = _mean([float(row["views"]) for row in good])
    found["solve_cpu_s"] = _mean([row["solve_cpu_s"] for row in good])
    return found


def _known(numbers: Sequence[float | None]) -> list[float]:
    return [number for number in numbers if number is not None]


def _mean(numbers: Sequence[float | None]) -> float | None:
    known = _known(numbers)
    return float(np.mean(known)) if known else None


def _rms(numbers: Sequence[float | None]) -> float | None:
    known = _known(numbers)
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _deviation(numbers: Sequence[float | None]) -> float | None:
    known = _known(numbers)
    return float(np.std(known, ddof=1)) if len(known) > 1 else None


def _largest(numbers: Sequence[float | None]) -> float | None:
    known = _known(numbers)
    return float(max(known)) if known else None
