"""Workers of a Dask scheduler: killed in the middle of work, gone, never there."""

import os
import signal
import sys
import time

import cluster_work
import pytest

from bench.base.errors import UsageError
from bench.cluster.processes import DaskWorkers
from bench.cluster.work import Work, WorkersLost

distributed = pytest.importorskip("distributed")

pytestmark = [
    pytest.mark.slow,
    # distributed leaves sockets and threads to the garbage collector when a worker is killed
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


@pytest.fixture
def cluster(monkeypatch, tmp_path):
    path = os.pathsep.join(one for one in sys.path if one)
    monkeypatch.setenv("PYTHONPATH", path)
    made = distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        local_directory=str(tmp_path),
    )
    yield made
    made.close(timeout=5)


def ends(workers, count):
    found = {}
    until = time.monotonic() + 90
    while len(found) < count:
        assert time.monotonic() < until, found
        for end in workers.finished(0.5):
            assert end.key not in found
            found[end.key] = end
    return found


def pid_of_a_worker(workers):
    workers.submit(Work("pid", cluster_work.rest, (0.01,)))
    return ends(workers, 1)["pid"].value


def test_workers_that_are_killed_are_replaced_and_their_work_is_done(cluster, tmp_path):
    with DaskWorkers(cluster.scheduler_address) as workers:
        assert workers.size == 2
        works = [Work(f"double {n}", cluster_work.double, (n,)) for n in range(5)]
        works.append(Work("dies once", cluster_work.die_once, (str(tmp_path / "marker"), 7)))
        works.append(Work("refused", cluster_work.refuse, ()))
        for work in works:
            workers.submit(work)
        found = ends(workers, len(works))
        assert [found[f"double {n}"].value for n in range(5)] == [0, 2, 4, 6, 8]
        assert found["dies once"].value == 7
        assert found["refused"].failure.where == "here"
        os.kill(pid_of_a_worker(workers), signal.SIGKILL)
        workers.submit(Work("after", cluster_work.double, (21,)))
        assert ends(workers, 1)["after"].value == 42


def test_work_with_which_every_worker_dies_fails(cluster):
    with DaskWorkers(cluster.scheduler_address) as workers:
        workers.submit(Work("dies", cluster_work.die, ()))
        assert ends(workers, 1)["dies"].failure.kind == "WorkerDied"


def test_a_scheduler_that_is_lost_is_told(cluster):
    workers = DaskWorkers(cluster.scheduler_address)
    workers.submit(Work("long", cluster_work.rest, (60,)))
    cluster.close(timeout=5)
    with pytest.raises(WorkersLost, match="does not answer any more"):
        ends(workers, 1)
    workers.close()


def test_nobody_at_the_address_is_told():
    with pytest.raises(WorkersLost, match="No Dask scheduler"):
        DaskWorkers("tcp://127.0.0.1:9")


def test_a_scheduler_without_workers_is_told(tmp_path):
    with (
        distributed.LocalCluster(
            n_workers=0, host="127.0.0.1", dashboard_address="127.0.0.1:0", local_directory=str(tmp_path)
        ) as empty,
        DaskWorkers(empty.scheduler_address, without_worker_s=1.0) as workers,
    ):
        workers.submit(Work("waits", cluster_work.double, (1,)))
        with pytest.raises(WorkersLost, match="has no worker"):
            ends(workers, 1)


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"starbench\[cluster\]"):
        DaskWorkers("tcp://127.0.0.1:9")
