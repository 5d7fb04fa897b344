r"""The seal of a collimator's passport: the bench's signature inside the file, on a line of its own.

A passport is one file that people copy, so its seal travels in it. The second line of a sealed passport
holds the SSH signature (`bench.evidence.sshsig`) of the file without that line, which is the unsealed
passport. So it can be checked without Starbench::

    sed -n 's/^ "seal": "\(.*\)",$/\1/p' collimator.json | sed 's/\\n/\n/g' > seal.sig
    grep -v '^ "seal": ' collimator.json |
      ssh-keygen -Y verify -f allowed_signers -I bench@lab -n starbench-report@v1 -s seal.sig

This module handles bytes only. It does not decide which keys are trusted.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError
from bench.evidence.keys import BenchKey
from bench.evidence.signers import NAMESPACE
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import is_valid, read_signature

_FIRST = b"{\n"
_BEGIN = b' "seal": '
_MAKE_AGAIN = "Get the file again from who made it; or make a new passport."


@dataclass(frozen=True)
class PassportSeal:
    """The valid seal of a passport."""

    public_key: bytes  # The signer's key, as SSH encodes it
    fingerprint: str


def seal_passport(data: bytes, key: BenchKey) -> bytes:
    """Add a seal to a passport. Removing the second line of the result gives ``data``."""
    if not data.startswith(_FIRST + b" ") or _has_seal_line(data):
        raise EvidenceError("This is not an unsealed passport in the layout that Starbench writes.")
    signature = key.sign(data, NAMESPACE).decode()
    return _FIRST + _BEGIN + json.dumps(signature).encode() + b",\n" + data[len(_FIRST) :]


def read_passport_seal(data: bytes) -> PassportSeal | None:
    """Check the seal of a passport; None if the file has none."""
    if not _has_seal_line(data):
        return None
    line, _, rest = data[len(_FIRST) :].partition(b"\n")
    try:
        armoured = parse_json(line[len(_BEGIN) :].removesuffix(b","))
        signature = read_signature(armoured.encode())
    except (ValueError, AttributeError, EvidenceError) as error:
        raise EvidenceError("The seal of this passport is not a signature.", remedy=_MAKE_AGAIN) from error
    if signature.namespace != NAMESPACE or not is_valid(signature, _FIRST + rest):
        raise EvidenceError(
            "This passport was changed after it was sealed: its seal does not match.", remedy=_MAKE_AGAIN
        )
    return PassportSeal(signature.public_key, fingerprint(signature.public_key))


def _has_seal_line(data: bytes) -> bool:
    return data.startswith(_FIRST + _BEGIN)
