import time
import tracemalloc

import certificate_sample
import pytest

from bench.base.errors import EvidenceError, UsageError
from bench.certificate import dcc_xml
from bench.certificate.dcc_signature import verify_signature, without_signature
from bench.certificate.dcc_xml import read_dcc, read_xml, short, to_bytes

ROOT = '<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" schemaVersion="3.2.1">'
END = "</dcc:digitalCalibrationCertificate>"


def laughs():
    entities = ['<!ENTITY a0 "ha">'] + [f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 12)]
    return f"<!DOCTYPE r [{''.join(entities)}]>{ROOT}&a11;{END}"


HOSTILE = {
    "billion laughs": laughs(),
    "quadratic blowup": f'<!DOCTYPE r [<!ENTITY a "{"x" * 50_000}">]>{ROOT}{"&a;" * 50_000}{END}',
    "file as entity": f'<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]>{ROOT}&a;{END}',
    "address as entity": f'<!DOCTYPE r [<!ENTITY a SYSTEM "http://127.0.0.1:9/x">]>{ROOT}&a;{END}',
    "external document type": f'<!DOCTYPE r SYSTEM "http://127.0.0.1:9/x.dtd">{ROOT}{END}',
    "parameter entity": f'<!DOCTYPE r [<!ENTITY % a SYSTEM "file:///etc/passwd"> %a;]>{ROOT}{END}',
    "default attribute": f'<!DOCTYPE r [<!ATTLIST r schemaVersion CDATA "3.2.1">]>{ROOT}{END}',
    "entity that is not declared": f"{ROOT}&nbsp;{END}",
    "document type in UTF-16": laughs().encode("utf-16"),
    "document type in UTF-7": b'<?xml version="1.0" encoding="UTF-7"?>' + laughs().encode("utf-7"),
    "document type in EBCDIC": '<?xml version="1.0" encoding="cp037"?>'.encode("cp037")
    + laughs().encode("cp037"),
    "Latin-1": f'<?xml version="1.0" encoding="ISO-8859-1"?>{ROOT}\xe4{END}'.encode("latin-1"),
    "wrong UTF-8": ROOT.encode() + b"\xff\xfe" + END.encode(),
    "nested": ROOT + "<a>" * 5_000 + "</a>" * 5_000 + END,
    "a text of 12 MB": ROOT + "x" * 12_000_000 + END,
    "millions of elements": ROOT + "<a/>" * 2_000_000 + END,
    "millions of attributes": ROOT + "<a " + " ".join(f"b{n}=''" for n in range(500_000)) + "/>" + END,
    "an attribute twice": f'{ROOT}<a b="1" b="2"/>{END}',
    "prefix without namespace": f"{ROOT}<si:real/>{END}",
    "not closed": ROOT,
    "two roots": f"{ROOT}{END}{ROOT}{END}",
    "no XML": "%PDF-1.7",
    "empty": "",
    "NUL": f"{ROOT}\x00{END}",
    "another document": "<html/>",
    "no namespace": "<digitalCalibrationCertificate schemaVersion='3.2.1'/>",
    "another version": '<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" schemaVersion="9.9.9"/>',
    "a huge version": f'<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" schemaVersion="{"9" * 9999}"/>',
}


@pytest.mark.parametrize(
    "read", [lambda data: read_dcc(data, "x"), lambda data: verify_signature(data, "x"), without_signature]
)
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_xml_is_refused_with_one_message(name, read):
    data = HOSTILE[name]
    data = data if isinstance(data, bytes) else data.encode()
    begun = time.monotonic()
    with pytest.raises(EvidenceError) as caught:
        read(data)
    assert time.monotonic() - begun < 5.0
    assert len(str(caught.value)) < 600
    assert caught.value.remedy
    assert "root:" not in str(caught.value)


def test_memory_stays_small(monkeypatch):
    tracemalloc.start()
    try:
        with pytest.raises(EvidenceError):
            read_xml(HOSTILE["billion laughs"].encode(), "x")
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
    monkeypatch.setattr(dcc_xml, "MOST_BYTES", 100)
    with pytest.raises(EvidenceError, match="at most 100"):
        read_dcc(certificate_sample.small_dcc(), "x")


def test_what_is_read_is_written_again():
    assert to_bytes(read_dcc(certificate_sample.full_dcc(), "x")) == certificate_sample.full_dcc()


def test_messages_show_text_of_others_on_one_line():
    assert short("a\nb\x1b[31m" + "c" * 200) == "a b?[31m" + "c" * 71 + "…"


def test_a_missing_library_is_named(monkeypatch):
    def refuse(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(dcc_xml, "import_module", refuse)
    with pytest.raises(UsageError, match=r"lxml is not installed.*starbench\[certificate\]"):
        read_dcc(b"<a/>", "x")
