"""Rehearses a whole batch on a virtual clock, in this process: ten hours pass in less than a minute.

The same queue, schedule, steps, journals and summary as a batch's; see `rehearsal` for what is left out. It is
written in memory where the system has a place there, and put in its folder as a whole: nothing is worth a sync.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.base.clock import VirtualClock
from bench.base.errors import BenchError, RunFolderError
from bench.batch.batch import Batch
from bench.batch.batch_plan import WORKER_S
from bench.batch.schedule import Item
from bench.batch.supervisor import WorkerEnd
from bench.records.storage import make_folder, storage_errors
from bench.rehearsal.rehearsal import rehearse_run
from sequences.queue import Queue
from sequences.reader import Located

_IN_MEMORY = "/dev/shm"  # noqa: S108 - a place in memory, not a name of a file
_ROOM_BYTES = 1_000_000_000


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
        When the folder is not empty: a rehearsal is not gone on with.
    StorageError
        When the disk does not take it.
    """
    make_folder(folder)
    with storage_errors(folder):
        if any(folder.iterdir()):
            raise RunFolderError(
                "The folder is not empty; a rehearsal is not gone on with.",
                where=str(folder),
                remedy="Choose another --output.",
            )
    with tempfile.TemporaryDirectory(prefix="starbench-rehearsal-", dir=_memory()) as place:
        summary = _rehearse(queue, Path(place), VirtualClock(begin), seed, say)
        with storage_errors(folder):
            shutil.copytree(place, folder, dirs_exist_ok=True)
    return summary


def _memory() -> str | None:
    """Name a folder that lies in memory, where there is one with room; None for the usual one."""
    try:
        roomy = shutil.disk_usage(_IN_MEMORY).free > _ROOM_BYTES
    except OSError:
        return None
    return _IN_MEMORY if roomy else None


def _rehearse(
    queue: Located[Queue], folder: Path, clock: VirtualClock, seed: int, say: Callable[[str], None]
) -> dict[str, Any]:

    def work(item: Item, run: Path, _log: Path) -> WorkerEnd:
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

    return Batch(folder, queue, clock, say, work, rehearsal=True).run()
