"""Measure the CPU time of issuing a certificate in a laboratory that has issued many.

    python tests/benchmarks/bench_certificates.py [--issued N]

The files of the certificate are left out (PDF, digital certificate, plots): they cost the same for the first and for
the last. What grows with the number is the reading of the ledger.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from certificate_lab import Lab, quick_files

SERIES = "SIMULATED-SB-2026-{number:05d}"


def enter_certificates(lab: Lab, issued: int) -> None:
    """Enter certificates into the ledger of a laboratory that has issued one."""
    with lab.ledger.locked() as journal:
        for count in range(2, issued + 1):
            number = SERIES.format(number=count)
            run = {
                "run_seal": "a" * 64,
                "run_id": "r",
                "folder": f"/c/{count}",
                "issued_utc": "",
                "amends": "",
            }
            journal.append_unsynced("certificate_reserved", number=number, series=SERIES, count=count, **run)
            journal.append_unsynced("certificate_issued", number=number, seal="", serial="", customer="")


def main() -> None:
    """Measure and print one line."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--issued", type=int, default=10_000, help="certificates before the measured one")
    chosen = options.parse_args()
    with (
        tempfile.TemporaryDirectory(prefix="starbench-certificates-") as folder,
        mock.patch("bench.certificate.issue.certificate_files", quick_files),
        mock.patch("bench.certificate.pdf_blocks.plots_of_run", return_value={}),
    ):
        lab = Lab(Path(folder))
        lab.issue()
        enter_certificates(lab, chosen.issued)
        begun = time.process_time()
        number = lab.issue("next", also="x").certificate.number
        print(f"{number} after {chosen.issued} others: {time.process_time() - begun:.2f} s of the processor")


if __name__ == "__main__":
    main()
