"""The gauge study against published worked examples, to their printed digits, and on scatter that is known."""

import numpy as np
import pytest

from bench.base.errors import UsageError
from bench.charts.statistics import capability, study

# AIAG, Measurement Systems Analysis, 4th edition (2010): 10 parts, 3 appraisers, 3 trials (rows of an appraiser).
AIAG = {
    "A": """0.29 -0.56 1.34 0.47 -0.80  0.02 0.59 -0.31 2.26 -1.36
            0.41 -0.68 1.17 0.50 -0.92 -0.11 0.75 -0.20 1.99 -1.25
            0.64 -0.58 1.27 0.64 -0.84 -0.21 0.66 -0.17 2.01 -1.31""",
    "B": """0.08 -0.47 1.19 0.01 -0.56 -0.20 0.47 -0.63 1.80 -1.68
            0.25 -1.22 0.94 1.03 -1.20  0.22 0.55  0.08 2.12 -1.62
            0.07 -0.68 1.34 0.20 -1.28  0.06 0.83 -0.34 2.19 -1.50""",
    "C": """0.04 -1.38 0.88 0.14 -1.46 -0.29 0.02 -0.46 1.77 -1.49
           -0.11 -1.13 1.09 0.20 -1.07 -0.67 0.01 -0.56 1.45 -1.77
           -0.15 -0.96 0.67 0.11 -1.45 -0.49 0.21 -0.49 1.87 -2.16""",
}
# NIST/SEMATECH e-Handbook of Statistical Methods, 3.2.3.2: diameters of pins, 5 machines, 2 operators, 5 samples.
NIST = [
    ((0.125, 0.127, 0.125, 0.126, 0.128), (0.124, 0.128, 0.127, 0.126, 0.129)),
    ((0.118, 0.122, 0.120, 0.124, 0.119), (0.116, 0.125, 0.119, 0.125, 0.120)),
    ((0.123, 0.125, 0.125, 0.124, 0.126), (0.122, 0.121, 0.124, 0.126, 0.125)),
    ((0.126, 0.128, 0.126, 0.127, 0.129), (0.126, 0.129, 0.125, 0.130, 0.124)),
    ((0.118, 0.129, 0.127, 0.120, 0.121), (0.125, 0.123, 0.114, 0.124, 0.117)),
]


def of_aiag():
    rows = [
        (float(value), f"part {at % 10}", appraiser)
        for appraiser, text in AIAG.items()
        for at, value in enumerate(text.split())
    ]
    values, parts, appraisers = zip(*rows, strict=True)
    return study(values, parts, {"operator": appraisers})


def of_nist():
    rows = [
        (value, f"machine {machine}", f"operator {operator}")
        for machine, of_machine in enumerate(NIST)
        for operator, samples in enumerate(of_machine)
        for value in samples
    ]
    values, machines, operators = zip(*rows, strict=True)
    return study(values, machines, {"operator": operators})


def test_the_table_of_aiag_to_its_printed_digits():
    table = {term.name: term for term in of_aiag().terms}
    printed = {
        "operator": (2, "3.1673", "1.58363", "34.44"),
        "camera": (9, "88.3619", "9.81799", "213.52"),
        "camera x operator": (18, "0.3590", "0.01994", "0.434"),
    }
    for name, (degrees, squares, mean, ratio) in printed.items():
        term = table[name]
        decimals = len(ratio.partition(".")[2])
        cells = f"{term.sum_of_squares:.4f}", f"{term.mean_square:.5f}", f"{term.f:.{decimals}f}"
        assert (term.degrees_of_freedom, *cells) == (degrees, squares, mean, ratio)
    equipment = table["repeatability"]
    assert equipment.degrees_of_freedom == 60
    assert (f"{equipment.sum_of_squares:.4f}", f"{equipment.mean_square:.5f}") == ("2.7589", "0.04598")


def test_the_components_of_aiag_to_their_printed_digits():
    aiag = of_aiag()
    assert aiag.pooled == ("camera x operator",)
    sigmas = aiag.repeatability, aiag.reproducibility, aiag.components["camera"], aiag.gauge
    assert [f"{sigma:.6f}" for sigma in sigmas[:3]] == ["0.199933", "0.226838", "1.042327"]
    assert aiag.gauge == pytest.approx(0.302373, abs=2e-6)  # the root of its own parts is 0.302372
    assert f"{aiag.total:.3f}" == "1.085"
    assert [f"{100 * sigma / aiag.total:.1f}" for sigma in sigmas] == ["18.4", "20.9", "96.0", "27.9"]
    assert aiag.categories == 4
    assert aiag.verdict == "conditional"


def test_the_table_of_nist_to_its_printed_digits():
    machine, operator, both, error = of_nist().terms
    assert [f"{term.sum_of_squares:.3g}" for term in (machine, operator, both, error)] == [
        "0.000303",
        "3.92e-06",
        "1.47e-05",
        "0.000346",
    ]
    assert [term.degrees_of_freedom for term in (machine, operator, both, error)] == [4, 1, 4, 40]
    assert [f"{term.f:.2g}" for term in (machine, operator, both)] == ["8.8", "0.45", "0.42"]


@pytest.mark.parametrize(
    ("lower", "upper", "cp", "cpk"), [(8, 20, 1.0, 0.6667), (8, None, None, 8 / 6), (None, 24, None, 8 / 6)]
)
def test_cp_and_cpk_are_those_of_nist_and_one_limit_has_no_cp(lower, upper, cp, cpk):
    able = capability(lower, upper, 16, 2)
    assert (able.cp, able.tolerance_percent is None) == (cp, cp is None)
    assert able.cpk == pytest.approx(cpk, abs=5e-5)


def test_unequal_repeats_and_three_factors_give_the_scatter_that_was_put_in():
    rng = np.random.default_rng(3)
    true = {"camera": 5.0, "operator": 0.6, "bench": 0.8, "day": 0.4, "repeatability": 0.3}
    variances = []
    for _ in range(40):
        shape = {"camera": 8, "operator": 4, "bench": 3, "day": 6}
        effects = {name: rng.normal(0, true[name], count) for name, count in shape.items()}
        levels = {name: rng.integers(0, count, 160) for name, count in shape.items()}
        y = sum(effects[name][levels[name]] for name in shape) + rng.normal(0, 0.3, 160)
        named = {name: [str(level) for level in levels[name]] for name in shape}
        cameras = named.pop("camera")
        result = study(y, cameras, named)
        variances.append({name: result.components.get(name, 0.0) ** 2 for name in true})
    for name, sigma in true.items():
        squares = np.array([of_study[name] for of_study in variances])
        assert abs(squares.mean() - sigma**2) < 3.5 * squares.std() / np.sqrt(len(variances)) + 0.01


@pytest.mark.parametrize(
    ("cameras", "operators", "message"),
    [
        ("aabb", "xxxx", "A gauge study needs at least 2 operators; these runs have 1: x."),
        ("aaaa", "xyxy", "A gauge study needs at least 2 cameras; these runs have 1: a."),
        ("aabb", "xyxy", "Each camera was measured only once under each condition"),
        ("aaabbb", "xxxyyy", "These runs do not show the effect of the operator"),
    ],
)
def test_runs_that_hold_no_study_are_refused_with_what_is_missing(cameras, operators, message):
    with pytest.raises(UsageError) as caught:
        study(range(len(cameras)), list(cameras), {"operator": list(operators)})
    assert caught.value.what.startswith(message)
