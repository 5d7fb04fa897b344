"""The folder of a certificate: its files from the data, written as a whole and sealed under its final name.

The folder is sealed before it gets its name. So a process that is killed leaves no half certificate.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.evidence.keys import BenchKey
from bench.evidence.seal import seal_folder
from bench.extras.certificate.certificate_data import DCC, PDF, Certificate
from bench.extras.certificate.dcc import render_dcc
from bench.extras.certificate.dcc_xml import differs_by_a_signature, library
from bench.record.results import Results
from bench.record.run_folder import CERTIFICATE, MANIFEST, RESULTS
from bench.record.storage import new_output, require_free, sha256_of, write_files

LAB = "lab.yaml"
PLOTS = "plots"


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


def write_sealed(folder: Path, files: Mapping[str, bytes], key: BenchKey) -> str:
    """Write and seal a folder, named only when it is complete; returns the SHA-256 of its SHA256SUMS."""
    require_free(folder)
    with new_output(folder) as part:
        write_files(part, files)
        seal_folder(part, key)
        return sha256_of(part / MANIFEST)
