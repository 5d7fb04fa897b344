"""Keys and X.509 certificates of laboratories for signatures in XML: loaded, put in order, judged (RFC 5280)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from bench.base.errors import EvidenceError
from bench.certificate.dcc_xml import short
from bench.evidence.safe_files import refuse_readable_by_others
from bench.records.storage import storage_errors

PrivateKey = rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey

EC_METHODS = {"secp256r1": "ecdsa-sha256", "secp384r1": "ecdsa-sha384", "secp521r1": "ecdsa-sha512"}
"""Signature method of XML for each curve."""
MOST_CERTIFICATES = 10
"""Most certificates of a chain."""
_LEAST_RSA_BITS = 2048
_KEY_FORM = "Use a key in PEM: RSA of 2048 bits or more, or ECDSA on P-256, P-384 or P-521."


def load_signing_key(path: Path, *, ask_passphrase: Callable[[Path], bytes] | None = None) -> PrivateKey:
    """Load the laboratory's key for signatures in XML.

    path: Its file, PEM, which only its owner can read.
    ask_passphrase: Returns the passphrase of a protected key; None if nobody can be asked.
    Raises EvidenceError: When others can read the file, it is protected and nobody can be asked, or it is not
      a key that can sign.
    Raises StorageError: When it cannot be read.
    """
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
    """Load certificates in PEM: the laboratory's chain, or certificates that a reader trusts.

    Returns: The certificates, in the order of the file.
    Raises EvidenceError: When the file has none, more than ten, or one that cannot be read.
    Raises StorageError: When it cannot be read.
    """
    with storage_errors(path):
        data = path.read_bytes()
    try:
        found = tuple(x509.load_pem_x509_certificates(data))
    except ValueError as error:
        raise EvidenceError(
            "The file has no certificates in PEM.",
            where=str(path),
            remedy="Name a file with `-----BEGIN CERTIFICATE-----`.",
        ) from error
    if len(found) > MOST_CERTIFICATES:
        raise EvidenceError(
            f"The file has {len(found)} certificates; a chain has at most {MOST_CERTIFICATES}.",
            where=str(path),
            remedy="Name a file with the chain alone.",
        )
    return found


def in_order(chain: Sequence[x509.Certificate], key: PrivateKey) -> list[x509.Certificate]:
    """Return a chain with the certificate of the key first, each followed by that of its issuer.

    chain: The certificates, in any order.
    key: The private key of the first.
    Raises EvidenceError: When none belongs to the key, or one is no part of the chain.
    """
    public = key.public_key()
    left = list(chain)
    leaf = next((one for one in left if one.public_key() == public), None)
    if leaf is None:
        raise EvidenceError(
            "No certificate of the chain belongs to the key.",
            remedy="Name the certificate that was issued for this key.",
        )
    ordered = [leaf]
    left.remove(leaf)
    while left and (issuer := next((one for one in left if _issued(ordered[-1], one)), None)) is not None:
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
    """Refuse a signer's certificate that is not valid at a time or not meant for signatures (RFC 5280, 4.2.1.3).

    when: The time, with its time zone.
    Raises EvidenceError: When it is one of these.
    """
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


def leads_to(
    certificates: Sequence[x509.Certificate], trusted: Sequence[x509.Certificate], when: datetime
) -> bool:
    """Return whether a chain leads to a trusted certificate (RFC 5280, 6.1, without names and policies).

    certificates: The signer's certificate, then others that came with it.
    when: Time at which the issuers must be valid, with its time zone.
    Returns: True if it leads to one of them, or is one.
    """
    current, left = certificates[0], list(certificates[1:])
    for _ in range(MOST_CERTIFICATES):
        if current in trusted:
            return True
        anchor = next((one for one in trusted if _may_issue(one, when) and _issued(current, one)), None)
        if anchor is not None:
            return True
        issuer = next((one for one in left if _may_issue(one, when) and _issued(current, one)), None)
        if issuer is None:
            return False
        left.remove(issuer)
        current = issuer
    return False


def _may_issue(certificate: x509.Certificate, when: datetime) -> bool:
    """Return whether a certificate is one of an authority, and valid."""
    if not certificate.not_valid_before_utc <= when <= certificate.not_valid_after_utc:
        return False
    try:
        return certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    except x509.ExtensionNotFound:
        return False


def name_of(name: x509.Name) -> str:
    """Return the name of a certificate's owner or issuer for messages.

    Returns: The name, RFC 4514, cut if it is long.
    """
    return short(name.rfc4514_string()) or "nobody"
