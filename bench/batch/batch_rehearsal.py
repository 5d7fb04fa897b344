"""A batch in a rehearsal: all is as in a real one but what `bench.batch.rehearsal` lists.

It is written in memory if possible, then copied.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from bench.base.clock import VirtualClock
from bench.base.errors import BenchError
from bench.base.memory_folder import temporary_parent
from bench.batch.batch import Batch
from bench.batch.batch_plan import WORKER_S
from bench.batch.batch_record import Item
from bench.batch.supervisor import WorkerEnd
from bench.record.storage import new_output
from bench.record.summaries import BatchSummary
from sequences.queue import Queue
from sequences.reader import Located

_ROOM_BYTES = 1_000_000_000
"""Least room in memory for a rehearsed batch; with less, it is written on the disk, which is slower, but takes no
memory from other programs."""


def rehearse_batch(
    queue: Located[Queue],
    folder: Path,
    *,
    begin: datetime,
    seed: int,
    say: Callable[[str], None],
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> BatchSummary:
    """Rehearse a batch, which cannot be continued, from ``begin``, with its zone, to its end, in a new folder.

    The seed is for runs to which the queue gives none. The same seed and begin give the same journals, byte for byte.
    ``progress`` is told how many runs of all have been rehearsed.
    """
    parent = temporary_parent(_ROOM_BYTES)
    with (
        new_output(folder) as part,
        tempfile.TemporaryDirectory(prefix="starbench-rehearsal-", dir=parent) as place,
    ):
        summary = _rehearse(queue, Path(place), VirtualClock(begin), seed, say, progress)
        shutil.copytree(place, part)
    return summary


def _rehearse(
    queue: Located[Queue],
    folder: Path,
    clock: VirtualClock,
    seed: int,
    say: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> BatchSummary:
    from bench.batch.rehearsal import rehearse_run

    def work(item: Item, run: Path, _log: Path) -> WorkerEnd:
        progress(*batch.runs_done)
        clock.sleep(WORKER_S)
        own_seed = (item.job.seed if item.job.seed is not None else seed) + item.number
        job = item.job
        try:
            end = rehearse_run(
                job.sequence,
                job.station,
                seed=own_seed,
                operator=job.operator,
                folder=run,
                clock=clock,
                settings=job.settings,
            )
        except BenchError as error:
            return WorkerEnd("failed", str(error))
        return WorkerEnd(end.how, end.why)

    batch = Batch(folder, queue, clock, say, work, rehearsal=True)
    return batch.run()
