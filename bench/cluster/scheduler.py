"""Workers of a Dask scheduler (extra `cluster`). The scheduler and its workers are not started here.

Whoever reaches a scheduler can run programs on its workers: docs/cluster.md says how to protect one.
"""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any

from bench.base.errors import UsageError
from bench.base.failure import Failure
from bench.cluster.work import Finished, Work, Workers, WorkersLost, do

_SILENCE_S = 60.0
"""How long to wait while the scheduler has no worker."""
_CONNECT_S = 10.0
_SIZE_HOLDS_S = 5.0
_LOGGERS = (
    "distributed",
    "distributed.client",
    "distributed.utils",
    "distributed.comm",
    "tornado",
    "asyncio",
)
_REMEDY = "Start it, check the address, then repeat the command: what was done is kept."


class DaskWorkers(Workers):
    """Workers of a Dask scheduler.

    address: Address of the scheduler, as ``tcp://host:8786`` or ``tls://host:8786``. The certificates are
      those of Dask's configuration.
    without_worker_s: How long to wait while the scheduler has no worker, s.
    """

    most_deaths = 3  # how often Dask may give a piece of work up, each time after several deaths

    def __init__(self, address: str, *, without_worker_s: float = _SILENCE_S) -> None:
        super().__init__()
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
        self._executor = self._client.get_executor(pure=False)
        self._left_s = self._without_worker_s = without_worker_s
        self._size, self._size_until_s = 1, 0.0

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
