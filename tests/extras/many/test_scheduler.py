"""Workers of a Dask scheduler: killed in the middle of work, gone, never there."""

import sys

import cluster_work
import pytest

from bench.base.errors import UsageError
from bench.extras.many.processes import DaskWorkers
from bench.work.workers import Work, WorkersLost
from tests.extras.many.test_work import DASK, ends

distributed = pytest.importorskip("distributed")

pytestmark = DASK


def test_a_scheduler_that_is_lost_is_told(cluster):
    workers = DaskWorkers(cluster.scheduler_address)
    workers.submit(Work("long", cluster_work.rest, (60,)))
    cluster.close(timeout=5)
    with pytest.raises(WorkersLost, match="not answer"):
        ends(workers, Work("again", cluster_work.double, (1,)))
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
        pytest.raises(WorkersLost, match="has no worker"),
    ):
        ends(workers, Work("waits", cluster_work.double, (1,)))


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"starbench\[cluster\]"):
        DaskWorkers("tcp://127.0.0.1:9")
