"""The folder of a certificate: its files from the data, written as a whole and sealed under its final name.

The folder is made under a hidden name beside its final one, sealed there, and renamed last. So a process
that is killed leaves no half certificate.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from bench.base.errors import UsageError
from bench.evidence.keys import BenchKey
from bench.evidence.seal import remove_unnamed, seal_folder
from bench.extras.certificate.certificate_data import DCC, PDF, Certificate
from bench.extras.certificate.dcc import render_dcc
from bench.extras.certificate.dcc_xml import differs_by_a_signature, library
from bench.record.results import Results
from bench.record.run_folder import CERTIFICATE, MANIFEST, RESULTS, is_sealed
from bench.record.storage import make_folder, sha256_of, storage_errors, write_atomic
from drivers.durable import sync_folder

LAB = "lab.yaml"
PLOTS = "plots"
_UNFINISHED = ".tmp"


def require_libraries() -> None:
    """Refuse to begin without the libraries of PDF and DCC."""
    for name in ("lxml.etree", "typst"):
        library(name)


def certificate_files(
    certificate: Certificate,
    content: Results,
    results: bytes,
    lab: bytes,
    plots: Mapping[str, str],
    stored_dcc: bytes = b"",
) -> dict[str, bytes]:
    """Return the files of a certificate's folder but its seal's.

    ``stored_dcc`` is the file that the folder holds already; it stays if it differs by an XML signature alone.
    """
    from bench.extras.certificate.pdf import render_pdf

    dcc = render_dcc(certificate)
    dcc = stored_dcc if differs_by_a_signature(stored_dcc, dcc) else dcc
    attachments = {DCC: dcc, RESULTS: results}
    return {
        CERTIFICATE: certificate.to_json(),
        RESULTS: results,
        LAB: lab,
        DCC: dcc,
        PDF: render_pdf(certificate, content, attachments, plots),
        **{f"{PLOTS}/{name}.svg": svg.encode() for name, svg in sorted(plots.items())},
    }


def refuse_occupied(folder: Path) -> None:
    """Refuse a name that is taken, or that lies in a sealed folder, before any number is taken."""
    sealed = next((parent for parent in folder.absolute().parents if is_sealed(parent)), None)
    if sealed is not None:
        raise UsageError(
            f"{sealed} is sealed; a file in it would break its seal.",
            where=str(folder),
            remedy="Choose an --output outside of it.",
        )
    if os.path.lexists(folder):
        raise UsageError(
            "A file or folder with this name already exists.",
            where=str(folder),
            remedy="Choose another --output. A certificate is never overwritten.",
        )


def write_sealed(folder: Path, files: Mapping[str, bytes], key: BenchKey) -> str:
    """Write and seal a folder, named only when it is complete; returns the SHA-256 of its SHA256SUMS."""
    part = unfinished(folder)
    make_folder(folder.parent)
    remove_unnamed(part)  # of a process that was killed while it made this folder
    refuse_occupied(folder)
    make_folder(part)
    for name, data in files.items():
        make_folder((part / name).parent)
        write_atomic(part / name, data)
    seal_folder(part, key)
    with storage_errors(folder):
        seal = sha256_of(part / MANIFEST)
        part.rename(folder)
        sync_folder(folder.parent)
    return seal


def unfinished(folder: Path) -> Path:
    """Return the name of a folder while it is being made."""
    return folder.with_name(f".{folder.name}{_UNFINISHED}")
