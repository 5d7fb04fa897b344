"""Keeps the views that a run has found, so that `calibrate` need not find its stars again.

The kept views are no part of the run (`bench.views.kept_views`). Nothing that fails here may harm a run.
"""

from __future__ import annotations

from collections.abc import Mapping

from bench.plan.job import Job
from bench.records.history import History
from bench.results.view_sources import decided_by_run
from bench.views.camera_kinds import EventKind, FrameKind
from bench.views.kept_views import KeptViews, view_key
from bench.views.measure import Measurement


def keep_views_of_run(job: Job, history: History, measured: Mapping[int, Measurement]) -> int:
    """Keep the views of the accepted recordings of a run.

    job: Task of the run. Views of a rehearsal, and of a board in place of the star target, are not kept.
    """
    if type(job.camera_kind) not in {EventKind, FrameKind} or job.board is not None:
        return 0
    kept, count = KeptViews.of_bench(), 0
    for index, attempt in history.accepted().items():
        found = measured.get(index)
        if found is None or found.view is None:
            continue
        options = decided_by_run(job, job.record_step(index), attempt)
        kept.write(view_key(str(attempt.stored["sha256"]), options), found.view)
        count += 1
    return count if not kept.remarks else 0
