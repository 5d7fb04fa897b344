"""The station's sections about the collimator and the gimbal's readings."""

from datetime import date

import pytest
from station_texts import PLAIN

from bench.stations.station import Station
from bench.stations.station_budget import CertificateConfig
from sequences.errors import DocumentFaults
from sequences.reader import check_document

KEPT = "\n".join(line for line in PLAIN.splitlines() if not line.startswith(("collimator:", "gimbal:")))


def station(section: str) -> Station:
    return check_document(f"{KEPT}\n{section}\n".encode(), "b.yaml", Station).value


def test_a_certificate_has_values_and_an_older_one_is_a_text():
    values = station(
        "collimator: {certificate: {r_mm: 255.03, uncertainty_mm: 0.1, number: 7, date: 2026-01-31}}"
    )
    certificate = values.collimator.certificate
    assert isinstance(certificate, CertificateConfig)
    assert (certificate.sigma_mm, certificate.number, certificate.date) == (0.05, "7", date(2026, 1, 31))
    assert station("collimator: {certificate: T-1}").collimator.certificate == "T-1"
    assert station("collimator: {certificate: }").collimator.certificate is None
    assert station("collimator: {serial: '1'}").gimbal is None


def test_the_gimbal_states_what_its_readings_are_worth():
    gimbal = station(
        "gimbal: {reading_sigma_deg: 0.002, source: G-3, pupil_off_pivot_mm: {value: 2, sigma: 0.5}}"
    ).gimbal
    assert (gimbal.scale_sigma, gimbal.eccentricity_deg) == (0.0, 0.0)
    assert (gimbal.pupil_off_pivot_mm.value, gimbal.pupil_off_pivot_mm.sigma) == (2.0, 0.5)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("collimator: {certificate: {r_mm: 255, number: 1}}", "collimator.certificate.uncertainty_mm: this key is req"),
        ("collimator: {certificate: {r_mm: 0, number: 1, uncertainty_mm: 1}}", "collimator.certificate.r_mm: must be from 1 to 100000 mm"),
        ("collimator: {certificate: {r_mm: 1, number: 1, uncertainty_mm: 1, k: 0.5}}", "certificate.k: must be 1 or more"),
        ("collimator: {certificate: {r_mm: 1, number: 1, uncertainty_mm: 1, date: 31.1.2026}}", "certificate.date: must be a date, year-month-day: 2026-03-31 (got '31.1.2026')."),
        ("collimator: {certificate: {r_mm: 1, number: 1, uncertainty_mm: 1, date: 2026-02-30}}", "certificate.date: must be a date"),
        ("collimator: {certificate: {r_mm: 1, number: 1, uncertainty_mm: 1, date: 2026-02-03, valid_until: 2025-01-01}}", "valid_until is before the date"),
        ("collimator: {certificate: {r_mm: 1, number: 1, uncertainty_mm: 1}, passport: p.json}", "collimator: give the values of a certificate or a passport, not both"),
        ("collimator: {certificate: {radius: 1}}", "collimator.certificate.radius: unknown key."),
        ("collimator: {defocus: {value: 0, sigma: -1}}", "collimator.defocus.sigma: must be from 0 to 1e+06"),
        ("collimator: {defocus: 0}", "collimator.defocus: must be a mapping"),
        ("gimbal: {reading_sigma_deg: 0.002}", "gimbal.source: this key is required"),
        ("gimbal: {reading_sigma_deg: 0.002, source: G, faces: {front: {normal: [0, 0, 0]}}}", "gimbal.faces.front.normal: has no direction: give a vector such as [0, 0, 1]."),
        ("gimbal: {reading_sigma_deg: 0.002, source: G, faces: {front: {normal: [0, 1]}}}", "gimbal.faces.front.normal"),
        ("gimbal: {reading_sigma_deg: 0.002, source: G, faces: {front: {normal: [0, 0, 1], sigma_deg: -1}}}", "gimbal.faces.front.sigma_deg: must be from 0 to 10 deg"),
        ("gimbal: {reading_sigma_deg: 0.002, source: G, faces: {front: {sigma_deg: 1}}}", "gimbal.faces.front.normal: this key is required"),
        ("gimbal: {source: x}", "gimbal.reading_sigma_deg: this key is required"),
        ("gimbal: {source: x, reading_sigma_deg: 0}", "gimbal.reading_sigma_deg: must be from 1e-06 to 10 deg"),
        ("gimbal: {source: x, reading_sigma_deg: .inf}", "gimbal.reading_sigma_deg: must be a"),
        ("gimbal: {source: x, reading_sigma_deg: 1, pupil_off_pivot: 1}", "Did you mean 'pupil_off_pivot_mm'?"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_in_its_place(section, said):
    with pytest.raises(DocumentFaults) as caught:
        station(section)
    assert any(said in str(fault) for fault in caught.value.faults), str(caught.value)
