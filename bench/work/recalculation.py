"""Many runs calibrated again by many workers: a piece of work is a recording or a run.

Never more recordings are handed out than keep the workers busy. Each run ends with one row; one that fails stops no
other.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial

from bench.base.failure import FORESEEN, Failure
from bench.solve.offline_folder import SealedBy
from bench.work.places import Place
from bench.work.results_folders import ResultsFolders
from bench.work.tasks import (
    ROW_FORMAT,
    CalibratedData,
    DoneRow,
    FailedRow,
    FoundView,
    Listed,
    RunRow,
    SkippedRow,
    Task,
    calibrate_found,
    find_view,
    list_recordings,
)
from bench.work.workers import Finished, Work, Workers, WorkLeft, failure_of, rounds

_AHEAD = 8
"""Runs behind URLs that are listed at the same time: most of that time is spent waiting for answers."""
_Next = tuple[int, Place, Callable[[], Listed]]


@dataclass
class _Run:
    """A run in progress."""

    number: int
    place: Place
    key: str
    captures: Sequence[str]
    name: str
    found: dict[int, FoundView] = field(default_factory=dict)
    share: float = 0.0


@dataclass
class Counts:
    """How far a recalculation is."""

    runs: int
    done: int = 0  # Runs calibrated now
    failed: int = 0  # Runs that failed now
    skipped: int = 0  # Runs that were done before
    recordings: int = 0
    kept: int = 0

    @property
    def ended(self) -> int:
        """Number of runs that have a row."""
        return self.done + self.failed + self.skipped


class Recalculation:
    """Calibrates many runs again; ``ended`` gets each run's row, ``progress`` counts and seconds left, if known."""

    def __init__(
        self,
        places: Sequence[Place],
        task: Task,
        workers: Workers,
        output: ResultsFolders | None = None,
        *,
        ended: Callable[[RunRow], None] = lambda _row: None,
        progress: Callable[[Counts, float | None], None] = lambda _counts, _left: None,
        remark: Callable[[str], None] = lambda _text: None,
    ) -> None:
        self._places, self._task, self._workers, self._output = places, task, workers, output
        self._folders = None if output is None or output.table_only else output
        self._ended, self._progress, self._remark = ended, progress, remark
        self.counts = Counts(len(places))
        self._rows: dict[int, RunRow] = {}
        self._runs: dict[int, _Run] = {}
        self._waiting: deque[Work] = deque()
        self._defects: set[str] = set()
        self._time = WorkLeft()

    def run(self) -> list[RunRow]:
        """Calibrate all runs. A row for each, in their order."""
        source = listed_ahead(self._places, self._task)
        try:
            for ended in rounds(lambda: self._next_work(source), self._workers):
                for end in ended:
                    self._take(end)
                self._show()
        finally:
            source.close()
            if self._output is not None:
                self._output.finish([self._rows[number] for number in sorted(self._rows)])
        return [self._rows[number] for number in sorted(self._rows)]

    def _next_work(self, source: Iterator[_Next]) -> Work | None:
        """Return what is to be done next; None if nothing is left, or only what follows from work in progress."""
        while not self._waiting:
            following = next(source, None)
            if following is None:
                return None
            self._begin(*following)
        return self._waiting.popleft()

    def _begin(self, number: int, place: Place, listed_by: Callable[[], Listed]) -> None:
        """List the recordings of a run; use its results if it was done before."""
        try:
            listed = listed_by()
        except (*FORESEEN, OSError) as error:
            self._fail(number, place, failure_of(error), "")
            return
        row = self._output.done(place.name, listed.key) if self._output is not None else None
        if row is not None:
            self.counts.skipped += 1
            self._rows[number] = row
            row_skipped: SkippedRow = {**row, "skipped": True}
            self._ended(row_skipped)
            self._show()
            return
        name = self._folders.name_for(place.base_name, listed.key) if self._folders else place.base_name
        self._runs[number] = _Run(number, place, listed.key, listed.captures, name)
        for pose, capture in enumerate(listed.captures):
            self._waiting.append(Work(f"{number} {pose}", find_view, (place, pose, capture, self._task)))

    def _take(self, end: Finished) -> None:
        number, _, pose = end.key.partition(" ")
        run = self._runs.get(int(number))
        if run is None:  # another recording of this run has failed before
            return
        if end.failure is not None:
            self._drop(run, end)
        elif pose == "fit":
            self._write(run, end.value.files, end.value.row)
        else:
            self._take_view(run, int(pose), end.value)

    def _take_view(self, run: _Run, pose: int, view_read: FoundView) -> None:
        self.counts.recordings += 1
        self.counts.kept += view_read.kept
        for remark in view_read.remarks:
            self._remark(remark)
        run.found[pose] = view_read
        run.share = len(run.found) / (len(run.captures) + 1)
        if len(run.found) < len(run.captures):
            return
        views = [run.found[at] for at in range(len(run.captures))]
        sealed_by = SealedBy.of(self._folders.key if self._folders is not None else None)
        arguments = (run.place, views, run.name, sealed_by, self._task, self._folders is not None)
        self._waiting.appendleft(Work(f"{run.number} fit", calibrate_found, arguments))
        run.found = {}

    def _write(self, run: _Run, files: Mapping[str, bytes], calibrated: CalibratedData) -> None:
        name = run.name if self._folders is not None else None
        row: DoneRow = {
            "schema": ROW_FORMAT,
            "folder": run.place.name,
            "state": "done",
            "key": run.key,
            "results": name,
            **calibrated,
        }
        if self._folders is not None:
            self._folders.write(run.name, files, row)
        elif self._output is not None:
            self._output.append(row)
        del self._runs[run.number]
        self.counts.done += 1
        self._end(run.number, row)

    def _drop(self, run: _Run, end: Finished) -> None:
        del self._runs[run.number]
        self._waiting = deque(work for work in self._waiting if not work.key.startswith(f"{run.number} "))
        assert end.failure is not None
        if end.defect and end.failure.what not in self._defects:  # a thousand runs may show the same one
            self._defects.add(end.failure.what)
            self._remark(end.defect)
        self._fail(run.number, run.place, end.failure, run.key)

    def _fail(self, number: int, place: Place, failure: Failure, key: str) -> None:
        row: FailedRow = {
            "schema": ROW_FORMAT,
            "folder": place.name,
            "state": "failed",
            "key": key,
            "results": None,
            "results_sha256": None,
            "failure": failure.to_dict(),
        }
        if self._output is not None:
            self._output.append(row)
        self.counts.failed += 1
        self._end(number, row)

    def _end(self, number: int, row: RunRow) -> None:
        self._rows[number] = row
        self._ended(row)
        self._show()

    def _show(self) -> None:
        counts = self.counts
        begun = sum(run.share for run in self._runs.values())
        left = self._time.left_s(counts.done + counts.failed + begun, counts.runs - counts.skipped)
        self._progress(counts, left)


def listed_ahead(places: Iterable[Place], task: Task) -> Generator[_Next, None, None]:
    """List the recordings of the next runs ahead, in threads if they are behind URLs; yield the run and its list."""
    pool = ThreadPoolExecutor(_AHEAD)
    waiting: deque[_Next] = deque()
    try:
        for number, place in enumerate(places):
            listed_by: Callable[[], Listed] = partial(list_recordings, place, task)
            if place.is_remote:
                listed_by = pool.submit(listed_by).result
            waiting.append((number, place, listed_by))
            if len(waiting) > (_AHEAD if place.is_remote else 0):
                yield waiting.popleft()
        yield from waiting
    finally:
        pool.shutdown(cancel_futures=True)
