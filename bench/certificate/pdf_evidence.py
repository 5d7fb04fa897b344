"""The sections of the certificate about its evidence: state, authorisation, how to verify, the sealed run.

Turns a certificate into blocks of text; it makes no signature and checks none.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from bench.certificate.certificate_data import Certificate
from bench.certificate.pdf_blocks import Block, Cell, filled, heading, mono, pairs, paragraph, table, together

_AUTHORISATION = "SHA256SUMS.authorised.sig"


def state(certificate: Certificate) -> str:
    """Return the state of the document, and what makes it a certificate (ISO/IEC 17025, 7.8.2.1 o)."""
    person = certificate.authorised_by
    return (
        f"SEALED; not a certificate until authorised by {person.name}, {person.role} (key {person.key_fingerprint})"
        f" \N{EN DASH} see {_AUTHORISATION}."
    )


def authorisation(certificate: Certificate) -> list[Block]:
    """Return who authorises the certificate, and where the signature is (ISO/IEC 17025, 7.8.2.1 o).

    Returns: The blocks.
    """
    person = certificate.authorised_by
    rows: list[tuple[Cell, Cell]] = [
        ("Authorised by", {"text": person.name, "bold": True}),
        ("Role", person.role),
        ("Key", mono(person.key_fingerprint)),
        ("Signature", mono(_AUTHORISATION)),
    ]
    text = (
        f"The signature of {person.name} is the file {_AUTHORISATION} beside this document. It is made with the key"
        " above over the seal, and so over every file of the certificate. Without it this document is sealed by the"
        " bench, but no person has authorised it."
    )
    return [{"kind": "signature", "rows": filled(rows), "lines": [state(certificate), text]}]


def verification(certificate: Certificate, attachments: Mapping[str, bytes]) -> list[Block]:
    """Return the commands that verify the certificate, the sealed run, and the attached files.

    Returns: The blocks.
    """
    run, person = certificate.run, certificate.authorised_by
    steps = [
        {
            "text": "The bench sealed the list of files. The answer begins with “Good” and names a key of the bench.",
            "command": _check("starbench-report@v1", "SHA256SUMS.sig", "SHA256SUMS"),
        },
        {
            "text": "The files are those of the list. Every line must end with “OK”.",
            "command": "sha256sum --strict -c SHA256SUMS",
        },
        {
            "text": f"A person authorised the seal. The answer begins with “Good” and names the key of {person.name}.",
            "command": _check("starbench-authorisation@v1", _AUTHORISATION, "SHA256SUMS.sig"),
        },
    ]
    sealed: list[tuple[Cell, Cell]] = [
        ("Key that sealed the run", mono(f"{run.signer_fingerprint} {run.signer}")),
        ("Key of the person", mono(f"{person.key_fingerprint} {person.name}")),
    ]
    made_from: list[tuple[Cell, Cell]] = [
        ("Run", run.id),
        ("Sequence, station", f"{run.sequence}; {run.station}"),
        ("Number in the ledger", "not in a ledger" if run.ledger_number is None else str(run.ledger_number)),
        ("Head of the ledger", mono(run.ledger_head)),
        ("Head of the journal", mono(run.journal_head)),
        ("SHA-256 of SHA256SUMS", mono(run.seal_sha256)),
        ("SHA-256 of results.json", mono(run.results_sha256)),
        ("SHA-256 of the biases", mono(certificate.item.camera.biases_sha256)),
        ("Software", ", ".join(f"{one.name} {one.version}" for one in run.software)),
    ]
    blocks: list[Block] = [
        paragraph(
            "You need OpenSSH (8.1 or newer) and sha256sum, nothing else. In the folder of this certificate:",
            sticky=True,
        ),
        {"kind": "steps", "steps": steps},
        paragraph(
            "allowed_signers is the list of keys that you trust. Get it from the laboratory in another way than this"
            " certificate, and compare the fingerprints:",
            sticky=True,
        ),
        pairs(sealed, label_mm=40),
        together(heading("The sealed run that this certificate is made from"), pairs(made_from)),
    ]
    if attachments:
        rows: list[list[Cell]] = [
            [mono(name), str(len(data)), mono(hashlib.sha256(data).hexdigest())]
            for name, data in sorted(attachments.items())
        ]
        head: list[Cell] = ["File", "Bytes", "SHA-256"]
        blocks.append(
            together(
                heading("Files attached to this document"),
                table(head, rows, ["auto", "auto", 1], ["left", "right", "left"], size=7.2, **{"break": 60}),
            )
        )
    return blocks


def _check(namespace: str, signature: str, signed: str) -> str:
    """Return a command that checks a signature by any key of the list; OpenSSH finds the name of the signer."""
    return (
        f"ssh-keygen -Y verify -f allowed_signers -n {namespace} -s {signature} \\\n"
        f'  -I "$(ssh-keygen -Y find-principals -f allowed_signers -s {signature})" < {signed}'
    )
