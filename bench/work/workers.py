"""Workers: one process, the processes of this computer, or a Dask scheduler, by one interface."""

from __future__ import annotations

import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any, Self

from bench.base.errors import BenchError
from bench.base.failure import FORESEEN, Failure

_WAIT_S = 0.5  # Ctrl-C is noticed within it
_AHEAD = 2
"""Pieces of work handed out for each worker: one in progress, one waiting."""


class WorkersLost(BenchError):
    """The scheduler or all its workers are gone; what was done before is kept."""


@dataclass(frozen=True)
class Work:
    """A piece of work."""

    key: str  # Name of the work, unique among all that are handed out
    function: Callable[..., Any]  # A function at the top of a module; workers import it by its name
    arguments: tuple[Any, ...]


@dataclass(frozen=True)
class Finished:
    """The end of a piece of work."""

    key: str
    value: Any = None  # What the function returned; None if it failed
    failure: Failure | None = None  # Why it failed; None if it did not
    defect: str = ""  # Traceback of an error that was not foreseen; else empty


class Workers:
    """Does pieces of work, in any order, by `concurrent.futures`; again if a worker died, up to a limit."""

    most_deaths = 10
    """How many workers may die with a piece of work before it counts as failed."""

    def __init__(self) -> None:
        self._busy: dict[Future[Finished], Work] = {}
        self._deaths: Counter[str] = Counter()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def size(self) -> int:
        """How many pieces can be in progress at once; at least 1."""
        raise NotImplementedError

    def submit(self, work: Work) -> None:
        """Hand out a piece of work."""
        raise NotImplementedError

    def close(self) -> None:
        """Cancel what is in progress, and end the workers that were started here."""

    def finished(self, timeout_s: float) -> Sequence[Finished]:
        """Wait for any piece of work to end; empty if none does in time. `WorkersLost` if no worker is left."""
        done = wait(self._busy, timeout_s, FIRST_COMPLETED).done
        return [end for task in done if (end := self._end(self._busy.pop(task), task)) is not None]

    def _end(self, work: Work, future: Future[Finished]) -> Finished | None:
        """Return the end of a piece of work; None if a worker died with it and it is handed out again."""
        error = future.exception()
        if error is None:
            self._deaths.pop(work.key, None)
            return future.result()
        died = self._why_it_died(error)
        if died is None:
            what = f"A worker could not do this work: {type(error).__name__}: {error}"
            remedy = "Install the same Starbench on the workers."
            return Finished(work.key, failure=Failure(type(error).__name__, what, "", remedy))
        self._deaths[work.key] += 1
        if self._deaths[work.key] < self.most_deaths:
            self.submit(work)
            return None
        return Finished(work.key, failure=died)

    def _why_it_died(self, error: BaseException) -> Failure | None:
        """Return how work fails with which too many workers died; None if none died with it."""


def failure_of(error: BaseException) -> Failure:
    """Describe an error of a piece of work; that of a file names its path."""
    if not isinstance(error, OSError):
        return Failure.of(error)
    what, remedy = f"{error.strerror or error}.", "Check the path, and whether the workers can reach it."
    return Failure(type(error).__name__, what, str(error.filename or ""), remedy)


def do(work: Work) -> Finished:
    """Do a piece of work; every error becomes part of the result."""
    try:
        return Finished(work.key, work.function(*work.arguments))
    except (*FORESEEN, OSError) as error:
        return Finished(work.key, failure=failure_of(error))
    except MemoryError:
        what = "The work needs more memory than a worker may use."
        failure = Failure("MemoryError", what, "", "Give each more: use fewer, with --workers.")
        return Finished(work.key, failure=failure)
    except Exception as error:  # noqa: BLE001 - one run that shows a defect must not stop a thousand others
        return Finished(work.key, failure=Failure.of(error), defect=traceback.format_exc())


class Serial(Workers):
    """Does the work in this process, as soon as it is handed out."""

    size = 1

    def submit(self, work: Work) -> None:
        """See `Workers.submit`."""
        future: Future[Finished] = Future()
        future.set_result(do(work))
        self._busy[future] = work


def map_work(
    function: Callable[..., Any], items: Iterable[tuple[Any, ...]], workers: Workers
) -> Iterator[tuple[int, Finished]]:
    """Call a pure function at the top of a module for many items; yield each number from 0 and its end, as they end.

    Few items at a time are read and handed out, so there may be very many.

    >>> sorted((number, end.value) for number, end in map_work(abs, [(-1,), (2,)], Serial()))
    [(0, 1), (1, 2)]
    """
    source = (Work(str(number), function, arguments) for number, arguments in enumerate(items))
    for ended in rounds(lambda: next(source, None), workers):
        for end in ended:
            yield int(end.key), end


def rounds(next_work: Callable[[], Work | None], workers: Workers) -> Iterator[list[Finished]]:
    """Hand out work until there is none and all has ended; yield what ended in each round of waiting, if anything."""
    out: set[str] = set()
    while True:
        while len(out) < _most_handed_out(workers) and (work := next_work()) is not None:
            workers.submit(work)
            out.add(work.key)
        if not out:
            return
        ended = {end.key: end for end in workers.finished(_WAIT_S) if end.key in out}  # each once
        out -= ended.keys()
        yield list(ended.values())


def _most_handed_out(workers: Workers) -> int:
    """Return how many pieces of work, at least 1, to hand out at once: no worker waits, and memory stays small."""
    return max(1, _AHEAD * workers.size) if workers.size > 1 else 1


class WorkLeft:
    """Expected time to the end of many pieces of work."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._begun_s = monotonic()

    def left_s(self, done: float, total: float) -> float | None:
        """Return the time left, s, from the time so far; None before anything is done."""
        if done <= 0:
            return None
        return max(0.0, (self._monotonic() - self._begun_s) * (total - done) / done)
