"""The page of a run that failed or was aborted, with the bench's signature of it.

The folder is not sealed, so that the run can be continued. A resumed run removes page and signature.
"""

from __future__ import annotations

from collections.abc import Callable

from bench.base.errors import BenchError
from bench.evidence.keys import BenchKey
from bench.evidence.signers import NAMESPACE
from bench.record.history import way_on
from bench.record.run_folder import (
    PAGE_SIGNATURE,
    REPORT,
    RunFolder,
)
from bench.record.storage import storage_errors
from bench.record.stored_run import StoredRun
from calib.errors import CalibrationError
from drivers.errors import DriverError


def write_ended_page(folder: RunFolder, key: Callable[[], BenchKey], say: Callable[[str], None]) -> None:
    """Write and sign the page. A page that cannot be written is said; the run has ended in any case.

    A run whose journal says that it finished has its report, even if that line could not be synced: it keeps it.
    """
    from bench.report.html import render_ended

    try:
        run = StoredRun(folder.path)
        if run.history.ended in {"", "finished"}:
            return
        way = way_on(run.history, folder.path)
        page = render_ended(run.history, way, run.head, NAMESPACE, refused_picture(run)).encode()
        signature = key().sign(page, NAMESPACE)
        folder.write_atomic(REPORT, page)
        folder.write_atomic(PAGE_SIGNATURE, signature)
    except BenchError as error:
        say(f"The page of the run could not be written: {error}")


def refused_picture(run: StoredRun) -> bytes:
    """Return the event image of the last recording of a failed run, if it was refused, as PNG; empty without one."""
    from bench.measure.measure import StoredImage, recorded_image

    last = run.history.attempts[-1] if run.history.ended == "failed" and run.history.attempts else None
    if last is None or last.checked is None or last.accepted:
        return b""
    try:
        return StoredImage.from_image(recorded_image(run.folder / str(last.stored["capture"]))).png
    except (CalibrationError, DriverError, OSError):  # a recording without a flicker has no such image
        return b""


def remove_ended_page(folder: RunFolder) -> None:
    """Remove the page that an earlier end of the run has left."""
    with storage_errors(folder.path):
        if (folder.path / PAGE_SIGNATURE).exists():
            (folder.path / REPORT).unlink(missing_ok=True)
            (folder.path / PAGE_SIGNATURE).unlink()
