import pytest
from dcc_checks import powers

from bench.certificate.dcc_units import OUR_UNITS, d_si_unit, is_unit, length_mm, product


@pytest.mark.parametrize("unit", sorted(set(OUR_UNITS.values())))
def test_our_units_are_units_of_d_si(unit):
    assert is_unit(unit)


@pytest.mark.parametrize(
    "unit",
    [
        r"\metre\per\second\tothe{2}", r"\metre\tothe{-1}", r"\metre\tothe{0.5}", r"\micro\arcsecond", r"\kibi\byte",
        r"\milli\bar", r"\ppm\per\kelvin", r"\kilogram\metre\second\tothe{-2}", r"\deci\bel",
    ],
)  # fmt: skip
def test_units(unit):
    assert is_unit(unit)


@pytest.mark.parametrize(
    "unit",
    [
        "", "foo", "metre", r"\pixel", r"\px", r"\foo", r"\milli", r"\milli\milli\metre", r"\metre\per", r"\per\second",
        r"\metre\per\second\per\second", r"\metre\tothe2", r"\metre\tothe{x}", r"\tothe{2}", r"\metre\tothe{2}\tothe{2}",
        r"\one\tothe{2}", r"\milli\one", r"\kilo\gram", r"\kilo\kilogram", r"\kibi\metre", r"\milli\tothe{2}",
        r"\metre \second", "\\metre\n", r"\\metre", r"|pixel", "\\", r"\metre\\second", "mm", "\\µ\\metre",
    ],
)  # fmt: skip
def test_no_units(unit):
    assert not is_unit(unit)


@pytest.mark.parametrize(
    ("printed", "written"),
    [
        ("px", r"\one"), ("mm", r"\milli\metre"), ("arcsec", r"\arcsecond"), ("°C", r"\degreecelsius"),
        ("px / (mm)", r"\milli\metre\tothe{-1}"), ("px / (mm/K)", r"\milli\metre\tothe{-1}\kelvin"),
        ("1 / (1)", r"\one"), ("events/s", r"\second\tothe{-1}"), (r"\milli\metre", r"\milli\metre"),
        ("mm at 40 mm", None), ("px / (%)", None), ("px/", None), ("furlong", None), ("mm//s", None), ("", r"\one"),
    ],
)  # fmt: skip
def test_printed_units(printed, written):
    assert d_si_unit(printed) == written


def test_products_have_the_powers_of_their_factors():
    assert powers(product(r"\milli\metre", r"\milli\metre")) == {"millimetre": 2}
    assert powers(product(r"\radian", r"\milli\metre")) == {"radian": 1, "millimetre": 1}
    assert powers(r"\metre\per\second\tothe{2}") == powers(r"\metre\second\tothe{-2}")
    assert powers(r"\metre\per\metre") == {}


def test_lengths():
    assert length_mm(0.255, r"\metre") == pytest.approx(255.0)
    assert length_mm(255.0, r"\milli\metre") == 255.0
    assert length_mm(1.0, r"\kilo\metre") == 1e6
    assert length_mm(1.0, r"\second") is length_mm(1.0, r"\foo\metre") is None
