"""XAdES signatures of digital calibration certificates (ETSI EN 319 132-1), enveloped, by a key of the laboratory.

A signature covers the whole document; it proves neither the stated time nor, without a trusted certificate, who signed.
The same key, time and DCC give the same bytes: RSA with PKCS#1 v1.5, or ECDSA with the nonces of RFC 6979.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from bench.base.errors import EvidenceError
from bench.evidence.private_files import refuse_readable_by_others
from bench.extras.certificate.dcc_xml import (
    DS,
    NAMESPACES,
    ROOT,
    SIGNATURE,
    library,
    read_dcc,
    short,
    to_bytes,
)
from bench.record.storage import storage_errors

if TYPE_CHECKING:
    from lxml.etree import _Element


PrivateKey = rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey

EC_METHODS = {"secp256r1": "ecdsa-sha256", "secp384r1": "ecdsa-sha384", "secp521r1": "ecdsa-sha512"}
"""Signature method of XML for each curve."""
MOST_CERTIFICATES = 10
"""Most certificates of a chain."""
_LEAST_RSA_BITS = 2048  # NIST SP 800-57: less is no longer safe
_KEY_FORM = "Use a key in PEM: RSA of 2048 bits or more, or ECDSA on P-256, P-384 or P-521."
_METHODS = ("RSA_SHA256", "RSA_SHA384", "RSA_SHA512", "ECDSA_SHA256", "ECDSA_SHA384", "ECDSA_SHA512")
_DIGESTS = ("SHA256", "SHA384", "SHA512")
_TAMPERED = "The document was changed after it was signed, or the signature is not one of XAdES."


def load_signing_key(path: Path, *, ask_passphrase: Callable[[Path], bytes] | None = None) -> PrivateKey:
    """Load a PEM key that only its owner can read; ``ask_passphrase`` None if nobody can be asked for one."""
    with storage_errors(path):
        refuse_readable_by_others(path)
        secret = path.read_bytes()
    try:
        key = _load_pem_key(secret, path, ask_passphrase)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise EvidenceError(
            "The key cannot be read: wrong passphrase, or not a private key in PEM.",
            where=str(path),
            remedy=_KEY_FORM,
        ) from error
    if isinstance(key, rsa.RSAPrivateKey) and key.key_size >= _LEAST_RSA_BITS:
        return key
    if isinstance(key, ec.EllipticCurvePrivateKey) and key.curve.name in EC_METHODS:
        return key
    raise EvidenceError("This key cannot sign XML.", where=str(path), remedy=_KEY_FORM)


def _load_pem_key(secret: bytes, path: Path, ask_passphrase: Callable[[Path], bytes] | None) -> object:
    if b"ENCRYPTED" not in secret:
        return serialization.load_pem_private_key(secret, password=None)
    if ask_passphrase is None:
        raise EvidenceError(
            "The key is protected by a passphrase, and there is no terminal to ask for it.",
            where=str(path),
            remedy="Run in a terminal.",
        )
    return serialization.load_pem_private_key(secret, password=ask_passphrase(path))


def load_certificates(path: Path) -> tuple[x509.Certificate, ...]:
    """Load 1 to 10 certificates in PEM: the laboratory's chain."""
    with storage_errors(path):
        data = path.read_bytes()
    try:
        certificates = tuple(x509.load_pem_x509_certificates(data))
    except ValueError as error:
        raise EvidenceError(
            "The file has no certificates in PEM.",
            where=str(path),
            remedy="Name a file with `-----BEGIN CERTIFICATE-----`.",
        ) from error
    if len(certificates) > MOST_CERTIFICATES:
        raise EvidenceError(
            f"The file has {len(certificates)} certificates; a chain has at most {MOST_CERTIFICATES}.",
            where=str(path),
            remedy="Name a file with the chain alone.",
        )
    return certificates


def in_order(chain: Sequence[x509.Certificate], key: PrivateKey) -> list[x509.Certificate]:
    """Return a chain with the key's own certificate first, each followed by its issuer's; or raise `EvidenceError`."""
    public = key.public_key()
    left = list(chain)
    leaf = next((candidate for candidate in left if candidate.public_key() == public), None)
    if leaf is None:
        raise EvidenceError(
            "No certificate of the chain belongs to the key.",
            remedy="Name the certificate that was issued for this key.",
        )
    ordered = [leaf]
    left.remove(leaf)
    while (
        left
        and (issuer := next((candidate for candidate in left if _issued(ordered[-1], candidate)), None))
        is not None
    ):
        ordered.append(issuer)
        left.remove(issuer)
    if left:
        raise EvidenceError(
            f"{name_of(left[0].subject)} is no part of the chain of the key's certificate.",
            remedy="Leave this certificate out of the file.",
        )
    return ordered


def _issued(certificate: x509.Certificate, issuer: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
        return False
    return True


def refuse_unfit(certificate: x509.Certificate, when: datetime, where: str = "") -> None:
    """Refuse a signer's certificate that is not valid at a time or not meant for signatures (RFC 5280, 4.2.1.3)."""
    name = name_of(certificate.subject)
    if not certificate.not_valid_before_utc <= when <= certificate.not_valid_after_utc:
        raise EvidenceError(
            f"The certificate of {name} is valid from {certificate.not_valid_before_utc:%Y-%m-%d} to"
            f" {certificate.not_valid_after_utc:%Y-%m-%d}, not at {when:%Y-%m-%d %H:%M} UTC.",
            where=where,
            remedy="Use a certificate that is valid at the time of signing.",
        )
    try:
        usage = certificate.extensions.get_extension_for_class(x509.KeyUsage).value
    except x509.ExtensionNotFound:
        return
    if not (usage.digital_signature or usage.content_commitment):
        raise EvidenceError(
            f"The certificate of {name} is not meant for signatures.",
            where=where,
            remedy="Ask the issuer for one with the key usage digitalSignature or nonRepudiation.",
        )


def name_of(name: x509.Name) -> str:
    """Return the name of a certificate's owner or issuer for messages, RFC 4514, cut if it is long."""
    return short(name.rfc4514_string()) or "nobody"


@dataclass(frozen=True)
class DccSignature:
    """A signature of a DCC that is valid."""

    # signer, issuer: Subject of the signer's certificate, and who issued it.
    signer: str
    issuer: str
    serial: int
    fingerprint: str  # SHA-256 of that certificate, hexadecimal
    stated_utc: datetime


def signer_of_files(
    key_file: Path, certificate_file: Path, *, ask_passphrase: Callable[[Path], bytes] | None = None
) -> Callable[[bytes, datetime], bytes]:
    """Load the laboratory's key and certificates; return what signs a DCC with them at a time (see `sign_dcc`)."""
    library("signxml")
    key = load_signing_key(key_file, ask_passphrase=ask_passphrase)
    chain = in_order(load_certificates(certificate_file), key)
    return lambda data, when: sign_dcc(data, key, chain, signed_utc=when)


def sign_dcc(
    data: bytes, key: PrivateKey, chain: Sequence[x509.Certificate], *, signed_utc: datetime
) -> bytes:
    """Sign a DCC as `render_dcc` wrote it, at a time with its zone; `without_signature` gives ``data`` again.

    ``chain`` holds the certificates of the key and its issuers in any order; the key's must be valid and meant for
    signatures.
    """
    root = read_dcc(data, "the DCC")
    if next(root.iter(SIGNATURE), None) is not None:
        raise EvidenceError(
            "The DCC is signed already.", remedy="Sign a certificate once, when it is issued."
        )
    if to_bytes(root) != data:
        raise EvidenceError("The DCC was not written by Starbench.", remedy="Sign it with another program.")
    ordered = in_order(chain, key)
    refuse_unfit(ordered[0], signed_utc)
    placeholder = root.makeelement(SIGNATURE, {"Id": "placeholder"}, nsmap={"ds": DS})
    placeholder.tail = "\n"
    root.append(placeholder)
    method = "rsa-sha256" if isinstance(key, rsa.RSAPrivateKey) else EC_METHODS[key.curve.name]
    signer = _signer(method, signed_utc)
    signed = signer.sign(root, key=_repeatable(key), cert=list(ordered), always_add_key_value=False)
    written = to_bytes(signed)
    if without_signature(written) != data or verify_signature(written, "the DCC", when=signed_utc) is None:
        raise EvidenceError(
            "The signature that was made cannot be verified.",
            remedy="Report this fault; another key may work.",
        )
    return written


def _signer(method: str, signed_utc: datetime) -> Any:
    """Return signxml's signer with a stated time and fixed ids, so that the same input gives the same bytes."""
    xades, lxml_etree = library("signxml.xades"), library("lxml.etree")

    class Signer(xades.XAdESSigner):  # type: ignore[misc, name-defined]
        tokens = 0

        def _get_token(self, length: int = 4) -> str:
            self.tokens += 1
            return f"{self.tokens:0{2 * length}X}"

        def add_signing_time(self, properties: Any, sig_root: Any, signing_settings: Any) -> None:
            del sig_root, signing_settings
            time = lxml_etree.SubElement(properties, f"{{{NAMESPACES['xades']}}}SigningTime")
            time.text = f"{signed_utc.astimezone(UTC):%Y-%m-%dT%H:%M:%SZ}"

    return Signer(
        data_object_format=xades.XAdESDataObjectFormat("Digital calibration certificate", "text/xml"),
        signature_algorithm=method,
    )


def _repeatable(key: PrivateKey) -> Any:
    """Return a key whose ECDSA signatures have the nonces of RFC 6979, where the library can make these."""
    if isinstance(key, rsa.RSAPrivateKey):
        return key

    curve_key = key

    class Repeatable:
        key_size = curve_key.key_size

        @staticmethod
        def sign(data: bytes, signature_algorithm: ec.ECDSA) -> bytes:
            try:
                repeatable = ec.ECDSA(signature_algorithm.algorithm, deterministic_signing=True)
                return curve_key.sign(data, repeatable)
            except (TypeError, UnsupportedAlgorithm):  # an older cryptography or OpenSSL
                return curve_key.sign(data, signature_algorithm)

    return Repeatable()


def without_signature(data: bytes) -> bytes:
    """Return a DCC as it was before it was signed, to compare it with one that is written anew."""
    root = read_dcc(data, "the DCC")
    for signature in root.findall(SIGNATURE):
        if not (signature.tail or "").strip():  # else it is not of `sign_dcc`: keep what somebody added
            signature.tail = None
        _drop_keeping_tail(root, signature)
    return to_bytes(root)


def verify_signature(data: bytes, where: str, *, when: datetime | None = None) -> DccSignature | None:
    """Verify the signature of a DCC; return who signed, or None without a signature; else raise `EvidenceError`.

    Document and signature belong together; whether the signer's certificate is trusted, others check. ``when`` None is
    the time that the signer states.
    """
    root = read_dcc(data, where)
    signatures = list(root.iter(SIGNATURE))
    if not signatures:
        return None
    if len(signatures) > 1 or signatures[0].getparent() is not root or signatures[0].getnext() is not None:
        raise EvidenceError(
            "The DCC has several signatures, or one that is not its last element; only one at the end is known.",
            where=where,
            remedy="Check it with another program, such as xmlsec1.",
        )
    if next(root.iter(library("lxml.etree").Comment), None) is not None:
        raise EvidenceError(
            "The signed DCC has an XML comment, which no signature covers and which can hide a part of a value.",
            where=where,
            remedy="Ask the laboratory for the file as it was signed.",
        )
    certificates = _embedded(signatures[0], where)
    stated = _stated_time(signatures[0], where)
    moment = when or stated
    refuse_unfit(certificates[0], moment, where)
    _check_xades(data, root, certificates[0], where, moment)
    leaf = certificates[0]
    return DccSignature(
        signer=name_of(leaf.subject),
        issuer=name_of(leaf.issuer),
        serial=leaf.serial_number,
        fingerprint=leaf.fingerprint(hashes.SHA256()).hex(),
        stated_utc=stated,
    )


def _check_xades(data: bytes, root: _Element, leaf: x509.Certificate, where: str, when: datetime) -> None:
    """Check the signature with signxml, and that what it covers is the whole document."""
    exceptions, xades, etree = library("signxml.exceptions"), library("signxml.xades"), library("lxml.etree")
    algorithms = library("signxml.algorithms")
    configuration = xades.XAdESSignatureConfiguration(
        location="./",
        signature_methods=frozenset(algorithms.SignatureMethod[name] for name in _METHODS),
        digest_algorithms=frozenset(algorithms.DigestAlgorithm[name] for name in _DIGESTS),
        verification_time=when,
    )
    try:
        signatures = xades.XAdESVerifier().verify(data, x509_cert=leaf, expect_config=configuration)
    except (
        exceptions.SignXMLException,
        InvalidSignature,
        etree.LxmlError,
        ValueError,
        TypeError,
        AttributeError,
        KeyError,
    ) as error:
        reason = short(str(error)) or type(error).__name__
        raise EvidenceError(
            f"The signature is not valid: {reason}.", where=where, remedy=_TAMPERED
        ) from error
    covered = [
        signature.signed_xml
        for signature in signatures
        if signature.signed_xml is not None and signature.signed_xml.tag == ROOT
    ]
    bare = read_dcc(to_bytes(root), where)
    bare_signature = bare.find(SIGNATURE)
    if bare_signature is not None:
        _drop_keeping_tail(bare, bare_signature)
    if len(covered) != 1 or _canonical(covered[0]) != _canonical(bare):
        raise EvidenceError("The signature does not cover the whole document.", where=where, remedy=_TAMPERED)


def _canonical(root: _Element) -> bytes:
    canonical: bytes = library("lxml.etree").tostring(root, method="c14n", with_comments=False)
    return canonical


def _drop_keeping_tail(root: _Element, element: _Element) -> None:
    """Remove an element but not the text behind it, as the enveloped signature transform does (XMLDSIG 6.6.4)."""
    before, tail = element.getprevious(), element.tail or ""
    if before is None:
        root.text = (root.text or "") + tail
    else:
        before.tail = (before.tail or "") + tail
    element.tail = None
    root.remove(element)


def _embedded(signature: _Element, where: str) -> tuple[x509.Certificate, ...]:
    """Return the certificates in a signature, the signer's first."""
    texts = [
        element.text or ""
        for element in signature.iterfind("ds:KeyInfo/ds:X509Data/ds:X509Certificate", NAMESPACES)
    ]
    pem = "".join(
        f"-----BEGIN CERTIFICATE-----\n{''.join(text.split())}\n-----END CERTIFICATE-----\n"
        for text in texts[: MOST_CERTIFICATES + 1]
    )
    try:
        embedded = tuple(x509.load_pem_x509_certificates(pem.encode())) if texts else ()
    except ValueError:
        embedded = ()
    if not embedded or len(embedded) > MOST_CERTIFICATES:
        raise EvidenceError(
            "The signature has no certificate that can be read.", where=where, remedy=_TAMPERED
        )
    return embedded


def _stated_time(signature: _Element, where: str) -> datetime:
    text = signature.findtext(".//xades:SigningTime", "", NAMESPACES).strip()
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        raise EvidenceError("The signature states no time of signing.", where=where, remedy=_TAMPERED)
    return moment.astimezone(UTC)
