"""A batch as its page shows it."""

from __future__ import annotations

import json

from journals import MadeRun

from bench.panel import panel_app
from bench.panel.panel_app import BatchView

QUEUE = """\
format: starbench/queue/1
name: Night
jobs:
  - {name: one, sequence: three_pose, station: simulated}
  - {name: two, sequence: three_pose, station: simulated}
"""


def _batch(folder):
    batch = MadeRun(folder / "night")
    (batch.folder / "queue.yaml").write_text(QUEUE)
    batch.write("batch_begun", queue="Night", files={})
    return batch


def test_a_batch_is_told_again_only_when_something_is_new(tmp_path, monkeypatch):
    batch = _batch(tmp_path)
    batch.write("item_begun", item="one-001", again=False, attempt=1, recorded=0)
    made = []
    real = panel_app.summarise
    monkeypatch.setattr(panel_app, "summarise", lambda *words: made.append(1) or real(*words))
    view = BatchView(batch.folder)
    first, lines = view.text()
    assert view.text() == (first, lines)
    assert (len(made), lines) == (1, 2)
    batch.write("item_ended", item="one-001", how="failed", why="no light", noticed_s=0.0, unsafe=[])
    found = json.loads(view.text()[0])
    assert len(made) == 2
    worst = found["items"][0]
    assert (worst["item"], worst["how"], worst["why"]) == ("one-001", "failed", "no light")
    assert found["status"]["running"] is False


def test_a_damaged_batch_says_so(tmp_path):
    batch = _batch(tmp_path)
    batch.path.write_bytes(batch.path.read_bytes().replace(b"Night", b"Day!!"))
    assert "does not match its hash" in json.loads(BatchView(batch.folder).text()[0])["fault"]


def test_failures_come_first_and_what_has_not_begun_last(tmp_path, monkeypatch):
    items = [
        {"item": str(n), "how": how}
        for n, how in enumerate(("finished", "not begun", "died", "aborted", "failed"))
    ]
    monkeypatch.setattr(panel_app, "summarise", lambda *_: {"items": items})
    shown = json.loads(BatchView(_batch(tmp_path).folder).text()[0])
    assert [item["how"] for item in shown["items"]] == [
        "died",
        "failed",
        "finished",
        "aborted",
        "not begun",
    ]
