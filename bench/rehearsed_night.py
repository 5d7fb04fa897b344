"""Rehearses a whole batch on a virtual clock, in this process: ten hours pass in less than a minute.

The same queue, schedule, steps, journals and summary as a batch's; see `bench.rehearsal` for what is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.batch import Batch
from bench.batch_plan import WORKER_S
from bench.clock import VirtualClock
from bench.errors import BenchError, RunFolderError
from bench.rehearsal import rehearse_run
from bench.run_folder import JOURNAL
from bench.schedule import Item
from bench.supervisor import WorkerEnd
from sequences.queue import Queue
from sequences.reader import Located


def rehearse_batch(
    queue: Located[Queue], folder: Path, *, begin: datetime, seed: int, say: Callable[[str], None]
) -> dict[str, Any]:
    """Rehearse a batch from begin to end.

    Parameters
    ----------
    queue
        What is to be run.
    folder
        New, or empty.
    begin
        The virtual moment at which it begins, with its time zone.
    seed
        Of the runs that the queue gives none; the same seed and begin give the same journals, byte for byte.
    say
        Told how it goes.

    Returns
    -------
    dict
        The summary, as in ``summary.json``.

    Raises
    ------
    RunFolderError
        When the folder holds a batch: a rehearsal is not gone on with.
    StorageError
        When the disk does not take it.
    """
    if (folder / JOURNAL).exists():
        raise RunFolderError(
            "There is a batch in this folder.", where=str(folder), remedy="Choose another --output."
        )
    clock = VirtualClock(begin)

    def work(item: Item, run: Path, _log: Path) -> WorkerEnd:
        clock.sleep(WORKER_S)
        own_seed = (item.job.seed if item.job.seed is not None else seed) + item.number
        job = item.job
        try:
            end = rehearse_run(
                job.sequence, job.station, seed=own_seed, operator=job.operator, folder=run, clock=clock
            )
        except BenchError as error:
            return WorkerEnd("failed", str(error))
        return WorkerEnd(end.how, end.why)

    return Batch(folder, queue, clock, say, work, rehearsal=True).run()
