"""Digital calibration certificates judged by programs and rules that nobody here wrote.

PTB's schemas are not in the repository (LGPL-3.0): STARBENCH_DCC_SCHEMAS names a folder with ``dcc.xsd`` (3.2.1) and
``SI_Format.xsd`` (D-SI 2.1.0). The network is not used.
"""

import os
import shutil
import socket
import subprocess
import warnings
from pathlib import Path

import certificate_sample
import pytest

from bench.extras.certificate.d_si import OUR_UNITS

SCHEMAS = Path(named) if (named := os.environ.get("STARBENCH_DCC_SCHEMAS")) else None
needs_schemas = pytest.mark.skipif(SCHEMAS is None, reason="STARBENCH_DCC_SCHEMAS names no folder")


DCCS = {"full": certificate_sample.full_dcc, "small": certificate_sample.small_dcc}


@pytest.fixture(autouse=True)
def no_network(monkeypatch):
    def refuse(*_):
        raise OSError("a test asked for the network")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)


def program(name):
    return shutil.which(name) or pytest.skip(f"{name} is not installed")


def schema_of_signatures():
    """The schema that PTB's imports for signatures, of the package xmlschema."""
    xmlschema = pytest.importorskip("xmlschema", reason="xmlschema, which has W3C's schema, is not installed")
    return Path(xmlschema.__file__).parent / "schemas/DSIG/xmldsig-core-schema.xsd"


@pytest.fixture
def catalog(tmp_path):
    """A catalog that maps the imports of the schemas to files, as an environment for xmllint."""
    files = {
        "https://ptb.de/si/v2.1.0/SI_Format.xsd": SCHEMAS / "SI_Format.xsd",
        "https://www.ptb.de/dcc/d-sig/xmldsig-core-schema.xsd": schema_of_signatures(),
    }
    lines = [
        f'<{kind} {key}="{url}" uri="{file.resolve().as_uri()}"/>'
        for url, file in files.items()
        for kind, key in (("system", "systemId"), ("uri", "name"))
    ]
    path = tmp_path / "catalog.xml"
    path.write_text(
        f'<catalog xmlns="urn:oasis:names:tc:entity:xmlns:xml:catalog">{"".join(lines)}</catalog>'
    )
    return {**os.environ, "XML_CATALOG_FILES": str(path)}


@needs_schemas
@pytest.mark.parametrize("name", DCCS)
def test_valid_by_xmllint(name, tmp_path, catalog):
    path = tmp_path / "dcc.xml"
    path.write_bytes(DCCS[name]())
    command = [program("xmllint"), "--nonet", "--noout", "--schema", str(SCHEMAS / "dcc.xsd"), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, env=catalog, check=False)
    assert (done.returncode, done.stderr.strip()) == (0, f"{path} validates")


@pytest.fixture(scope="module")
def other_schema():
    """The schema compiled by the package xmlschema, an implementation in Python of its own."""
    xmlschema = pytest.importorskip("xmlschema", reason="xmlschema, the second opinion, is not installed")
    return xmlschema.XMLSchema(
        str(SCHEMAS / "dcc.xsd"),
        locations={
            "https://ptb.de/si": str(SCHEMAS / "SI_Format.xsd"),
            "http://www.w3.org/2000/09/xmldsig#": str(schema_of_signatures()),
        },
        uri_mapper={
            "https://ptb.de/si/v2.1.0/SI_Format.xsd": str(SCHEMAS / "SI_Format.xsd"),
            "https://www.ptb.de/dcc/d-sig/xmldsig-core-schema.xsd": str(schema_of_signatures()),
        },
    )


@needs_schemas
@pytest.mark.parametrize("name", DCCS)
def test_valid_by_xmlschema(name, other_schema):
    faults = [
        str(fault) for fault in other_schema.iter_errors(DCCS[name]().decode(), use_location_hints=False)
    ]
    assert faults == []


@pytest.fixture(scope="module")
def schematron():
    """The rules that dcclib has beside the schema, compiled from its own Schematron file."""
    dcclib = pytest.importorskip("dcclib", reason="dcclib, the second opinion, is not installed")
    from dcclib.validation.schematron import SchematronValidator

    rules = Path(dcclib.__file__).parent / "validation/schema/dcc.sch"
    return SchematronValidator.from_file(str(rules))


def remarks(schematron, data):
    report = schematron.validate_str(data.decode())
    told = (remark for remark in report.successful_reports if remark.role != "information")
    stated = [*report.failed_assertions, *told]
    return [" ".join(remark.text.split()) for remark in stated]


@pytest.mark.parametrize("name", DCCS)
def test_the_rules_of_dcclib_find_the_version_only(name, schematron):
    (remark,) = remarks(schematron, DCCS[name]())
    assert remark.startswith("Schema version outdated: ")


def test_units_are_known_to_dsiunits():
    dsi_unit = pytest.importorskip("dsi_unit", reason="dsiunits, the second opinion, is not installed")
    for unit in sorted(set(OUR_UNITS.values())):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            known = dsi_unit.DsiUnit(unit)
        assert known.valid, unit
        assert not known.non_dsi_unit, unit
