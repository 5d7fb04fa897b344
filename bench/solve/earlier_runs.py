"""The earlier runs of a camera on its bench, by the ledger, and their sealed results."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from bench.base.errors import BenchError
from bench.evidence.seal import read_manifest
from bench.record.history import History
from bench.record.ledger import Ledger
from bench.record.ledger_marks import LedgerRun
from bench.record.results import Results
from bench.record.run_folder import MANIFEST, RESULTS
from bench.record.stored_run import results_of

_MOST_READ = 20
"""Runs whose results are read before the search is given up: each takes some time."""
_LARGEST_BYTES = 100_000_000  # Far above the results of hundreds of poses


class NotComparableError(Exception):
    """Why an earlier calibration cannot be compared, as the end of a sentence."""


def earlier_runs(ledger: Ledger, place: Mapping[str, object]) -> list[LedgerRun] | None:
    """Return the finished runs of a camera before its run at a place of the ledger, the last first, at most 20.

    None if the ledger does not have the run. Raises BenchError if the ledger cannot be read.
    """
    runs = ledger.runs()
    own = next((run for run in runs if run.number == place.get("number")), None)
    if own is None:
        return None
    same = [
        run
        for run in runs[: own.number - 1]
        if (run.camera, run.simulated) == (own.camera, own.simulated) and run.how == "finished" and run.seal
    ]
    return same[::-1][:_MOST_READ]


def last_results(ledger: Ledger, history: History) -> Results | None:
    """Return the results of the last run, before a run, of its sequence with its camera on its bench; None without any.

    An earlier run that cannot be read is passed over: without it, less is known of the bench.
    """
    same = history.started["sequence"], history.started["station"]
    try:
        runs = (earlier_runs(ledger, history.ledger) or []) if history.ledger else []
    except BenchError:  # the report says so
        return None
    for run in runs:
        with suppress(NotComparableError):
            results = read_sealed(Path(run.folder), run.seal or "")[0]
            run_of = results["run"].get("sequence"), results["run"].get("station")
            if run_of == same and results["calibration"]["converged"]:
                return results
    return None


def read_sealed(folder: Path, seal: str) -> tuple[Results, str]:
    """Read sealed results, with the hash of their file; ledger, seal and file must agree."""
    try:
        manifest = (folder / MANIFEST).read_bytes()
        if _sha256(manifest) != seal:
            raise NotComparableError("its folder has another seal than the ledger.")
        listed = read_manifest(manifest).get(RESULTS)
        if listed is None:
            raise NotComparableError("it has no result.")
        data = b"" if (folder / RESULTS).stat().st_size > _LARGEST_BYTES else (folder / RESULTS).read_bytes()
        if _sha256(data) != listed:
            raise NotComparableError("its results were changed after sealing.")
        return results_of(data, folder / RESULTS), listed
    except OSError as error:
        raise NotComparableError("its folder cannot be read.") from error
    except (BenchError, ValueError) as error:
        raise NotComparableError("its results are not readable.") from error


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
