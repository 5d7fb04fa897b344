"""Time stamps (RFC 3161) of the signatures beside a seal: read and check them without a network.

The reader's ``tsa_certificates.pem`` decides which authorities (TSA) are trusted. Those in ``tsa_laboratory.pem`` are
called "laboratory's clock", because the laboratory could have set it. The files hold replies as ``openssl ts -verify``
reads them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.base.encoding import printable_only
from bench.base.errors import EvidenceError
from bench.evidence.beside_seal import read_beside
from bench.evidence.der import sequence, sets_in_order
from bench.evidence.findings import Findings
from bench.evidence.private_files import refuse_writable_by_others
from bench.evidence.seal import AUTHORISATION, AUTHORISATION_TIMESTAMP, TIMESTAMP
from bench.record.run_folder import SIGNATURE
from bench.record.storage import storage_errors

if TYPE_CHECKING:
    from cryptography.x509 import Certificate


TSA_FILE = "tsa_certificates.pem"
"""Certificates of trusted time stamping authorities, in the configuration folder."""
LABORATORY_TSA_FILE = "tsa_laboratory.pem"
"""Certificates of the laboratory's own time stamping authority, in the configuration folder."""
LABORATORY_CLOCK = "laboratory's clock"
STAMPED = {TIMESTAMP: SIGNATURE, AUTHORISATION_TIMESTAMP: AUTHORISATION}
"""File that each time stamp is of."""

_EXTRA = "pip install 'starbench[certificate]'"
_GRANTED = b"\x30\x03\x02\x01\x00"
"""``PKIStatusInfo`` with the status ``granted`` (RFC 3161, section 2.4.2)."""
_STATUS = {
    1: "granted with changes",
    2: "rejected",
    3: "waiting",
    4: "revocation warning",
    5: "revocation",
}


@dataclass(frozen=True)
class TrustedAuthorities:
    """Certificates of time stamping authorities that the reader trusts."""

    others: tuple[Certificate, ...] = ()  # Of other organisations
    laboratory: tuple[Certificate, ...] = ()  # Of the laboratory's own authority


@dataclass(frozen=True)
class Stamp:
    """A time stamp that is valid and trusted."""

    file: str
    of: str
    utc: datetime
    authority: str
    is_laboratory: bool  # Whether it is the laboratory's own

    @property
    def text(self) -> str:
        """Time and whose clock it is, for a sentence."""
        whose = (
            f"{LABORATORY_CLOCK} ({self.authority})" if self.is_laboratory else f"clock of {self.authority}"
        )
        return f"{self.utc:%Y-%m-%d %H:%M:%S} UTC by the {whose}"


def check_timestamps(folder: Path, authorities: TrustedAuthorities, findings: Findings) -> dict[str, Stamp]:
    """Check the time stamps beside a seal; return those that hold, by file. Nothing is asked over a network."""
    stamps: dict[str, Stamp] = {}
    for name in STAMPED:
        try:
            stamp = _check_file(folder, name, authorities)
        except UncheckedError as error:
            findings.not_compared.append(f"{name}: {error.what}")
        except EvidenceError as error:
            findings.fault("timestamp", name, error.what)
        else:
            stamps |= {name: stamp} if stamp is not None else {}
    return stamps


def _check_file(folder: Path, name: str, authorities: TrustedAuthorities) -> Stamp | None:
    """Check one time stamp beside a seal; None if there is none. Raises EvidenceError."""
    reply = read_beside(folder, name)
    if reply is None:
        return None
    signed = read_beside(folder, STAMPED[name])
    if signed is None:
        raise EvidenceError(f"it is a time stamp of {STAMPED[name]}, which is missing")
    return check_reply(reply, signed, authorities, name)


class UncheckedError(EvidenceError):
    """A time stamp that cannot be checked here: a package or a trusted certificate is missing."""


class OtherFileError(EvidenceError):
    """A time stamp of other bytes."""


def check_reply(reply: bytes, signed: bytes, authorities: TrustedAuthorities, name: str) -> Stamp:
    """Check one time stamp (RFC 3161, 2.4.2); `UncheckedError` without the package or a trusted authority."""
    response = read_reply(reply)
    with _reading():
        _refuse_other_bytes(response, signed)
        authority = _authority_name(response)
    if not authorities.others and not authorities.laboratory:
        raise UncheckedError(
            f"no certificate of a time stamping authority is trusted here; it names {authority}"
            " (give its root with --tsa-certificates FILE)"
        )
    why = ""
    for roots, is_laboratory in ((authorities.laboratory, True), (authorities.others, False)):
        try:
            if roots:
                stamp_library().VerifierBuilder(roots=list(roots)).build().verify_message(response, signed)
                utc = response.tst_info.gen_time.astimezone(UTC)
                return Stamp(name, STAMPED.get(name, ""), utc, authority, is_laboratory)
        except Exception as error:  # noqa: BLE001 - the packages raise many kinds for hostile bytes
            why = _reason(error)
    raise EvidenceError(f"the time stamp of {authority} is not valid or not trusted ({why})")


def as_reply(data: bytes) -> bytes:
    """Return a complete reply. A bare token is put into one, because ``openssl ts -verify -in`` reads replies."""
    for candidate in (data, sequence(_GRANTED + data)):
        with suppress(EvidenceError):
            if read_reply(candidate).as_bytes() == sets_in_order(candidate):
                return candidate
    read_reply(data)
    raise EvidenceError("this is not a time stamp: its encoding is not DER")


def read_authorities(home: Path, certificates: Path | None = None) -> TrustedAuthorities:
    """Read the certificates of trusted time stamping authorities; none where the configuration has no such file."""
    return TrustedAuthorities(
        _read_certificates(certificates or home / TSA_FILE, needed=certificates is not None),
        _read_certificates(home / LABORATORY_TSA_FILE, needed=False),
    )


def _read_certificates(path: Path, *, needed: bool) -> tuple[Certificate, ...]:
    if not needed and not path.exists():
        return ()
    from cryptography.x509 import load_pem_x509_certificates

    with storage_errors(path):
        refuse_writable_by_others(path, "the list of trusted time stamping authorities")
        data = path.read_bytes()
    try:
        return tuple(load_pem_x509_certificates(data))
    except ValueError as error:
        raise EvidenceError(
            "This file has no certificates in PEM.",
            where=str(path),
            remedy="It must hold the root certificate of each trusted time stamping authority.",
        ) from error


def stamp_library() -> Any:
    """Return the package rfc3161-client; UncheckedError where it is not installed."""
    try:
        import rfc3161_client
    except ImportError as error:
        raise UncheckedError(
            "the package for time stamps is not installed", remedy=f"Install it: {_EXTRA}"
        ) from error
    return rfc3161_client


def read_reply(reply: bytes) -> Any:
    """Read a reply that grants a time stamp, with the package of `stamp_library`."""
    client = stamp_library()
    with _reading():
        response = client.decode_timestamp_response(sets_in_order(reply))
        status = response.status
        if status == 0:
            response.tst_info.gen_time  # noqa: B018 - reads the token, or ValueError
            return response
        reasons = ", ".join(response.status_string)
    raise EvidenceError(
        f"the authority did not grant it: {reasons or _STATUS.get(status, f'status {status}')}"
    )


@contextmanager
def _reading() -> Iterator[None]:
    """Turn what the packages raise for bytes of another form into EvidenceError."""
    try:
        yield
    except EvidenceError:
        raise
    except Exception as error:
        raise EvidenceError(f"this is not a time stamp (RFC 3161): {_reason(error)}") from error


def _refuse_other_bytes(response: Any, signed: bytes) -> None:
    """Check the hash in a time stamp before its signature: the message is clearer, and no trust is needed."""
    imprint = response.tst_info.message_imprint
    names = {
        "2.16.840.1.101.3.4.2.1": "sha256",
        "2.16.840.1.101.3.4.2.2": "sha384",
        "2.16.840.1.101.3.4.2.3": "sha512",
    }
    name = names.get(imprint.hash_algorithm.dotted_string)
    if name is None:
        raise EvidenceError(
            f"the hash of the time stamp ({imprint.hash_algorithm.dotted_string}) is not accepted"
        )
    if bytes(imprint.message) != hashlib.new(name, signed).digest():
        raise OtherFileError("it is a time stamp of another file")


def _authority_name(response: Any) -> str:
    """Return the name in the certificate that signed: its common name, else the whole name."""
    from cryptography.x509 import NameOID, load_der_x509_certificate

    signers = response.signed_data.signer_infos
    certificates: Sequence[bytes] = list(response.signed_data.certificates)
    if len(signers) != 1:
        raise EvidenceError(f"the time stamp has {len(signers)} signatures, not one")
    signer = next(iter(signers))
    wanted = (signer.issuer, signer.serial_number)
    known = [
        certificate
        for certificate in map(load_der_x509_certificate, map(bytes, certificates))
        if (certificate.issuer, certificate.serial_number) == wanted
    ]
    if len(known) != 1:  # with two of them, the name of a forged one could be shown
        raise EvidenceError(f"the time stamp holds {len(known)} certificates of its authority, not one")
    common_names = known[0].subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    name = str(common_names[0].value) if common_names else known[0].subject.rfc4514_string()
    return printable_only(name)


def _reason(error: Exception) -> str:
    """Return the part of a library's message that a reader understands."""
    text = str(error)
    marked = text.partition('data: "')[2].partition('"')[0]
    return marked or text.splitlines()[0][:120] if text else type(error).__name__
