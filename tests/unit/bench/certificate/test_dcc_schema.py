"""The check against schemas, with small schemas of our own: those of PTB are not in the repository."""

import certificate_sample
import pytest

from bench.base.errors import EvidenceError, UsageError
from bench.certificate.dcc_xml import schema_faults, schema_folder

DCC_XSD = """<xs:schema version="3.2.1" xmlns:xs="http://www.w3.org/2001/XMLSchema" xmlns:si="https://ptb.de/si"
 xmlns:ds="http://www.w3.org/2000/09/xmldsig#" targetNamespace="https://ptb.de/dcc" elementFormDefault="qualified">
 <xs:import namespace="https://ptb.de/si" schemaLocation="https://ptb.de/si/v2.1.0/SI_Format.xsd"/>
 <xs:import namespace="http://www.w3.org/2000/09/xmldsig#"
  schemaLocation="https://www.ptb.de/dcc/d-sig/xmldsig-core-schema.xsd"/>
 <xs:element name="digitalCalibrationCertificate"><xs:complexType><xs:sequence>
  <xs:any namespace="##targetNamespace" processContents="lax" maxOccurs="unbounded"/>
  <xs:element ref="ds:Signature" minOccurs="0"/>
 </xs:sequence><xs:attribute name="schemaVersion" fixed="3.2.1"/></xs:complexType></xs:element>
</xs:schema>"""
SI_XSD = """<xs:schema version="2.1.0" xmlns:xs="http://www.w3.org/2001/XMLSchema" xmlns:si="https://ptb.de/si"
 targetNamespace="https://ptb.de/si" elementFormDefault="qualified">
 <xs:element name="real"><xs:complexType><xs:sequence>
  <xs:element name="label" minOccurs="0"/><xs:element name="value" type="xs:double"/><xs:any minOccurs="0"
   maxOccurs="unbounded" processContents="skip"/></xs:sequence></xs:complexType></xs:element>
</xs:schema>"""


@pytest.fixture
def schemas(tmp_path):
    (tmp_path / "dcc.xsd").write_text(DCC_XSD, encoding="utf-8")
    (tmp_path / "SI_Format.xsd").write_text(SI_XSD, encoding="utf-8")
    return tmp_path


def test_imports_are_answered_by_the_folder(schemas):
    """The imports name addresses in the network; nothing is fetched, and the files stay as they are."""
    assert schema_faults(certificate_sample.full_dcc(), schemas, "dcc.xml") == []
    wrong = certificate_sample.full_dcc().replace(b"<si:value>3346.4<", b"<si:value>many<", 1)
    (fault,) = schema_faults(wrong, schemas, "dcc.xml")
    assert fault.startswith("line ")
    assert "si:value" in fault
    assert "{https" not in fault
    assert (schemas / "dcc.xsd").read_text(encoding="utf-8") == DCC_XSD


def test_many_faults_are_cut_and_a_file_that_is_no_dcc_is_refused(schemas):
    wrong = certificate_sample.full_dcc().replace(b"<si:value>", b"<si:value>x")
    assert len(schema_faults(wrong, schemas, "dcc.xml")) == 51
    with pytest.raises(EvidenceError, match="not a digital calibration certificate"):
        schema_faults(b"<html/>", schemas, "x.xml")


def refused(folder):
    with pytest.raises(UsageError) as caught:
        schema_faults(certificate_sample.small_dcc(), folder, "dcc.xml")
    assert "STARBENCH_DCC_SCHEMAS" in caught.value.remedy
    assert caught.value.exit_status == 2
    return str(caught.value)


def test_a_wrong_folder_is_said_plainly(schemas, tmp_path):
    assert "no such folder" in refused(tmp_path / "none")
    assert "no such folder" in refused(schemas / "dcc.xsd")
    (tmp_path / "empty").mkdir()
    assert "no dcc.xsd" in refused(tmp_path / "empty")
    (schemas / "SI_Format.xsd").unlink()
    assert "no SI_Format.xsd" in refused(schemas)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("dcc.xsd", DCC_XSD.replace('"3.2.1"', '"3.3.0"', 1), "has version 3.3.0; the certificate needs 3.2.1"),
        ("SI_Format.xsd", SI_XSD.replace("2.1.0", "2.2.1"), "has version 2.2.1; the certificate needs 2.1.0"),
        ("SI_Format.xsd", SI_XSD.replace('targetNamespace="https://ptb.de/si"', ""), "not the schema of https://ptb.de/si"),
        ("SI_Format.xsd", "<html/>", "not the schema of"),
        ("SI_Format.xsd", "not XML", "not an XML schema"),
        ("SI_Format.xsd", SI_XSD.replace("xs:double", "xs:nothing"), "cannot be used"),
        ("dcc.xsd", DCC_XSD.replace("https://ptb.de/si/v2.1.0/SI_Format.xsd", "file:///etc/passwd"), "is not known here"),
        ("dcc.xsd", DCC_XSD.replace("</xs:schema>", '<xs:include schemaLocation="x.xsd"/></xs:schema>'), "is not known"),
        ("dcc.xsd", DCC_XSD + " " * 5_000_000, "too large"),
    ],
)  # fmt: skip
def test_other_schemas_are_refused(schemas, name, content, said):
    (schemas / name).write_text(content, encoding="utf-8")
    assert said in refused(schemas)


def test_the_folder_of_the_user_is_taken_before_that_of_the_environment(tmp_path):
    assert schema_folder(tmp_path, {"STARBENCH_DCC_SCHEMAS": "/other"}) == tmp_path
    assert schema_folder(None, {"STARBENCH_DCC_SCHEMAS": str(tmp_path)}) == tmp_path
    assert schema_folder(None, {}) is schema_folder(None, {"STARBENCH_DCC_SCHEMAS": " "}) is None
