"""Workers of a Dask scheduler (extra `cluster`). The scheduler and its workers are not started here.

Whoever reaches a scheduler can run programs on its workers: docs/cluster.md says how to protect one.
"""

from __future__ import annotations

import logging
import queue
import time
import warnings
from collections import Counter
from collections.abc import Sequence
from typing import Any, Self, cast

from bench.base.errors import UsageError
from bench.base.failure import Failure
from bench.cluster.work import Finished, Work, WorkersLost, do

_SILENCE_S = 60.0
"""How long to wait while the scheduler has no worker."""
_CONNECT_S = 10.0
_RESULT_S = 60.0
_SIZE_HOLDS_S = 5.0
_MOST_ROUNDS = 3
"""How often work is handed out again after Dask gave it up, because as many workers died with it as Dask allows."""
_LOGGERS = (
    "distributed",
    "distributed.client",
    "distributed.utils",
    "distributed.comm",
    "tornado",
    "asyncio",
)
_REMEDY = "Start it, check the address, then repeat the command: what was done is kept."


class DaskWorkers:
    """Workers of a Dask scheduler.

    address: Address of the scheduler, as ``tcp://host:8786`` or ``tls://host:8786``. The certificates are
      those of Dask's configuration.
    without_worker_s: How long to wait while the scheduler has no worker, s.
    Raises UsageError: If Dask is not installed.
    Raises WorkersLost: If nobody answers at the address.
    """

    def __init__(self, address: str, *, without_worker_s: float = _SILENCE_S) -> None:
        try:
            import distributed
        except ImportError as error:
            raise UsageError(
                "Dask is not installed.",
                where="--workers",
                remedy="Install it: pip install 'starbench[cluster]'",
            ) from error
        for name in _LOGGERS:  # a lost connection is told by WorkersLost, not by tracebacks of the libraries
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.address = address
        self._client: Any = None
        try:
            connect: Any = distributed.Client
            self._client = connect(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
            what = f"No Dask scheduler can be used here: {str(error).strip().rstrip('.') or type(error).__name__}."
            raise WorkersLost(what, where=address, remedy=_REMEDY) from error
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._futures: dict[str, Any] = {}
        self._works: dict[str, Work] = {}
        self._rounds: Counter[str] = Counter()
        self._left_s = self._without_worker_s = without_worker_s
        self._size, self._size_until_s = 1, 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def size(self) -> int:
        """Number of threads of all workers; at least 1. The scheduler is asked every few seconds."""
        if time.monotonic() > self._size_until_s:
            try:
                self._size = max(1, sum(self._client.nthreads().values()))
            except (OSError, TimeoutError, ValueError) as error:
                raise self._lost() from error
            self._size_until_s = time.monotonic() + _SIZE_HOLDS_S
        return self._size

    def submit(self, work: Work) -> None:
        """See `Workers.submit`."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", UserWarning
                )  # about arguments of some megabytes: the stars of a run
                future = self._client.submit(do, work, pure=False, key=self._name_of(work))
        except (OSError, TimeoutError, ValueError, RuntimeError) as error:
            raise self._lost() from error
        self._futures[work.key], self._works[work.key] = future, work
        future.add_done_callback(lambda done, key=work.key: self._ended.put((key, done)))

    def finished(self, timeout_s: float) -> Sequence[Finished]:
        """See `Workers.finished`."""
        try:
            key, future = self._ended.get(timeout=timeout_s)
        except queue.Empty:
            self._require_workers(timeout_s)
            return []
        self._left_s = self._without_worker_s
        if future.cancelled() or future.status not in {"finished", "error"}:
            raise self._lost()
        self._futures.pop(key, None)
        if future.status == "error" and type(future.exception()).__name__ == "KilledWorker":
            self._rounds[key] += 1
            if self._rounds[key] < _MOST_ROUNDS:
                self.submit(self._works[key])
                return []
        self._works.pop(key, None)
        return [self._end(key, future)]

    def close(self) -> None:
        """See `Workers.close`. The scheduler and its workers stay."""
        if self._client is None:
            return
        if self._futures and self._client.status == "running":
            self._client.cancel(list(self._futures.values()), force=True)
        self._futures.clear()
        self._client.close(timeout=_CONNECT_S)
        self._client = None

    def _name_of(self, work: Work) -> str:
        """Return a name that no other piece of work of the scheduler has, nor an earlier round of this one."""
        return f"starbench-{work.key}-{id(self):x}-{id(work):x}-{self._rounds[work.key]}"

    def _end(self, key: str, future: Any) -> Finished:
        """Return the end of a piece of work that Dask calls done."""
        if future.status == "finished":
            try:
                return cast("Finished", future.result(timeout=_RESULT_S))
            except (OSError, TimeoutError) as error:
                raise self._lost() from error
        failed = future.exception()
        if type(failed).__name__ == "KilledWorker":
            what = "Several workers died with this work."
            remedy = "Look for a lack of memory in the logs of the workers."
            return Finished(key, failure=Failure("WorkerDied", what, "", remedy))
        what = f"A worker could not do this work: {type(failed).__name__}: {failed}"
        remedy = "Install the same Starbench on the workers."
        return Finished(key, failure=Failure(type(failed).__name__, what, "", remedy))

    def _require_workers(self, waited_s: float) -> None:
        """Raise WorkersLost if the scheduler is gone, or has had no worker for long."""
        if self._client.status != "running":
            raise self._lost()
        try:
            if self._client.nthreads():
                self._left_s = self._without_worker_s
                return
        except (OSError, TimeoutError, ValueError) as error:
            raise self._lost() from error
        self._left_s -= waited_s
        if self._left_s <= 0:
            raise WorkersLost(
                "The scheduler has no worker.",
                where=self.address,
                remedy="Start workers (`dask worker`), then repeat the command: what was done is kept.",
            )

    def _lost(self) -> WorkersLost:
        return WorkersLost("The Dask scheduler does not answer any more.", where=self.address, remedy=_REMEDY)
