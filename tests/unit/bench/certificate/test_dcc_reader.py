import hashlib

import certificate_sample
import lab_pki
import pytest
import yaml
from click.testing import CliRunner
from lxml import etree

from bench.base.errors import EvidenceError
from bench.certificate.dcc import read_reference
from bench.certificate.dcc_xml import NAMESPACES
from bench.commands.certificate_dcc import from_dcc

HEAD = """<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si"
 schemaVersion="3.2.1"><dcc:administrativeData><dcc:coreData><dcc:uniqueIdentifier>{number}</dcc:uniqueIdentifier>
 <dcc:endPerformanceDate>2026-01-12</dcc:endPerformanceDate></dcc:coreData><dcc:calibrationLaboratory><dcc:contact>
 <dcc:name><dcc:content lang="de">PTB &amp; "Co": 1</dcc:content><dcc:content lang="en">x</dcc:content></dcc:name>
 </dcc:contact></dcc:calibrationLaboratory></dcc:administrativeData><dcc:measurementResults><dcc:measurementResult>
 <dcc:influenceConditions><dcc:influenceCondition><dcc:data><dcc:quantity><si:real><si:value>293.15</si:value>
 <si:unit>\\kelvin</si:unit></si:real></dcc:quantity></dcc:data></dcc:influenceCondition></dcc:influenceConditions>
 <dcc:results><dcc:result><dcc:name><dcc:content lang="en">Collimator</dcc:content></dcc:name><dcc:data>"""
TAIL = """</dcc:data></dcc:result></dcc:results></dcc:measurementResult></dcc:measurementResults>
</dcc:digitalCalibrationCertificate>"""
EXPANDED = (
    "<si:expandedUnc><si:uncertainty>{U}</si:uncertainty><si:coverageFactor>{k}</si:coverageFactor>"
    "<si:coverageProbability>0.95</si:coverageProbability></si:expandedUnc>"
)


def quantity(name="", label="", value="0.2551", unit=r"\metre", U="0.0001", k="2", expanded=EXPANDED):
    named = f'<dcc:name><dcc:content lang="en">{name}</dcc:content></dcc:name>' if name else ""
    labelled = f"<si:label>{label}</si:label>" if label else ""
    return (
        f"<dcc:quantity>{named}<si:real>{labelled}<si:value>{value}</si:value><si:unit>{unit}</si:unit>"
        f"{expanded.format(U=U, k=k)}</si:real></dcc:quantity>"
    )


def dcc(*quantities, number="C-17"):
    return (HEAD.format(number=number) + "".join(quantities) + TAIL).encode()


APERTURE = quantity("Aperture", "D", "80", r"\milli\metre", "0.1")


def test_the_only_length_is_read_in_millimetres():
    data = dcc(quantity())
    found = read_reference(data, "x")
    assert (found.number, found.date, found.issuer) == ("C-17", "2026-01-12", 'PTB & "Co": 1')
    assert found.length.value_mm == pytest.approx(255.1)
    assert found.length.uncertainty_mm == pytest.approx(0.1)
    assert (found.length.k, found.length.name) == (2.0, "Collimator")
    assert found.temperature_c == pytest.approx(20.0)
    assert found.sha256 == hashlib.sha256(data).hexdigest()


@pytest.mark.parametrize(
    ("focal", "wanted"),
    [
        (quantity("Effective focal length"), None),
        (quantity(label="r"), None),
        (quantity("Brennweite f'"), None),
        (quantity("L"), "L"),
    ],
)
def test_a_focal_length_is_known_by_name_or_label_or_can_be_named(focal, wanted):
    data = dcc(APERTURE, focal)
    assert read_reference(data, "x", wanted=wanted).length.value_mm == pytest.approx(255.1)
    assert read_reference(data, "x", wanted="D").length.value_mm == 80.0


NONE = "not state exactly one focal length"
NO_LENGTHS = (
    {"U": "0"},
    {"U": "-0.1"},
    {"k": "0.5"},
    {"value": "NaN"},
    {"value": "1e999"},
    {"unit": r"\second"},
    {"unit": "mm"},
)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (dcc(), NONE),
        (certificate_sample.full_dcc(), NONE),
        (dcc(APERTURE, quantity("Width")), "Lengths with one: D .Aperture.; .Width."),
        (dcc(quantity(label="f"), quantity(label="r")), "Lengths with one: f .Collimator.; r"),
        (dcc(quantity(expanded="")), "Lengths with one: none"),
        *((dcc(quantity(**wrong)), NONE) for wrong in NO_LENGTHS),
        (dcc(quantity(), number=""), "has no number"),
        (dcc(quantity(value="2<!-- -->55")), "XML comments"),
        (b"<html/>", "not a digital calibration certificate"),
    ],
)
def test_what_cannot_be_read_is_said(data, said):
    with pytest.raises(EvidenceError, match=said) as caught:
        read_reference(data, "x")
    assert caught.value.remedy


def run(*arguments):
    done = CliRunner().invoke(from_dcc, [str(one) for one in arguments], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.output


def test_the_command_prints_lines_for_both_files(tmp_path):
    path = tmp_path / "collimator.xml"
    path.write_bytes(dcc(quantity("Focal length"), number='C-17: "x"'))
    printed = run(path)
    assert printed.startswith(f"# From {path}: (Focal length); no signature.\n# Station file:\ncollimator:\n")
    from bench.stations.station_budget import CertificateConfig

    values = plain(printed.partition("# lab.yaml")[0])["collimator"]["certificate"]
    found = CertificateConfig.model_validate(values)
    assert (found.r_mm, found.uncertainty_mm, found.k) == (255.1, 0.1, 2.0)
    assert (found.number, str(found.date), found.temperature_c) == ('C-17: "x"', "2026-01-12", 20.0)
    (source,) = plain(printed.partition("# lab.yaml:")[2])["sources"]
    assert source["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert source["issuer"] == 'PTB & "Co": 1'


def plain(text):
    return yaml.load(text, Loader=yaml.BaseLoader)  # every scalar stays text, as in our own reader


def test_the_signature_of_a_reference_is_verified(tmp_path):
    path = tmp_path / "collimator.xml"
    path.write_bytes(dcc(quantity()))
    trusted = tmp_path / "trusted.pem"
    trusted.write_bytes(lab_pki.pem(lab_pki.authority()[1]))
    with pytest.raises(EvidenceError, match="has no signature"):
        run(path, "--trusted", trusted)
    root = etree.fromstring(path.read_bytes())
    etree.SubElement(root, f"{{{NAMESPACES['ds']}}}Signature")
    path.write_bytes(etree.tostring(root))
    with pytest.raises(EvidenceError, match="no certificate that can be read"):
        run(path)
