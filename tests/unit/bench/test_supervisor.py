"""What a supervisor makes of a worker that cannot even be started."""

from bench.batches.supervisor import supervise
from bench.clock import BenchClock


def test_a_worker_that_cannot_be_started_has_failed_and_the_night_may_go_on(tmp_path):
    run = tmp_path / "run"
    end = supervise([str(tmp_path / "none")], run, tmp_path / "log", BenchClock(), lambda _: None)
    assert (end.how, end.unsafe) == ("failed", ())
    assert "could not be started" in end.why
    (tmp_path / "folder").mkdir()
    assert supervise(["true"], run, tmp_path / "folder", BenchClock(), lambda _: None).how == "failed"
