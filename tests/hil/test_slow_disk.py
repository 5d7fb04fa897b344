"""A disk that stands still for longer than a process may be silent: the run waits for it, and nobody ends the run."""

import time

import pytest
from quick_runs import write_queue, write_sequence, write_station
from running import PATIENCE_S, journal, start
from waiting import wait_until

STANDS_STILL_S = 12.0


def stored(run):
    return sum(line["event"] == "capture_stored" for line in journal(run))


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_disk_that_stands_still_is_waited_for(tmp_path, disk):
    sequence, station = write_sequence(tmp_path / "sequence.yaml"), write_station(tmp_path / "station.yaml")
    job = f"name: a, sequence: {sequence}, station: {station}, seed: 7"
    queue = write_queue(tmp_path / "queue.yaml", f"{job}, settings: {{station.disk.min_free_gb: 0.01}}")
    night = disk.mounted / "night"
    process = start("batch", queue, "-o", night, home=tmp_path / "home")
    wait_until(lambda: stored(night / "runs" / "a-001") >= 2 or process.poll() is not None, PATIENCE_S)
    disk.freeze()
    time.sleep(STANDS_STILL_S)
    disk.thaw()
    output = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, output
    (ended,) = [line for line in journal(night) if line["event"] == "item_ended"]
    assert ended["how"] == "finished", ended
