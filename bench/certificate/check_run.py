"""What was verified of a run before its certificate was issued: the sentence that states it, and the check of it.

The sentence is one of a few that this module makes, so a check makes it again in place of believing it. With ``verify
--again`` the results of the run are made again from its recordings, as they were before the issue.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from bench.base.errors import BenchError
from bench.certificate.certificate_data import CERTIFICATE, Certificate
from bench.evidence.findings import Findings, Verification
from bench.records.ledger import Ledger
from bench.records.reading import read_bounded
from bench.records.run_folder import MANIFEST, RESULTS
from bench.records.storage import sha256_of

_SEAL = "Before the issue the sealed run was verified: its seal, every file, its journal and the ledger."
_SAME = " The results were made again from the recordings, and are the same."
_PARTLY = (
    " The results were made again from the recordings by another version of the program than that of the run;"
    " not compared, and protected by the seal alone: "
)
_NOT_MADE = " The results were not made again from the recordings."
_PART = re.compile(r"(?:plan|results|exports|report|views|VERIFY|poses)")
_PARTS = {
    "plan": "plan",
    "results": "results",
    "exports": "exports",
    "report": "report",
    "views": "stars and images",
    "VERIFY": "instructions",
    "poses": "stars and images",
}


def statement_of(verification: Verification) -> str:
    """Return the sentence that states what was verified."""
    if not verification.again:
        return _SEAL + _NOT_MADE
    if verification.complete:
        return _SEAL + _SAME
    said = " ".join(verification.not_compared)
    parts = sorted({_PARTS[one] for one in _PART.findall(said)} or {"results"})
    return f"{_SEAL}{_PARTLY}{', '.join(parts)}."


def is_statement(text: str) -> bool:
    """Return whether a sentence is one that `statement_of` makes."""
    parts = text.removeprefix(_SEAL + _PARTLY).removesuffix(".").split(", ")
    return text in (_SEAL + _SAME, _SEAL + _NOT_MADE) or (
        text == f"{_SEAL}{_PARTLY}{', '.join(parts)}."
        and parts == sorted(set(parts))
        and set(parts) <= set(_PARTS.values())
    )


def check_run_of_certificate(
    folder: Path, ledger: Ledger, verify_run: Callable[[Path], Verification]
) -> Findings:
    """Make the results of a certificate's run again from its recordings, if it lies where the ledger says.

    folder: The certificate's folder; its files have no fault.
    verify_run: Verifies a run as ``verify --again`` does.
    Raises OSError: When a file cannot be read.
    """
    found = Findings()
    certificate = Certificate.from_json(read_bounded(folder / CERTIFICATE))
    seal = certificate.run.seal_sha256
    try:
        places = [Path(run.folder) for run in ledger.runs() if run.seal == seal]
    except BenchError as error:
        found.not_compared.append(f"the ledger of this bench cannot be read: {error.what.rstrip('.')}")
        return found
    here = [path for path in places if (path / MANIFEST).is_file() and sha256_of(path / MANIFEST) == seal]
    if not here:
        where = f"not in {places[0]} any more" if places else "not in the ledger of this bench"
        found.not_compared.append(
            f"{RESULTS} with the recordings: the run {certificate.run.id} is {where}, so they were not made again"
        )
        return found
    run = verify_run(here[0])
    for fault in run.faults:
        found.fault(fault.kind, f"{here[0]}/{fault.where}", fault.what)
    found.not_compared += run.not_compared
    if run.ok:
        found.remarks.append(f"the results of the run in {here[0]} were made again from its recordings")
    return found
