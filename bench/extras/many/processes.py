"""Workers on this computer: each is a process that does one piece of work after the other."""

from __future__ import annotations

import logging
import os
import threading
import time
import warnings
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any

from bench.base.background import in_background
from bench.base.entry_points import extra_library
from bench.base.failure import Failure
from bench.base.worker_process import WorkerProcess, answer_questions
from bench.work.workers import Finished, Serial, Work, Workers, WorkersLost, do

_MODULE = "bench.extras.many.processes"
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_LOOK_S = 1.0  # A worker whose command was killed works on for so long
_MOST_PROCESSES = 1024  # As `bench.commands.workers` allows
_LEAST_BYTES = 4 << 30  # A fit of 20 views with 9,000 stars takes 0.94 GB
"""Memory that each process on this computer may use at least: a share of this computer's may be less."""
_SILENCE_S = 60.0
"""How long to wait while the scheduler has no worker, s: a cluster needs time to start one."""
_CONNECT_S = 10.0  # A scheduler that is there answers at once
_SIZE_HOLDS_S = 5.0  # Asking the scheduler for each task would cost more than the task
_LOGGERS = (
    "distributed",
    "distributed.client",
    "distributed.utils",
    "distributed.comm",
    "tornado",
    "asyncio",
)
_REMEDY = "Start it, check the address, then repeat the command: what was done is kept."


class Processes(Workers):
    """``count`` workers here (None: one a processor); ``memory_bytes`` limits each, on Linux only."""

    size = 1

    def __init__(self, count: int | None = None, memory_bytes: int | None = None) -> None:
        super().__init__()
        self.size = max(1, count or processors())
        self._memory_bytes = memory_bytes
        self._waiting: deque[Work] = deque()
        self._idle = [WorkerProcess(_MODULE, _ONE_THREAD) for _ in range(self.size)]  # they start when asked
        self._working: dict[Future[Finished], WorkerProcess] = {}
        self._exit_code: int | None = None

    def submit(self, work: Work) -> None:
        """See `Workers.submit`. Work with which a worker died is done first."""
        if work.key in self._deaths:
            self._waiting.appendleft(work)
        else:
            self._waiting.append(work)
        self._hand_out()

    def finished(self, timeout_s: float) -> Sequence[Finished]:
        """See `Workers.finished`."""
        ended = super().finished(timeout_s)
        self._hand_out()
        return ended

    def close(self) -> None:
        """See `Workers.close`."""
        self._waiting.clear()
        for worker in (*self._idle, *self._working.values()):
            worker.close()

    def _hand_out(self) -> None:
        while self._waiting and self._idle:
            worker, work = self._idle.pop(), self._waiting.popleft()
            future = in_background(partial(worker.ask, (self._memory_bytes, work)), "worker")
            self._busy[future], self._working[future] = work, worker

    def _end(self, work: Work, future: Future[Finished]) -> Finished | None:
        worker = self._working.pop(future)
        self._exit_code = worker.exit_code
        self._idle.append(worker)  # one that died starts again with the next work
        return super()._end(work, future)

    def _why_it_died(self, error: BaseException) -> Failure | None:
        if not isinstance(error, EOFError):
            return None
        what = f"{self.most_deaths} workers died with this work, the last with exit code {self._exit_code}."
        remedy = (
            "Look for a lack of memory in the system's log, or give each more: use fewer, with --workers."
        )
        return Failure("WorkerDied", what, "", remedy)


def main() -> None:
    """Do the work of the command that has started this process."""
    import cv2

    threading.Thread(target=_end_with_the_command, daemon=True).start()
    cv2.setNumThreads(1)
    answer_questions(_done)


def _done(question: tuple[int | None, Work]) -> Finished:
    memory_bytes, work = question
    limit_memory(memory_bytes)
    return do(work)


def _end_with_the_command() -> None:
    command = os.getppid()
    while os.getppid() == command:
        time.sleep(_LOOK_S)
    os._exit(1)


def limit_memory(memory_bytes: int | None) -> None:
    """Limit the memory of this process; at the limit Python raises MemoryError. Only Linux has it."""
    if memory_bytes is None:
        return
    try:
        import resource
    except ImportError:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    least = memory_bytes if hard == resource.RLIM_INFINITY else min(memory_bytes, hard)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_DATA, (least, hard))


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def open_processes(count: int | None, most: int | None) -> Workers:
    """Return ``count`` processes (None: one a processor), not more than ``most`` pieces of work if that is known.

    A single one is this process, unless it is asked for.
    """
    size = min(count or processors(), max(1, most) if most is not None else _MOST_PROCESSES)
    if size == 1 and count is None:
        return Serial()
    return Processes(size, max(_LEAST_BYTES, _memory_bytes() // size))


def _memory_bytes() -> int:
    """Return how much memory this computer has; 0 where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 0


class DaskWorkers(Workers):
    """Workers of a Dask scheduler, ``tcp://host:8786`` or ``tls://...``; waits some time if it has no worker."""

    most_deaths = 3  # how often Dask may give a piece of work up, each time after several deaths

    def __init__(self, address: str, *, without_worker_s: float = _SILENCE_S) -> None:
        super().__init__()
        remedy = "Install it: pip install 'starbench[cluster]'"
        dask = extra_library("distributed", "Dask is not installed.", where="--workers", remedy=remedy)
        for name in _LOGGERS:  # a lost connection is told by WorkersLost, not by tracebacks of the libraries
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.address = address
        self._client: Any = None
        try:
            self._client = dask.Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
            what = f"No Dask scheduler can be used here: {str(error).strip().rstrip('.') or type(error).__name__}."
            raise WorkersLost(what, where=address, remedy=_REMEDY) from error
        self._executor = self._client.get_executor(pure=False)
        self._left_s = self._without_worker_s = without_worker_s
        self._size, self._size_until_s = 1, 0.0

    @property
    def size(self) -> int:
        """Number of threads of all workers; at least 1. The scheduler is asked every few seconds."""
        if time.monotonic() > self._size_until_s:
            self._size = max(1, sum(self._threads().values()))
            self._size_until_s = time.monotonic() + _SIZE_HOLDS_S
        return self._size

    def _threads(self) -> Mapping[str, int]:
        """Ask the scheduler for the number of threads of each worker."""
        try:
            return self._client.nthreads()
        except (OSError, TimeoutError, ValueError) as error:
            raise self._lost() from error

    def submit(self, work: Work) -> None:
        """See `Workers.submit`."""
        try:
            with warnings.catch_warnings():
                # About arguments of some megabytes: the stars of a run
                warnings.simplefilter("ignore", UserWarning)
                self._busy[self._executor.submit(do, work)] = work
        except (OSError, TimeoutError, ValueError, RuntimeError) as error:
            raise self._lost() from error

    def finished(self, timeout_s: float) -> Sequence[Finished]:
        """See `Workers.finished`."""
        waiting = len(self._busy)
        ended = super().finished(timeout_s)
        if len(self._busy) == waiting and not ended:
            self._require_workers(timeout_s)
        else:
            self._left_s = self._without_worker_s
        return ended

    def close(self) -> None:
        """See `Workers.close`. The scheduler and its workers stay."""
        if self._client is None:
            return
        if self._busy and self._client.status == "running":
            self._executor.shutdown(wait=False)
        self._busy.clear()
        self._client.close(timeout=_CONNECT_S)
        self._client = None

    def _end(self, work: Work, future: Future[Finished]) -> Finished | None:
        if future.cancelled():
            raise self._lost()
        return super()._end(work, future)

    def _why_it_died(self, error: BaseException) -> Failure | None:
        if type(error).__name__ != "KilledWorker":
            return None
        what = "Several workers died with this work."
        return Failure("WorkerDied", what, "", "Look for a lack of memory in the logs of the workers.")

    def _require_workers(self, waited_s: float) -> None:
        """Raise WorkersLost if the scheduler is gone, or has had no worker for long."""
        if self._client.status != "running":
            raise self._lost()
        if self._threads():
            self._left_s = self._without_worker_s
            return
        self._left_s -= waited_s
        if self._left_s <= 0:
            raise WorkersLost(
                "The scheduler has no worker.",
                where=self.address,
                remedy="Start workers (`dask worker`), then repeat the command: what was done is kept.",
            )

    def _lost(self) -> WorkersLost:
        return WorkersLost("The Dask scheduler does not answer any more.", where=self.address, remedy=_REMEDY)


if __name__ == "__main__":
    main()
