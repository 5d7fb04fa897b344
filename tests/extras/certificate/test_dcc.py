"""The digital calibration certificate: its statements, its units, and its signature."""

import dataclasses
import json
import re

import certificate_sample
import pytest
from dcc_checks import check_dcc
from lxml import etree

from bench.base import entry_points
from bench.base.bounded_json import leaves
from bench.base.encoding import plain_number
from bench.base.errors import UsageError
from bench.extras.certificate.certificate_data import Software
from bench.extras.certificate.certificate_folder import require_libraries
from bench.extras.certificate.d_si import OUR_UNITS, is_unit
from bench.extras.certificate.dcc import ellipsoid_factor, number_text, render_dcc
from bench.extras.certificate.dcc_xml import NAMESPACES, differs_by_a_signature


def dcc_of(certificate):
    return etree.fromstring(render_dcc(certificate))


def texts(root, path):
    return [element.text for element in root.xpath(path, namespaces=NAMESPACES)]


@pytest.mark.parametrize("dcc", [certificate_sample.full_dcc, certificate_sample.small_dcc])
def test_a_certificate_does_not_contradict_itself(dcc):
    assert check_dcc(dcc()) == []


def test_results_are_stated_as_printed_with_k_p_and_distribution():
    root = dcc_of(certificate_sample.full_certificate())
    fx = "//dcc:quantity[@id='result-fx']"
    assert texts(root, f"{fx}/si:real/*[not(*)]") == ["fx", "3346.0", r"\one"]
    expanded = ["2.0", "2.0159", "0.9545", "posterior of the adjustment"]
    assert texts(root, f"{fx}/si:real/si:expandedUnc/*") == expanded
    assert texts(root, "//dcc:nonSIUnit") == ["pixel"]


@pytest.mark.parametrize(("k", "distribution"), [(2.0, "normal"), (2.24, "posterior of the adjustment")])
def test_without_degrees_of_freedom_only_the_k_of_a_normal_distribution_is_called_normal(k, distribution):
    full = certificate_sample.full_certificate()
    first = dataclasses.replace(full.results[0], nu_eff=None, k=k)
    root = dcc_of(dataclasses.replace(full, results=(first, *full.results[1:])))
    assert texts(root, "//dcc:quantity[@id='result-fx']//si:expandedUnc/si:distribution") == [distribution]


def test_every_number_of_the_certificate_is_in_the_dcc():
    certificate = certificate_sample.full_certificate()
    data = render_dcc(certificate).decode()
    for result in certificate.results:
        assert f">{result.printed_value}<" in data
        assert f">{result.printed_uncertainty}<" in data
    for further in certificate.further:
        assert f">{number_text(further.value)}<" in data
    for budget in certificate.budgets:
        for row in budget.rows:
            assert f">{number_text(row.u)}<" in data


def test_every_text_of_the_certificate_is_in_the_dcc():
    certificate = certificate_sample.full_certificate()
    in_dcc = " ".join(" ".join(etree.fromstring(render_dcc(certificate)).itertext()).split())
    not_said = {certificate.format, certificate.series}
    not_said |= {entry.id for part in (certificate.further, certificate.statements) for entry in part}
    not_said |= {entry.text for entry in certificate.further}  # the numbers behind them are stated
    not_said |= {certificate.run.sequence, certificate.run.station}
    units = {"px", "mm", "1", "%", "°C", "Hz", "arcsec", "lx", "Mev/s", "px/mm", "1/mm", "", "starbench"}
    for _, text in leaves(json.loads(certificate.to_json())):
        if not isinstance(text, str) or text in not_said or text in units or "/ (" in text:
            continue
        dated = re.fullmatch(r"\d{4}-\d\d-\d\dT.*Z", text)
        assert " ".join(text.split()) in in_dcc or (dated and text[:10] in in_dcc), text


def test_a_certificate_with_hardly_anything_is_still_whole():
    small = certificate_sample.small_certificate()
    camera = dataclasses.replace(small.item.camera, model="EVK4", firmware="", sensor="", biases=())
    lens = small.item.lens.model_copy(update=dict.fromkeys(("maker", "model", "serial"), ""))
    item = dataclasses.replace(small.item, camera=camera, lens=lens)
    nothing = dict.fromkeys(("traceability", "conditions", "further", "budgets"), ())
    assert check_dcc(render_dcc(dataclasses.replace(small, item=item, received="", **nothing))) == []


def test_units_that_d_si_lacks_are_stated_in_words():
    full = certificate_sample.full_certificate()
    odd = dataclasses.replace(full.conditions[0], value=3.5, unit="furlong", U=0.5, k=2.0)
    data = render_dcc(dataclasses.replace(full, conditions=(odd,)))
    assert b"3.5 furlong, U = 0.5" in data
    assert check_dcc(data) == []


@pytest.mark.parametrize(("k", "distribution"), [(2.0, "normal"), (2.4, "posterior of the adjustment")])
def test_the_ellipsoid_of_a_posterior_is_as_much_wider_as_its_widest_result(k, distribution):
    full = certificate_sample.full_certificate()
    first, *others = (dataclasses.replace(result, nu_eff=None, k=2.0) for result in full.results)
    root = dcc_of(dataclasses.replace(full, results=(dataclasses.replace(first, k=k), *others)))
    region = "//si:ellipsoidalRegionXMLList/si:"
    assert texts(root, f"{region}distribution") == [distribution]
    normal = ellipsoid_factor(len(full.covariance.names), first.p, None)
    assert float(texts(root, f"{region}coverageFactor")[0]) == pytest.approx(normal * k / 2, rel=1e-4)


@pytest.mark.parametrize(
    ("n", "nu", "expected"), [(1, None, 2.0), (6, None, 3.585), (1, 12.48, 2.2214), (6, 12.48, 4.276)]
)
def test_ellipsoid_factor(n, nu, expected):
    """Those of six dimensions: 2 million draws gave 3.587 and 4.276. Those of one are the factors of results."""
    assert ellipsoid_factor(n, 0.9545, nu) == pytest.approx(expected, rel=2e-3)


def test_numbers_are_finite_and_coverage_factors_have_no_exponent():
    for value in (float("nan"), float("inf"), -float("inf")):
        with pytest.raises(ValueError, match="is not a number"):
            number_text(value)
    assert [plain_number(k, 4) for k in (2, 2.22151, 100.0, 0.00012)] == ["2", "2.2215", "100", "0.0001"]


def test_what_wrote_the_certificate_is_told_apart_from_what_measured():
    full = certificate_sample.full_certificate()
    programs = (Software("starbench", "0.1.0rc2"), Software("numpy", "2.4.6"))
    writers = (Software("certificate_form", "1fe3aa0011223344"), Software("lxml", "6.1.3"))
    run = dataclasses.replace(full.run, software=(*programs, *writers))
    data = render_dcc(dataclasses.replace(full, run=run))
    for place, names, releases in (
        ("usedSoftware", ["starbench", "numpy"], ["v0.1", "v2.4.6"]),
        ("dccSoftware", ["starbench", "certificate_form", "lxml"], ["v0.1", "v0", "v6.1.3"]),
    ):
        root = etree.fromstring(data)
        assert texts(root, f"//dcc:{place}//dcc:name/dcc:content") == names
        assert texts(root, f"//dcc:{place}//dcc:release") == releases
    assert b"Full version: 0.1.0rc2" in data
    assert b"Full version: 1fe3aa0011223344" in data
    assert check_dcc(data) == []


def test_a_range_is_stated_with_both_ends():
    full = certificate_sample.full_certificate()
    text = "71.3566 to 86.9117 Mev/s"
    unknown = {"value": None, "U": None, "unit": "Mev/s"}
    rate = dataclasses.replace(full.conditions[0], name="event rate", text=text, **unknown)
    odd = dataclasses.replace(rate, text="71 to 86 furlong", unit="furlong")
    root = dcc_of(dataclasses.replace(full, conditions=(rate, odd)))
    first, second = root.xpath("//dcc:influenceCondition", namespaces=NAMESPACES)
    assert texts(first, ".//si:value") == ["71.3566", "86.9117"]
    assert set(texts(first, ".//si:unit")) == {r"\micro\second\tothe{-1}"}
    assert texts(second, "dcc:data/dcc:text/dcc:content") == ["71 to 86 furlong"]


# ---------------------------------------------------------------- units


UNITS = [
    *sorted(set(OUR_UNITS.values())),
    r"\metre\per\second\tothe{2}", r"\metre\tothe{-1}", r"\metre\tothe{0.5}", r"\micro\arcsecond", r"\kibi\byte",
    r"\milli\bar", r"\ppm\per\kelvin", r"\kilogram\metre\second\tothe{-2}", r"\deci\bel",
]  # fmt: skip
NO_UNITS = [
    "", "foo", "metre", r"\pixel", r"\px", r"\foo", r"\milli", r"\milli\milli\metre", r"\metre\per", r"\per\second",
    r"\metre\per\second\per\second", r"\metre\tothe2", r"\metre\tothe{x}", r"\tothe{2}", r"\metre\tothe{2}\tothe{2}",
    r"\one\tothe{2}", r"\milli\one", r"\kilo\gram", r"\kilo\kilogram", r"\kibi\metre", r"\milli\tothe{2}",
    r"\metre \second", "\\metre\n", r"\\metre", r"|pixel", "\\", r"\metre\\second", "mm", "\\µ\\metre",
]  # fmt: skip


@pytest.mark.parametrize("unit", [*UNITS, *NO_UNITS])
def test_units_are_those_of_d_si(unit):
    assert is_unit(unit) is (unit in UNITS)


SIGNATURE = b'<ds:Signature xmlns:ds="http://www.w3.org/2000/09/xmldsig#" Id="a"><ds:SignatureValue/></ds:Signature>\n'
END = b"</dcc:digitalCalibrationCertificate>\n"


def test_one_signature_before_the_end_is_told_from_every_other_change():
    dcc = certificate_sample.small_dcc()
    assert differs_by_a_signature(dcc.replace(END, SIGNATURE + END), dcc)
    for other in (
        dcc,
        b"",
        dcc.replace(END, SIGNATURE + SIGNATURE + END),
        dcc.replace(END, b"<dcc:comment/>\n" + SIGNATURE + END),
        dcc.replace(END, SIGNATURE + b"more\n" + END),
        dcc.replace(END, b"<ds:Signature/><dcc:comment/>" + SIGNATURE + END),
        dcc.replace(END, SIGNATURE + END).replace(b"3.2.1", b"3.2.2", 1),
    ):
        assert not differs_by_a_signature(other, dcc)


def test_a_missing_library_is_named(monkeypatch):
    def refuse(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(entry_points, "import_module", refuse)
    with pytest.raises(UsageError, match=r"lxml is not installed.*starbench\[certificate\]"):
        require_libraries()
