"""The page of a run that failed or was aborted, with the bench's signature of it.

The folder is not sealed, so that the run can be continued. A resumed run removes page and signature.
"""

from __future__ import annotations

from collections.abc import Callable

from bench.base.errors import BenchError
from bench.evidence.keys import NAMESPACE, BenchKey
from bench.evidence.sshsig import sign
from bench.records.history import replay
from bench.records.journal import read_journal
from bench.records.run_folder import REPORT, RunFolder
from bench.records.storage import storage_errors
from bench.records.way_on import way_on

PAGE_SIGNATURE = f"{REPORT}.sig"


def write_ended_page(folder: RunFolder, key: Callable[[], BenchKey], say: Callable[[str], None]) -> None:
    """Write and sign the page. A page that cannot be written is said; the run has ended in any case.

    key: Returns the key to sign with.
    """
    from bench.report.ended_page import render_ended

    try:
        entries = read_journal(folder.journal_path)[0]
        history = replay(entries)
        if not history.ended:
            return
        page = render_ended(history, way_on(history, folder.path), entries[-1].hash, NAMESPACE).encode()
        signature = sign(key().private, page, NAMESPACE)
        folder.write_atomic(REPORT, page)
        folder.write_atomic(PAGE_SIGNATURE, signature)
    except BenchError as error:
        say(f"The page of the run could not be written: {error}")


def remove_ended_page(folder: RunFolder) -> None:
    """Remove the page that an earlier end of the run has left.

    Raises StorageError: If it cannot be removed.
    """
    with storage_errors(folder.path):
        if (folder.path / PAGE_SIGNATURE).exists():
            (folder.path / REPORT).unlink(missing_ok=True)
            (folder.path / PAGE_SIGNATURE).unlink()
