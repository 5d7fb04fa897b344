"""Certificates of a laboratory for tests: an authority, one between, and seals for several kinds of keys."""

import functools
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from cryptography.x509.oid import NameOID

BEGIN = datetime(2026, 1, 1, tzinfo=UTC)
END = datetime(2028, 1, 1, tzinfo=UTC)


def name(text):
    return x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, "Lab"),
            x509.NameAttribute(NameOID.COMMON_NAME, text),
        ]
    )


def issue(subject, key, issuer, issuer_key, *, authority=False, signs=True, begin=BEGIN, end=END):
    """Return a certificate."""
    usage = dict.fromkeys(
        (
            "key_encipherment", "data_encipherment", "key_agreement", "encipher_only", "decipher_only", "crl_sign",
        ),
        False,
    )  # fmt: skip
    return (
        x509.CertificateBuilder()
        .subject_name(name(subject))
        .issuer_name(name(issuer))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(end)
        .add_extension(x509.BasicConstraints(ca=authority, path_length=None), critical=True)
        .add_extension(
            x509.KeyUsage(
                digital_signature=signs and not authority,
                content_commitment=signs and not authority,
                key_cert_sign=authority,
                **usage,
            ),
            critical=True,
        )
        .sign(issuer_key, hashes.SHA256())
    )


@functools.cache
def authority(text="Lab authority"):
    """Return the key and the certificate of an authority that nobody issued."""
    key = ec.generate_private_key(ec.SECP256R1())
    return key, issue(text, key, text, key, authority=True)


@functools.cache
def new_key(kind):
    """Return a private key: ``rsa``, ``rsa-1024``, ``ed25519`` or the name of a curve."""
    if kind.startswith("rsa"):
        return rsa.generate_private_key(public_exponent=65537, key_size=int(kind.partition("-")[2] or 2048))
    if kind == "ed25519":
        return ed25519.Ed25519PrivateKey.generate()
    return ec.generate_private_key(
        {"P-256": ec.SECP256R1, "P-384": ec.SECP384R1, "P-521": ec.SECP521R1}[kind]()
    )


def seal(kind="P-256", **options):
    """Return the key and the certificate of a seal that the authority issued."""
    authority_key, _ = authority()
    key = new_key(kind)
    return key, issue(f"Lab seal {kind}", key, "Lab authority", authority_key, **options)


@functools.cache
def long_chain():
    """Return a key and its chain of three: seal, authority between, authority."""
    root_key, root = authority()
    between_key = ec.generate_private_key(ec.SECP256R1())
    between = issue("Lab between", between_key, "Lab authority", root_key, authority=True)
    key = new_key("P-256")
    return key, (issue("Lab seal", key, "Lab between", between_key), between, root)


def key_pem(key, passphrase=None):
    """Return a private key as PEM."""
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(passphrase) if passphrase else serialization.NoEncryption(),
    )


def pem(*certificates):
    """Return certificates as PEM."""
    return b"".join(certificate.public_bytes(serialization.Encoding.PEM) for certificate in certificates)


def signed_at(days=200):
    """Return a time of signing, so many days after the certificates begin."""
    return BEGIN + timedelta(days=days)
