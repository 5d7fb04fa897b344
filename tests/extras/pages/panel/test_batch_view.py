"""A batch as its page shows it, and what the helper process calculates."""

import json
from contextlib import closing

import numpy as np
import pytest
from journals import MadeRun, made_batch

from bench.extras.pages.panel import batch_view
from bench.extras.pages.panel.batch_view import BatchView
from bench.extras.pages.panel.helper_process import (
    ForecastRequest,
    answer_request,
    picture_of_view,
    smooth_residuals,
)
from bench.extras.pages.panel.watching import Helper, forecast_poses
from bench.measure.measure import StoredImage
from bench.run.last_view import LastView


@pytest.fixture
def batch(tmp_path):
    return made_batch(tmp_path / "night", jobs=("one", "two"))


def test_a_batch_is_told_again_only_when_something_is_new(batch, monkeypatch):
    batch.write("item_begun", item="one-001", again=False, attempt=1, recorded=0)
    made = []
    real = batch_view.summarise
    monkeypatch.setattr(batch_view, "summarise", lambda *words: made.append(1) or real(*words))
    view = BatchView(batch.folder)
    first, lines = view.text()
    assert view.text() == (first, lines)
    assert (len(made), lines) == (1, 2)
    batch.write("item_ended", item="one-001", how="failed", why="no light", noticed_s=0.0, unsafe=[])
    content = json.loads(view.text()[0])
    assert len(made) == 2
    worst = content["items"][0]
    assert (worst["item"], worst["how"], worst["why"]) == ("one-001", "failed", "no light")
    assert content["status"]["running"] is False


def test_a_damaged_batch_says_so(batch):
    batch.path.write_bytes(batch.path.read_bytes().replace(b"Night", b"Day!!"))
    assert "its hash" in json.loads(BatchView(batch.folder).text()[0])["fault"]


def test_failures_come_first_and_what_has_not_begun_last(batch, monkeypatch):
    hows = ("finished", "not begun", "died", "aborted", "failed")
    items = [{"item": str(n), "how": how} for n, how in enumerate(hows)]
    monkeypatch.setattr(batch_view, "summarise", lambda *_: {"items": items})
    shown = json.loads(BatchView(batch.folder).text()[0])
    assert [item["how"] for item in shown["items"]] == ["died", "failed", "finished", "aborted", "not begun"]


# ---------------------------------------------------------------- the helper process

NODES = np.stack(np.meshgrid(np.arange(14.0), np.arange(10.0)), axis=-1).reshape(-1, 2)


def _points(nodes):
    """A perspective image of the nodes with some distortion."""
    x, y = nodes.T / 10.0 - 0.6
    w = 1.0 + 0.02 * x - 0.01 * y
    u, v = x / w, y / w
    r2 = u**2 + v**2
    return 500.0 * np.column_stack([u, v]) * (1.0 + 0.05 * r2)[:, None] + 600.0


def test_a_smooth_fit_leaves_perspective_and_distortion_out_and_a_bad_star_in():
    points = _points(NODES)
    assert np.abs(smooth_residuals(NODES, points)).max() < 0.01
    points[40] += (0.6, 0.0)
    residuals = smooth_residuals(NODES, points)
    assert int(np.argmax(np.linalg.norm(residuals, axis=1))) == 40
    assert residuals[40, 0] == pytest.approx(0.6, abs=0.1)


def test_the_picture_that_a_run_left_is_shown_with_its_stars():
    png = StoredImage.from_image(np.random.default_rng(1).random((36, 64))).png
    picture = picture_of_view(LastView(1, 1, NODES.tolist(), _points(NODES).tolist(), "", png))
    assert picture["size"] == [64, 36]
    assert len(picture["stars"]) == len(picture["residuals"]) == 140
    assert picture["rms_px"] < 0.01
    json.dumps(picture, allow_nan=False)
    nothing = picture_of_view(LastView(1, 1, [], [], "no stars", png))
    assert (nothing["stars"], nothing["residuals"], nothing["fault"]) == ([], None, "no stars")


def test_one_request_that_fails_does_not_end_the_others(tmp_path):
    answer = answer_request(ForecastRequest(tmp_path, 1))
    assert isinstance(answer, str)
    assert "no such file" in answer


def test_the_plan_is_forecast_as_a_whole_first():
    assert forecast_poses(1) == [1]
    assert forecast_poses(10_000)[0] == 60
    assert len(forecast_poses(10_000)) <= 8


def test_a_killed_helper_is_started_again(tmp_path, children):
    request = ForecastRequest(MadeRun(tmp_path / "run").folder, 1)
    with closing(Helper()) as helper:
        assert helper.ask(request)
        children[0].kill()
        children[0].wait()
        assert "has ended" in helper.ask(request)
        assert "has ended" not in helper.ask(request)
        assert len(children) == 2
    assert helper.ask(request) == "The panel is ending."
