"""Workers: every piece of work ends once, whatever happens to the worker that does it."""

import os
import time

import cluster_work
import pytest

from bench.cluster.processes import Processes
from bench.cluster.work import Serial, TimeLeft, Work, map_work


def ends(workers, *works):
    """Do the work, and return its ends by key."""
    for work in works:
        workers.submit(work)
    found = {}
    until = time.monotonic() + 60
    while len(found) < len(works):
        assert time.monotonic() < until, found
        for end in workers.finished(0.5):
            assert end.key not in found
            found[end.key] = end
    return found


def test_one_process_maps_a_function_over_items():
    found = dict(map_work(cluster_work.double, ((n,) for n in range(5)), Serial()))
    assert {number: end.value for number, end in found.items()} == {0: 0, 1: 2, 2: 4, 3: 6, 4: 8}


def test_errors_become_part_of_the_result():
    found = ends(Serial(), Work("a", cluster_work.refuse, ()))["a"]
    assert found.failure.message == "here: No such thing. Do nothing."
    assert not found.defect
    found = ends(Serial(), Work("b", cluster_work.defect, ()))["b"]
    assert "KeyError" in found.defect


def test_a_map_reads_no_more_items_than_it_hands_out():
    read = []

    def items():
        for number in range(10):
            read.append(number)
            yield (number,)

    mapped = map_work(cluster_work.double, items(), Serial())
    next(mapped)
    assert len(read) <= 2


def test_processes_do_the_work_of_those_that_die(tmp_path):
    with Processes(2) as workers:
        found = ends(
            workers,
            Work("lives", cluster_work.double, (4,)),
            Work("dies once", cluster_work.die_once, (str(tmp_path / "marker"), 7)),
            Work("dies", cluster_work.die, ()),
            Work("refused", cluster_work.refuse, ()),
        )
        assert found["lives"].value == 8
        assert found["dies once"].value == 7
        assert found["dies"].failure.kind == "WorkerDied"
        assert "10 workers died" in found["dies"].failure.what
        assert found["refused"].failure.where == "here"
        assert workers.replaced == 11
        assert ends(workers, Work("again", cluster_work.double, (5,)))["again"].value == 10
        pids = workers.pids
    assert pids
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_work_that_needs_too_much_memory_fails_and_says_so():
    with Processes(1, memory_bytes=1 << 30) as workers:
        found = ends(
            workers,
            Work("much", cluster_work.take_memory, (3 << 30,)),
            Work("few", cluster_work.double, (1,)),
        )
        assert found["much"].failure.kind == "MemoryError"
        assert "--workers" in found["much"].failure.remedy
        assert found["few"].value == 2
        assert workers.replaced == 0


def test_closing_ends_work_in_progress():
    workers = Processes(1)
    workers.submit(Work("long", cluster_work.rest, (60,)))
    (pid,) = workers.pids
    begun = time.monotonic()
    workers.close()
    assert time.monotonic() - begun < 10
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_the_time_left_follows_from_the_time_so_far():
    now = [100.0]
    left = TimeLeft(lambda: now[0])
    assert left.left_s(0, 10) is None
    now[0] = 120.0
    assert left.left_s(4, 10) == 30.0
