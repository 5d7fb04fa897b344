"""Comparison with the simulated truth."""

from types import SimpleNamespace

import numpy as np
import pytest

from bench.results.solution import compare_with_truth
from simulators.config import bench_config

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "x", "y", "r")
CALIBRATION = SimpleNamespace(
    parameter_names=NAMES, values=np.arange(1.0, 10.0), sigma=dict.fromkeys(NAMES, 0.5)
)


def rows(collimator: str):
    truth = bench_config({"collimator": collimator}).truth.to_dict()
    return {row["name"]: row for row in compare_with_truth(CALIBRATION, truth)}


def test_each_value_is_compared_in_its_unit_and_in_its_uncertainty():
    found = rows("ideal")
    assert tuple(found) == NAMES
    assert found["fx"]["error"] == pytest.approx(1.0 - 3345.06)
    assert found["fx"]["error_sigmas"] == pytest.approx(2 * (1.0 - 3345.06))


def test_the_apparent_centre_is_not_compared_with_that_of_an_ideal_collimator():
    assert tuple(rows("like-bench")) == ("fx", "fy", "cx", "cy", "k1", "k2", "r")
