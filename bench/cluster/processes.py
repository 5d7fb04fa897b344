"""Workers on this computer: one process for each, without a scheduler and without a network.

A worker that dies is replaced, and its work is done again; only a piece of work with which several workers died counts
as failed. A worker ends when its pipe is closed, so none outlives the command for longer than its present work.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Self

from bench.base.failure import Failure
from bench.cluster.work import MOST_DEATHS, Finished, Work, do

_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_END_S = 2.0


class _Worker:
    """A process that does one piece of work at a time."""

    def __init__(self, memory_bytes: int | None) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(target=_serve, args=(theirs, memory_bytes), daemon=True)
        with _one_thread():
            self.process.start()
        theirs.close()
        self.work: Work | None = None

    def end(self) -> None:
        """End the process at once."""
        with suppress(OSError):
            self.pipe.close()
        self.process.terminate()
        self.process.join(_END_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


class Processes:
    """Workers on this computer.

    count: Number of processes; None for one for each processor.
    memory_bytes: Memory that each may use; None for no limit. Only Linux limits it.
    """

    def __init__(self, count: int | None = None, memory_bytes: int | None = None) -> None:
        self._memory_bytes = memory_bytes
        self._waiting: deque[Work] = deque()
        self._deaths: Counter[str] = Counter()
        self.size = max(1, count or processors())
        self.replaced = 0
        self._workers: list[_Worker] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pids(self) -> list[int]:
        """Numbers of the processes."""
        return [worker.process.pid for worker in self._workers if worker.process.pid]

    def submit(self, work: Work) -> None:
        """See `Workers.submit`."""
        self._waiting.append(work)
        self._hand_out()

    def finished(self, timeout_s: float) -> Sequence[Finished]:
        """See `Workers.finished`."""
        busy = {worker.pipe: worker for worker in self._workers if worker.work is not None}
        ended = []
        for pipe in wait(list(busy), timeout_s):
            worker = busy[pipe]  # type: ignore[index] # of the pipes that were given
            try:
                ended.append(worker.pipe.recv())
                self._deaths.pop(ended[-1].key, None)
                worker.work = None
            except (EOFError, OSError):
                ended += self._replace(worker)
        self._hand_out()
        return ended

    def close(self) -> None:
        """See `Workers.close`."""
        self._waiting.clear()
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    def _hand_out(self) -> None:
        while self._waiting:
            worker = next((one for one in self._workers if one.work is None), None)
            if worker is None:
                if len(self._workers) >= self.size:
                    return
                worker = _Worker(self._memory_bytes)
                self._workers.append(worker)
            work = self._waiting.popleft()
            try:
                worker.pipe.send(work)
            except OSError:  # it died while it had nothing to do
                self._waiting.appendleft(work)
                self._replace(worker)
                continue
            worker.work = work

    def _replace(self, worker: _Worker) -> list[Finished]:
        """Forget a worker that died; do its work again, or give it up."""
        worker.end()
        self._workers.remove(worker)
        self.replaced += 1
        work = worker.work
        if work is None:
            return []
        self._deaths[work.key] += 1
        if self._deaths[work.key] < MOST_DEATHS:
            self._waiting.appendleft(work)
            return []
        what = (
            f"{MOST_DEATHS} workers died with this work, the last with exit code {worker.process.exitcode}."
        )
        remedy = (
            "Look for a lack of memory in the system's log, or give each more: use fewer, with --workers."
        )
        return [Finished(work.key, failure=Failure("WorkerDied", what, "", remedy))]


def _serve(pipe: Connection, memory_bytes: int | None) -> None:
    """Do the work that comes through a pipe, until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the command, which ends its workers
    limit_memory(memory_bytes)
    _one_thread_of_opencv()
    with suppress(EOFError, OSError):
        while True:
            pipe.send(do(pipe.recv()))


def limit_memory(memory_bytes: int | None) -> None:
    """Limit the memory of this process; where the limit is reached, Python raises MemoryError.

    memory_bytes: The limit; None for none. Systems other than Linux ignore it.
    """
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


def _one_thread_of_opencv() -> None:
    import cv2

    cv2.setNumThreads(1)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes that start in the block use one thread each, as the command itself does."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def processors() -> int:
    """Return how many processors this process may use.

    Returns: At least 1.
    """
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
