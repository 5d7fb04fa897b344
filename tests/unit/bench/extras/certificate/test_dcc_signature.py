""""""

import certificate_sample
import lab_pki
import pytest
from certificate_lab import Lab
from certificate_sample import NOW
from dcc_checks import check_dcc
from lxml import etree

from bench.base.errors import EvidenceError
from bench.extras.certificate.check import check_certificate
from bench.extras.certificate.dcc_signature import (
    load_certificates,
    load_signing_key,
    sign_dcc,
    signer_of_files,
    verify_signature,
    without_signature,
)
from tests.unit.bench.evidence.resealed import copied

DS = "{http://www.w3.org/2000/09/xmldsig#}"

WHEN = lab_pki.signed_at()


@pytest.fixture(scope="module")
def signed():
    key, certificate = lab_pki.seal()
    return sign_dcc(certificate_sample.full_dcc(), key, [certificate], signed_utc=WHEN)


@pytest.mark.parametrize("kind", ["rsa", "P-256", "P-384", "P-521"])
def test_signed_twice_gives_the_same_bytes(kind):
    key, certificate = lab_pki.seal(kind)
    signed = sign_dcc(certificate_sample.full_dcc(), key, [certificate], signed_utc=WHEN)
    assert signed == sign_dcc(certificate_sample.full_dcc(), key, [certificate], signed_utc=WHEN)
    assert without_signature(signed) == certificate_sample.full_dcc()
    signature = verify_signature(signed, "dcc.xml")
    assert (signature.signer, signature.stated_utc) == (f"CN=Lab seal {kind},O=Lab", WHEN)
    assert check_dcc(signed) == []


def test_a_chain_is_put_in_order():
    key, chain = lab_pki.long_chain()
    in_any_order = sign_dcc(certificate_sample.small_dcc(), key, chain[1::-1], signed_utc=WHEN)
    assert in_any_order == sign_dcc(certificate_sample.small_dcc(), key, chain[:2], signed_utc=WHEN)


def edited(data, change):
    root = etree.fromstring(data)
    change(root)
    return etree.tostring(root)


def signature_of(root):
    return root.find(f"{DS}Signature")


def move_first(root):
    root.insert(0, signature_of(root))


def text_of(tag, new):
    return lambda root: setattr(next(root.iter(tag)), "text", new)


def method(algorithm):
    return lambda root: next(root.iter(f"{DS}SignatureMethod")).set("Algorithm", algorithm)


def wrap_original(root):
    """The classic attack: the signed document moves away, another stands in its place, the signature stays valid."""
    comment = root.find("{https://ptb.de/dcc}comment")
    copy = etree.fromstring(etree.tostring(root))
    comment.append(copy)
    root.remove(signature_of(root))


def add_comment(root):
    value = next(element for element in root.iter("{https://ptb.de/si}value") if element.text == "3346.0")
    value.text = "33"
    hidden = etree.Comment("")
    hidden.tail = "46.0"
    value.append(hidden)


def drop_reference(root):
    reference = next(root.iter(f"{DS}Reference"))
    reference.getparent().remove(reference)


def only_a_part(root):
    """Let the first reference name the key information instead of the document."""
    reference = next(root.iter(f"{DS}Reference"))
    reference.set("URI", f"#{next(root.iter(f'{DS}KeyInfo')).get('Id')}")


OTHER_CERTIFICATE = "".join(lab_pki.pem(lab_pki.seal("P-384")[1]).decode().splitlines()[1:-1])
ATTACKS = {
    "value": text_of("{https://ptb.de/si}value", "3346.5"),
    "customer": text_of("{https://ptb.de/dcc}street", "Elsewhere 1"),
    "attribute": lambda root: root.set("schemaVersion", "3.2.1 "),
    "added element": lambda root: etree.SubElement(root[0], "{https://ptb.de/dcc}statements"),
    "text behind the signature": lambda root: setattr(signature_of(root), "tail", "\n\n"),
    "comment in a value": add_comment,
    "signature first": move_first,
    "signature twice": lambda root: root.append(etree.fromstring(etree.tostring(signature_of(root)))),
    "signed document moved": wrap_original,
    "reference dropped": drop_reference,
    "only a part signed": only_a_part,
    "another certificate": text_of(f"{DS}X509Certificate", OTHER_CERTIFICATE),
    "no certificate": text_of(f"{DS}X509Certificate", "AAAA"),
    "SHA-1": method("http://www.w3.org/2000/09/xmldsig#rsa-sha1"),
    "HMAC": method("http://www.w3.org/2001/04/xmldsig-more#hmac-sha256"),
    "no time": text_of("{*}SigningTime", "yesterday"),
    "another time": text_of("{*}SigningTime", "2026-09-01T00:00:00Z"),
    "empty signature": lambda root: signature_of(root).clear(),
    "signature value": text_of(f"{DS}SignatureValue", "AAAA"),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_attacks(signed, attack):
    assert verify_signature(signed, "dcc.xml") is not None
    changed = edited(signed, ATTACKS[attack])
    with pytest.raises(EvidenceError) as caught:
        verify_signature(changed, "dcc.xml")
    assert caught.value.remedy
    assert len(str(caught.value)) < 500


def test_without_its_signature_a_dcc_is_as_it_was_and_text_hidden_behind_it_is_not_lost(signed):
    small = certificate_sample.small_dcc()
    assert without_signature(small) == small
    assert verify_signature(small, "dcc.xml") is None
    bare = edited(signed, lambda root: root.remove(signature_of(root)))
    assert verify_signature(bare, "dcc.xml") is None
    assert b"more" in without_signature(signed.replace(b"</ds:Signature>\n", b"</ds:Signature>more\n"))


@pytest.mark.parametrize(
    ("options", "when", "fault"),
    [
        ({}, lab_pki.signed_at(-1), "not at 2025-12-31"),
        ({}, lab_pki.signed_at(3 * 365), "is valid from 2026-01-01 to 2028-01-01"),
        ({"signs": False}, WHEN, "not meant for signatures"),
    ],
)
def test_unfit_certificates_sign_nothing(options, when, fault):
    key, certificate = lab_pki.seal(**options)
    with pytest.raises(EvidenceError, match=fault):
        sign_dcc(certificate_sample.small_dcc(), key, [certificate], signed_utc=when)


def test_what_cannot_be_signed(signed):
    key, certificate = lab_pki.seal()
    with pytest.raises(EvidenceError, match="signed already"):
        sign_dcc(signed, key, [certificate], signed_utc=WHEN)
    with pytest.raises(EvidenceError, match="not written by Starbench"):
        sign_dcc(certificate_sample.small_dcc() + b"\n", key, [certificate], signed_utc=WHEN)
    with pytest.raises(EvidenceError, match="No certificate of the chain belongs to the key"):
        sign_dcc(certificate_sample.small_dcc(), lab_pki.new_key("P-384"), [certificate], signed_utc=WHEN)
    stranger = lab_pki.authority("Other")[1]
    with pytest.raises(EvidenceError, match="CN=Other,O=Lab is no part of the chain"):
        sign_dcc(certificate_sample.small_dcc(), key, [certificate, stranger], signed_utc=WHEN)


def test_a_signature_is_valid_at_its_own_time_and_not_at_another(signed):
    assert verify_signature(signed, "x", when=lab_pki.signed_at(300)) is not None
    with pytest.raises(EvidenceError, match="is valid from 2026-01-01"):
        verify_signature(signed, "x", when=lab_pki.signed_at(3000))


def test_key_and_certificate_of_two_files_sign(tmp_path):
    key, certificate = lab_pki.seal()
    key_file = write(tmp_path / "key.pem", lab_pki.key_pem(key, b"open"))
    chain_file = write(tmp_path / "chain.pem", lab_pki.pem(certificate))
    sign = signer_of_files(key_file, chain_file, ask_passphrase=lambda _: b"open")
    expected = sign_dcc(certificate_sample.small_dcc(), key, [certificate], signed_utc=WHEN)
    assert sign(certificate_sample.small_dcc(), WHEN) == expected
    other_file = write(tmp_path / "other.pem", lab_pki.pem(lab_pki.authority()[1]))
    with pytest.raises(EvidenceError, match="No certificate of the chain belongs to the key"):
        signer_of_files(key_file, other_file, ask_passphrase=lambda _: b"open")


def write(path, content, mode=0o600):
    path.write_bytes(content)
    path.chmod(mode)
    return path


def test_keys_are_loaded(tmp_path):
    path = write(tmp_path / "key.pem", lab_pki.key_pem(lab_pki.new_key("P-256")))
    assert load_signing_key(path).curve.name == "secp256r1"
    locked = write(tmp_path / "locked.pem", lab_pki.key_pem(lab_pki.new_key("rsa"), b"open"))
    assert load_signing_key(locked, ask_passphrase=lambda _: b"open").key_size == 2048
    with pytest.raises(EvidenceError, match="no terminal to ask"):
        load_signing_key(locked)
    with pytest.raises(EvidenceError, match="wrong passphrase"):
        load_signing_key(locked, ask_passphrase=lambda _: b"shut")


UNFIT_KEYS = [
    (lab_pki.key_pem(lab_pki.new_key("P-256")), 0o644, "Other users can read the key"),
    (lab_pki.key_pem(lab_pki.new_key("ed25519")), 0o600, "cannot sign XML"),
    (lab_pki.key_pem(lab_pki.new_key("rsa-1024")), 0o600, "cannot sign XML"),
    (b"-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n", 0o600, "cannot be read"),
    (b"", 0o600, "cannot be read"),
    (lab_pki.pem(lab_pki.authority()[1]), 0o600, "cannot be read"),
]


@pytest.mark.parametrize(("content", "mode", "fault"), UNFIT_KEYS)
def test_unfit_keys_are_refused(tmp_path, content, mode, fault):
    with pytest.raises(EvidenceError, match=fault) as caught:
        load_signing_key(write(tmp_path / "key.pem", content, mode))
    assert caught.value.where.endswith("key.pem")


def test_certificates_are_loaded(tmp_path):
    _, chain = lab_pki.long_chain()
    assert load_certificates(write(tmp_path / "chain.pem", lab_pki.pem(*chain))) == chain
    with pytest.raises(EvidenceError, match="no certificates in PEM"):
        load_certificates(write(tmp_path / "none.pem", b"nothing"))
    with pytest.raises(EvidenceError, match="has 12 certificates"):
        load_certificates(write(tmp_path / "many.pem", lab_pki.pem(*chain * 4)))


# ---------------------------------------------------------------- a certificate whose digital part is signed


def signer(begin=lab_pki.BEGIN):
    key, certificate = lab_pki.seal(begin=begin)
    return lambda data, when: sign_dcc(data, key, [certificate], signed_utc=when)


@pytest.fixture(scope="module")
def signed_certificate(tmp_path_factory):
    return Lab(tmp_path_factory.mktemp("signed"), signer()).issue().folder


def test_a_signed_certificate_is_derived_again(signed_certificate):
    again = check_certificate(signed_certificate)
    assert (again.faults, again.not_compared) == ([], [])
    assert any("signature of CN=Lab seal P-256" in remark for remark in again.remarks)


def signed_by_another(data):
    key, certificate = lab_pki.seal("P-384")
    return sign_dcc(without_signature(data), key, [certificate], signed_utc=NOW)


@pytest.mark.parametrize(
    "change",
    [lambda data: data.replace(b"Mill Lane 3", b"Mill Lane 4"), without_signature, signed_by_another],
)
def test_a_changed_or_missing_signature_is_a_fault(signed_certificate, tmp_path, change):
    """The PDF has the signed DCC attached."""
    dcc = copied(signed_certificate, tmp_path / "copy") / "dcc.xml"
    dcc.write_bytes(change(dcc.read_bytes()))
    assert check_certificate(dcc.parent).faults


def test_a_key_that_cannot_sign_is_refused_before_a_number_is_taken(tmp_path):
    lab = Lab(tmp_path, signer(begin=lab_pki.signed_at(700)))
    with pytest.raises(EvidenceError, match="is valid from 2027-12-02"):
        lab.issue()
    assert lab.numbers() == {}
    assert not (tmp_path / "certificate").exists()
