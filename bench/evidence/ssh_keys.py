"""Public keys of SSH, and whether a signature by one of them is valid. Bytes only: no files, no trust.

Sources: Ed25519 is RFC 8709; ECDSA is RFC 5656, section 3.1; RSA is RFC 4253, section 6.6, with the hashes of RFC 8332;
keys in a security token (types ``sk-``) are PROTOCOL.u2f of OpenSSH.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, padding, rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature, encode_dss_signature

from bench.evidence.ssh_wire import Reader, encode_mpint, mpint, string, strings

KEY_TYPE = b"ssh-ed25519"
RSA = b"ssh-rsa"
_SK_ED25519 = b"sk-ssh-ed25519@openssh.com"
_SK_ECDSA = b"sk-ecdsa-sha2-nistp256@openssh.com"
_CURVES: dict[bytes, tuple[bytes, ec.EllipticCurve, hashes.HashAlgorithm]] = {
    b"ecdsa-sha2-nistp256": (b"nistp256", ec.SECP256R1(), hashes.SHA256()),
    b"ecdsa-sha2-nistp384": (b"nistp384", ec.SECP384R1(), hashes.SHA384()),
    b"ecdsa-sha2-nistp521": (b"nistp521", ec.SECP521R1(), hashes.SHA512()),
    _SK_ECDSA: (b"nistp256", ec.SECP256R1(), hashes.SHA256()),
}
_RSA_HASHES: dict[bytes, hashes.HashAlgorithm] = {
    b"rsa-sha2-512": hashes.SHA512(),
    b"rsa-sha2-256": hashes.SHA256(),
}
_FEWEST_RSA_BITS, _MOST_RSA_BITS = 2048, 16384
_TOUCHED = 1
"""Bit of the flags of a security token's signature: a person touched the token (PROTOCOL.u2f)."""

KEY_TYPES = (KEY_TYPE, *_CURVES, RSA, _SK_ED25519)
"""Types of keys whose signatures can be verified."""


@dataclass(frozen=True)
class PublicKey:
    """A public key that was read."""

    key_type: bytes  # Its type, as the first word of its line
    key: Ed25519PublicKey | ec.EllipticCurvePublicKey | rsa.RSAPublicKey
    application: bytes | None = None  # Application of a key in a security token; None for other keys

    @classmethod
    def parse(cls, blob: bytes) -> PublicKey:
        """Read a public key.

        blob: The key as SSH encodes it (the part in base64 of its line).
        Raises ValueError: When it is not a key of a known type, or an RSA key of less than 2048 bit.
        """
        reader = Reader(blob)
        key_type = reader.string()
        key: Ed25519PublicKey | ec.EllipticCurvePublicKey | rsa.RSAPublicKey
        if key_type in {KEY_TYPE, _SK_ED25519}:
            key = Ed25519PublicKey.from_public_bytes(reader.string())
        elif key_type in _CURVES:
            name, curve, _ = _CURVES[key_type]
            if reader.string() != name:
                raise ValueError("its curve is not that of its type")
            key = ec.EllipticCurvePublicKey.from_encoded_point(curve, reader.string())
        elif key_type == RSA:
            exponent, modulus = mpint(reader.string()), mpint(reader.string())
            if not _FEWEST_RSA_BITS <= modulus.bit_length() <= _MOST_RSA_BITS:
                raise ValueError(f"an RSA key must have {_FEWEST_RSA_BITS} to {_MOST_RSA_BITS} bit")
            key = rsa.RSAPublicNumbers(exponent, modulus).public_key()
        else:
            raise ValueError("its type of key is not supported")
        application = reader.string() if key_type.startswith(b"sk-") else None
        reader.end()
        return cls(key_type, key, application)

    def is_valid(self, signature: bytes, data: bytes) -> bool:
        """Return whether a signature of this key is valid.

        Returns: Whether it is valid. A security token's signature is valid only if a person touched the
          token.
        Raises ValueError: When the signature is not of the form of this type of key.
        """
        reader = Reader(signature)
        signature_type, signed = reader.string(), reader.string()
        if self.application is not None:
            flags, counter = reader.byte(), reader.take(4)
            data = _token_data(self.application, flags, counter, data)
            if not flags & _TOUCHED:
                return False
        reader.end()
        try:
            self._verify(signature_type, signed, data)
        except InvalidSignature:
            return False
        return True

    def _verify(self, signature_type: bytes, signed: bytes, data: bytes) -> None:
        """Verify a signature. Raises InvalidSignature or ValueError."""
        if isinstance(self.key, rsa.RSAPublicKey):
            if signature_type not in _RSA_HASHES:
                raise ValueError("an RSA signature must be rsa-sha2-512 or rsa-sha2-256")
            size = self.key.key_size // 8
            self.key.verify(signed.rjust(size, b"\0"), data, padding.PKCS1v15(), _RSA_HASHES[signature_type])
            return
        if signature_type != self.key_type:
            raise ValueError("the type of the signature is not that of the key")
        if isinstance(self.key, Ed25519PublicKey):
            if len(signed) != 64:
                raise ValueError("an Ed25519 signature has 64 bytes")
            self.key.verify(signed, data)
        else:
            r, s = (mpint(part) for part in strings(signed, 2))
            self.key.verify(encode_dss_signature(r, s), data, ec.ECDSA(_CURVES[self.key_type][2]))


def _token_data(application: bytes, flags: int, counter: bytes, data: bytes) -> bytes:
    """Return what a security token signs (PROTOCOL.u2f of OpenSSH, "SSH U2F signatures")."""
    return hashlib.sha256(application).digest() + bytes([flags]) + counter + hashlib.sha256(data).digest()


def encode_public_key(key: Ed25519PublicKey | ec.EllipticCurvePublicKey | rsa.RSAPublicKey) -> bytes:
    """Encode a public key as SSH does (RFC 8709, section 4; RFC 5656, section 3.1; RFC 4253, section 6.6).

    Returns: What OpenSSH writes in base64 after the type of the key.
    Raises ValueError: When the curve is not one of SSH's.
    """
    if isinstance(key, Ed25519PublicKey):
        return string(KEY_TYPE) + string(key.public_bytes_raw())
    if isinstance(key, rsa.RSAPublicKey):
        numbers = key.public_numbers()
        return string(RSA) + encode_mpint(numbers.e) + encode_mpint(numbers.n)
    for key_type, (name, curve, _) in _CURVES.items():
        if curve.name == key.curve.name and not key_type.startswith(b"sk-"):
            point = b"\x04" + b"".join(
                n.to_bytes((key.curve.key_size + 7) // 8, "big")
                for n in (key.public_numbers().x, key.public_numbers().y)
            )
            return string(key_type) + string(name) + string(point)
    raise ValueError(f"SSH has no keys on the curve {key.curve.name}")


def encode_ecdsa_signature(key_type: bytes, der: bytes) -> bytes:
    """Encode an ECDSA signature as SSH does (RFC 5656, section 3.1.2).

    der: The signature in DER (RFC 3279, section 2.2.3).
    """
    r, s = decode_dss_signature(der)
    return string(key_type) + string(encode_mpint(r) + encode_mpint(s))


def curve_hash(key_type: bytes) -> hashes.HashAlgorithm:
    """Return the hash of ECDSA signatures of a type of key (RFC 5656, section 6.2.1).

    Returns: The hash.
    """
    return _CURVES[key_type][2]


def key_type_of(public_key: bytes) -> str:
    """Return the type of a public key, as the first word of its line.

    Returns: The type; empty if it cannot be read.
    """
    try:
        return Reader(public_key).string().decode("ascii")
    except ValueError:
        return ""


def fingerprint(public_key: bytes) -> str:
    """Return the fingerprint of a public key, as ``ssh-keygen -l`` prints it.

    Returns: ``SHA256:`` and the hash in base64, without padding.
    """
    digest = base64.b64encode(hashlib.sha256(public_key).digest()).decode()
    return "SHA256:" + digest.rstrip("=")
