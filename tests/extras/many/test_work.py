"""Workers: every piece of work ends once, whatever happens to the worker that does it."""

import os
import signal
import time

import cluster_work
import pytest
from waiting import wait_until

from bench.extras.many.processes import DaskWorkers, Processes
from bench.work.workers import Serial, Work, WorkLeft, map_work


def ends(workers, *works):
    """Do the work, and return its ends by key."""
    for work in works:
        workers.submit(work)
    ends_by_key = {}
    until = time.monotonic() + 90
    while len(ends_by_key) < len(works):
        assert time.monotonic() < until, ends_by_key
        for end in workers.finished(0.5):
            assert end.key not in ends_by_key
            ends_by_key[end.key] = end
    return ends_by_key


def test_errors_become_part_of_the_result():
    done = ends(Serial(), Work("a", cluster_work.refuse, ()))["a"]
    assert done.failure.message == "here: No such thing. Do nothing."
    assert not done.defect
    done = ends(Serial(), Work("b", cluster_work.defect, ()))["b"]
    assert "KeyError" in done.defect


def test_a_map_reads_no_more_items_than_it_hands_out():
    read = []

    def items():
        for number in range(10):
            read.append(number)
            yield (number,)

    mapped = map_work(cluster_work.double, items(), Serial())
    next(mapped)
    assert len(read) <= 2


DASK = [
    pytest.mark.slow,
    # distributed leaves sockets and threads to the garbage collector when a worker is killed
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


@pytest.fixture(params=["processes", pytest.param("dask", marks=DASK)])
def workers(request):
    """Two workers: processes of this computer, or those of a Dask scheduler."""
    if request.param == "processes":
        with Processes(2) as made:
            yield made
    else:
        with DaskWorkers(request.getfixturevalue("cluster").scheduler_address) as made:
            yield made


def test_workers_that_die_are_replaced_and_their_work_is_done(workers, tmp_path):
    assert workers.size == 2
    works = [Work(f"double {n}", cluster_work.double, (n,)) for n in range(5)]
    works.append(Work("dies once", cluster_work.die_once, (str(tmp_path / "marker"), 7)))
    works.append(Work("refused", cluster_work.refuse, ()))
    done = ends(workers, *works)
    assert [done[f"double {n}"].value for n in range(5)] == [0, 2, 4, 6, 8]
    assert done["dies once"].value == 7
    assert done["refused"].failure.where == "here"
    pid = ends(workers, Work("pid", cluster_work.rest, (0.01,)))["pid"].value
    os.kill(pid, signal.SIGKILL)
    assert ends(workers, Work("after", cluster_work.double, (21,)))["after"].value == 42


def test_work_with_which_every_worker_dies_fails(workers):
    assert ends(workers, Work("dies", cluster_work.die, ()))["dies"].failure.kind == "WorkerDied"


def test_processes_end_with_their_workers_and_count_those_that_died():
    with Processes(2) as workers:
        done = ends(workers, Work("dies", cluster_work.die, ()))
        assert done["dies"].failure.what.startswith("10 workers died")
        assert "exit code -9" in done["dies"].failure.what
        pid = ends(workers, Work("again", cluster_work.rest, (0.0,)))["again"].value
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_work_that_needs_too_much_memory_fails_and_says_so():
    with Processes(1, memory_bytes=1 << 30) as workers:
        much = Work("much", cluster_work.take_memory, (3 << 30,))
        done = ends(workers, much, Work("few", cluster_work.double, (1,)))
        assert done["much"].failure.kind == "MemoryError"
        assert "--workers" in done["much"].failure.remedy
        assert done["few"].value == 2


def test_closing_ends_work_in_progress(tmp_path):
    workers, place = Processes(1), tmp_path / "pid"
    workers.submit(Work("long", cluster_work.rest, (60, str(place))))
    wait_until(lambda: place.exists() and place.read_text(), 60)
    pid = int(place.read_text())
    begun = time.monotonic()
    workers.close()
    assert time.monotonic() - begun < 10
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_the_time_left_follows_from_the_time_so_far():
    now = [100.0]
    left = WorkLeft(lambda: now[0])
    assert left.left_s(0, 10) is None
    now[0] = 120.0
    assert left.left_s(4, 10) == 30.0
