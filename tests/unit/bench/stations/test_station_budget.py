"""Sections of a station file about budget, collimator and readings."""

import re
from contextlib import nullcontext
from datetime import date

import numpy as np
import pytest
from refusals import faults_of
from station_texts import PLAIN, station_of, without

from bench.stations.station_budget import CertificateConfig
from sequences.errors import DocumentFaults

# ---------------------------------------------------------------- budget

WITHOUT_COLLIMATOR = without(PLAIN, "collimator")

FULL = """
budget:
  print_scale: {value: 20e-6, distribution: rectangular, source: "maker's drawing", correction: 1e-4}
  print_bow: {value_mm: 0.01, radius_mm: 40, distribution: triangular, source: drawing}
  thermal: {expansion_per_c: 9e-6, expansion_sigma_per_c: 1e-6, sigma_c: 1, reference_c: 20, source: glass}
  collimator_thermal: {expansion_per_c: 2e-5, sigma_c: 0.5, source: aluminium}
  effective_radius: {relative: 6e-4, k: 2, degrees_of_freedom: 8, source: twenty views}
  wavefront: {urad_rms: 5, correlation_mm: 30, source: interferometer}
"""


def station(more: str):
    return station_of(PLAIN + more)


def faults(more: str) -> list[str]:
    return faults_of(station, more)


def terms(more: str):
    read = station(more)
    return {term.kind: term for term in read.budget.terms(read.collimator)}


def with_collimator(section: str) -> str:
    read = station_of(f"{WITHOUT_COLLIMATOR}\n{FULL}{section}")
    return {term.kind: term for term in read.budget.terms(read.collimator)}


def test_each_part_is_a_term_with_value_distribution_and_source():
    term_of = terms(FULL)
    assert list(term_of) == re.findall(r"^  (\w+):", FULL, re.MULTILINE)
    scale = term_of["print_scale"]
    assert (scale.value, scale.correction) == (20e-6, 1e-4)
    assert (scale.distribution, scale.source) == ("rectangular", "maker's drawing")
    assert scale.standard_uncertainty == pytest.approx(20e-6 / 3**0.5)
    assert (term_of["print_bow"].value, term_of["print_bow"].radius_mm) == (0.01, 40)
    assert term_of["effective_radius"].standard_uncertainty == pytest.approx(3e-4)
    assert term_of["effective_radius"].degrees_of_freedom == 8
    assert term_of["print_bow"].degrees_of_freedom == float("inf")
    assert term_of["wavefront"].value == 5


def test_temperatures_come_from_the_section_then_from_the_collimator():
    unknown = with_collimator("")
    assert unknown["thermal"].correction == 0
    assert unknown["thermal"].standard_uncertainty == pytest.approx((9e-6**2 + 1e-6**2) ** 0.5)
    certificate = "{r_mm: 255, uncertainty_mm: 0.1, number: T-1, temperature_c: 22}"
    warm = with_collimator(f"collimator: {{temperature_c: 25, certificate: {certificate}}}\n")
    assert warm["thermal"].correction == pytest.approx(5 * 9e-6)
    assert warm["thermal"].standard_uncertainty == pytest.approx((9e-6**2 + 5e-6**2 + 1e-6**2) ** 0.5)
    assert warm["collimator_thermal"].correction == pytest.approx(3 * 2e-5)
    own = terms("\nbudget:\n  thermal: {expansion_per_c: 9e-6, temperature_c: 30, sigma_c: 1, source: x}\n")
    assert own["thermal"].correction == pytest.approx(10 * 9e-6)


@pytest.mark.parametrize(
    ("section", "column", "fault_text"),
    [
        ("print_scale: {value: -1e-5, source: x}", 24, "must be 0 or more"),
        ("print_scale: {value: 1e-5, distribution: gaussian, source: x}", 44, "triangular"),
        ("print_scale: {value: 1e-5, source: x, distribution: rectangular, k: 2}", 16, "k applies"),
        ("print_bow: {value_mm: 0.01, source: x}", 14, "radius_mm"),
        ("wavefront: {urad_rms: 5, source: '  '}", 36, "must not be empty"),
        ("bow: {value_mm: 1}", 3, "bow"),
    ],
)
def test_a_fault_names_line_and_column(section, column, fault_text):
    (fault,) = faults(f"\nbudget:\n  {section}\n")
    line = PLAIN.count("\n") + 3
    assert fault.startswith(f"station.yaml:{line}:{column}: budget")
    assert fault_text in fault


FLAT = """
budget:
  print_bow: {value_mm: 0.001, radius_mm: 40, distribution: rectangular, source: maker}
  collimator_distortion: {relative: 1e-5, at_deg: 10, distribution: rectangular, source: interferogram}
"""


def test_bow_and_distortion_give_the_prior_of_the_radial_term():
    by_bow = 1e-3 / 3**0.5 * 255.0 / 40**2
    by_distortion = 1e-5 / 3**0.5 / np.tan(np.deg2rad(10.0)) ** 2
    assert station(FLAT).budget.radial_sigma(255.0) == pytest.approx(np.hypot(by_bow, by_distortion))
    assert station(FLAT).budget.radial_sigma(255.0) == pytest.approx(2.1e-4, rel=0.02)
    assert "collimator_distortion" not in terms(FLAT)


@pytest.mark.parametrize("missing", ["print_bow", "collimator_distortion"])
def test_one_of_bow_and_distortion_alone_says_nothing_about_their_sum(missing):
    more = "\n".join(line for line in FLAT.splitlines() if missing not in line)
    assert station(more).budget.radial_sigma(255.0) is None


# ---------------------------------------------------------------- collimator and readings


def knowing(section: str):
    return station_of(f"{WITHOUT_COLLIMATOR}\n{section}\n")


@pytest.mark.parametrize(("r_mm", "refused"), [(216, True), (217, False), (293, False), (294, True)])
def test_a_certificate_within_fifteen_percent_of_the_data_sheet_is_of_this_collimator(r_mm, refused):
    section = (
        f"collimator: {{nominal_r_mm: 255, certificate: {{r_mm: {r_mm}, number: 1, uncertainty_mm: 1}}}}"
    )
    with pytest.raises(DocumentFaults) if refused else nullcontext():
        assert knowing(section).collimator.certificate.r_mm == r_mm


def test_a_certificate_has_values_and_an_older_one_is_a_text():
    values = knowing(
        "collimator: {certificate: {r_mm: 255.03, uncertainty_mm: 0.1, number: 7, date: 2026-01-31}}"
    )
    certificate = values.collimator.certificate
    assert isinstance(certificate, CertificateConfig)
    assert (certificate.sigma_mm, certificate.number, certificate.date) == (0.05, "7", date(2026, 1, 31))
    assert knowing("collimator: {certificate: T-1}").collimator.certificate == "T-1"
    assert knowing("collimator: {certificate: }").collimator.certificate is None
    assert knowing("collimator: {serial: '1'}").gimbal is None


@pytest.mark.parametrize(
    ("section", "fault_text"),
    [
        ("collimator: {certificate: {r_mm: 1, number: 1, uncertainty_mm: 1, date: 31.1.2026}}", "certificate.date: must be a date, year-month-day: 2026-03-31 (got '31.1.2026')."),
        ("collimator: {certificate: {r_mm: 1, number: 1, uncertainty_mm: 1, date: 2026-02-03, valid_until: 2025-01-01}}", "valid_until is before the date"),
        ("collimator: {certificate: {r_mm: 1, number: 1, uncertainty_mm: 1}, passport: p.json}", "collimator: give the values of a certificate or a passport, not both"),
        ("collimator: {certificate: {r_mm: 2550, number: 1, uncertainty_mm: 1}, nominal_r_mm: 255}", "collimator.certificate: r_mm 2550 is more than 15 % off nominal_r_mm 255: another collimator's. Correct one."),
        ("gimbal: {reading_sigma_deg: 0.002, source: G, faces: {front: {normal: [0, 0, 0]}}}", "gimbal.faces.front.normal: has no direction: give a vector such as [0, 0, 1]."),
        ("gimbal: {source: x, reading_sigma_deg: 1, pupil_off_pivot: 1}", "Did you mean 'pupil_off_pivot_mm'?"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_in_its_place(section, fault_text):
    found = faults_of(knowing, section)
    assert any(fault_text in fault for fault in found), found
