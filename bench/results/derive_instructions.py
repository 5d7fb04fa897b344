"""Compares VERIFY.txt of a sealed folder with the instructions for its key: a reader types these commands."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.base.errors import EvidenceError
from bench.evidence.findings import Findings
from bench.evidence.instructions import instructions, kind_of
from bench.evidence.seal import INSTRUCTIONS
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.sshsig import read_signature
from bench.records.run_folder import SIGNATURE
from bench.results.other_software import other_program

_PRINCIPAL = re.compile(r" -I (\S+) -n ")


def check_instructions(folder: Path, used: Mapping[str, Any], found: Findings) -> None:
    """Compare VERIFY.txt with the instructions for the key that sealed the folder.

    found: Findings; they are added.
    """
    try:
        had = (folder / INSTRUCTIONS).read_text(encoding="utf-8", errors="replace")
        signature = read_signature((folder / SIGNATURE).read_bytes())
    except (OSError, EvidenceError) as error:
        found.fault("instructions", INSTRUCTIONS, f"the file cannot be compared: {error}")
        return
    named = _PRINCIPAL.search(had)
    key = fingerprint(signature.public_key)
    if had == instructions(kind_of(folder), principal=named[1] if named else "", fingerprint=key):
        return
    if other_program(used):
        found.not_compared.append(f"{INSTRUCTIONS}: another program wrote it")
    else:
        what = "these are not the instructions for the key that sealed this folder"
        found.fault("instructions", INSTRUCTIONS, what)
