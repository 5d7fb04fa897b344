"""The page of a run that failed or was aborted, with the bench's signature of it.

The folder is not sealed, so that the run can be continued. A resumed run removes page and signature.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from bench.base.errors import BenchError
from bench.evidence.keys import BenchKey
from bench.evidence.signers import NAMESPACE
from bench.record.history import Attempt, way_on
from bench.record.run_folder import (
    PAGE_SIGNATURE,
    REPORT,
    RunFolder,
)
from bench.record.storage import storage_errors
from bench.record.stored_run import StoredRun
from calib.errors import CalibrationError
from calib.target import StarTarget
from drivers.errors import DriverError

_RING_PX, _RING_BGR = 7, (26, 122, 255)
"""Ring around a star, as the report draws it."""


def write_ended_page(
    folder: RunFolder, key: Callable[[], BenchKey], say: Callable[[str], None], target: StarTarget
) -> None:
    """Write and sign the page. A page that cannot be written is said; the run has ended in any case.

    A run whose journal says that it finished has its report, even if that line could not be synced: it keeps it.
    """
    from bench.report.html import render_ended

    try:
        run = StoredRun(folder.path)
        if run.history.ended in {"", "finished"}:
            return
        way = way_on(run.history, folder.path)
        page = render_ended(run.history, way, run.head, NAMESPACE, seen_pictures(run, target)).encode()
        signature = key().sign(page, NAMESPACE)
        folder.write_atomic(REPORT, page)
        folder.write_atomic(PAGE_SIGNATURE, signature)
    except BenchError as error:
        say(f"The page of the run could not be written: {error}")


def seen_pictures(run: StoredRun, target: StarTarget) -> list[tuple[str, bytes]]:
    """Return captions and event images, PNG: of the last recording of a failed run, if refused, and the last good one.

    The good one has rings around its stars. Empty if the last recording was accepted.
    """
    from bench.measure.measure import StoredImage, recorded_image

    last = run.history.attempts[-1] if run.history.ended == "failed" and run.history.attempts else None
    if last is None or last.checked is None or last.accepted:
        return []
    try:
        image = recorded_image(run.folder / str(last.stored["capture"]))
    except (CalibrationError, DriverError, OSError):  # a recording without a flicker has no such image
        return []
    seen = [("What the camera saw: the recording that was refused last.", StoredImage.from_image(image).png)]
    good = run.history.last_good(last.pose_index)
    if good is not None:
        with suppress(CalibrationError, DriverError, OSError):
            seen.append(_good_picture(run.folder, good, target))
    return seen


def _good_picture(folder: Path, good: Attempt, target: StarTarget) -> tuple[str, bytes]:
    """Return caption and image of an accepted recording, with a ring around each star."""
    import cv2
    import numpy as np

    from bench.measure.measure import recorded_image
    from calib.events.grey_image import to_uint8
    from calib.stars.detect import detect_view

    image = recorded_image(folder / str(good.stored["capture"]))
    expected = good.measured.get("expected_grid")
    view = detect_view(
        image, target, name=good.pose_name, expected=None if expected is None else np.array(expected)
    )
    picture = cv2.cvtColor(to_uint8(image), cv2.COLOR_GRAY2BGR)
    for u, v in view.points_px.round().astype(int).tolist():
        cv2.circle(picture, (u, v), _RING_PX, _RING_BGR, 1, cv2.LINE_AA)
    caption = f"The last good recording of this run, of pose {good.pose_name}: a ring around each of {len(view)} stars."
    return caption, cv2.imencode(".png", picture)[1].tobytes()


def remove_ended_page(folder: RunFolder) -> None:
    """Remove the page that an earlier end of the run has left."""
    with storage_errors(folder.path):
        if (folder.path / PAGE_SIGNATURE).exists():
            (folder.path / REPORT).unlink(missing_ok=True)
            (folder.path / PAGE_SIGNATURE).unlink()
