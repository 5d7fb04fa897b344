"""The panel in a real browser: what a person sees and presses. Skipped where no Chromium is."""

import re
import signal
from contextlib import contextmanager

import pytest
from journals import MadeRun, at_work, made_batch
from pages import served
from quick_runs import write_sequence, write_station
from running import end_when, entering, journal, start
from waiting import wait_until

from bench.extras.pages.panel.panel_app import panel_app
from bench.extras.pages.web.token import PageToken
from bench.record.journal import read_journal
from calib.model.cause import Cause

PATIENCE_S = 60.0


class Tabs:
    """Tabs of one browser profile; they note errors of scripts and every host that is asked."""

    def __init__(self, chromium, width=1280):
        self.context = chromium.new_context(viewport={"width": width, "height": 900})
        self.errors, self.hosts = [], set()

    def open(self, url):
        tab = self.context.new_page()
        tab.on("pageerror", lambda error: self.errors.append(str(error)))
        tab.on("request", lambda request: self.hosts.add(request.url.split("/")[2]))
        tab.goto(url)
        return tab


@pytest.fixture
def tabs(chromium):
    opened = Tabs(chromium)
    yield opened
    opened.context.close()
    assert opened.errors == []
    assert all(
        re.fullmatch(r"(127\.0\.0\.1|starbench-[0-9a-f]{16}\.localhost):\d+", host) for host in opened.hosts
    )


def wait(holds, what="it"):
    wait_until(holds, PATIENCE_S, what)


def wait_text(tab, selector, words):
    wait(lambda: words in tab.inner_text(selector), f"{words!r} in {selector}")


def log_lines(tab):
    return [
        int(line) for line in tab.eval_on_selector_all("#log li", "all => all.map(one => one.dataset.line)")
    ]


def test_a_person_opens_a_run_holds_it_and_releases_it(run, tabs):
    evil = "<img src=x onerror=alert(1)>"
    run.write("deviation", what=evil)
    with served(panel_app(run.folder.parent)) as server, at_work(run) as (log, _):
        tab = tabs.open(server.url)
        wait_text(tab, "#groups", "In progress")
        tab.click("#groups a")
        wait_text(tab, "#verdict", "running")
        assert tab.inner_text("#simulated") == "SIMULATED"
        wait_text(tab, "#leave", "You may leave.")
        assert evil in tab.inner_text("#log")
        assert tab.query_selector("#log img") is None
        tab.click("#hold")
        tab.fill("dialog input[name=by]", "Ada Lovelace")
        tab.click("#dialog-do")
        wait(lambda: log.history.holder == "Ada Lovelace")
        wait_text(tab, "#leave", "Do not leave. Ada Lovelace")
        tab.click("#release")  # the name is known now: no dialog
        wait(lambda: log.history.holder == "")
        wait_text(tab, "#told", "Accepted: the run continues.")
        tab.click("#abort")
        tab.click("#dialog-cancel")
    commands = [entry.data["word"] for entry in read_journal(run.path)[0] if entry.event == "commanded"]
    assert commands == ["hold", "release"]  # and no abort: its second step was not taken


def test_a_killed_panel_leaves_no_gap(run, tabs):
    with served(panel_app(run.folder.parent)) as server:
        tab = tabs.open(f"{server.url}run/run7")
        wait_text(tab, "#log", "attempt 1 at pose 1: accepted")
        port = server.port
    wait_text(tab, "#link", "No link to the panel.")
    run.record(2)
    run.record(3, accepted=False)
    with served(panel_app(run.folder.parent), port=port):
        wait_text(tab, "#rows", "3 stars, at least 40 are needed")
        wait(lambda: not tab.is_visible("#link"))
        lines = log_lines(tab)
        assert lines == sorted(set(lines))
        stored = [
            n
            for n, text in enumerate(tab.eval_on_selector_all("#log li", "a => a.map(b => b.innerText)"))
            if "stored" in text
        ]
        assert len(stored) == 3


def test_the_list_shows_what_changes_in_every_tab_also_after_the_panel_began_anew(run, tabs):
    root = run.folder.parent
    with served(panel_app(root)) as server:
        first = tabs.open(server.url)
        wait_text(first, "#groups", "run7")
        MadeRun(root / "run8").begin()
        wait_text(first, "#groups", "run8")
        second = tabs.open(server.url)  # it joins the stream of the first, which has begun
        wait_text(second, "#groups", "run7")
        wait_text(second, "#groups", "run8")
        (root / "run8").rename(root.parent / "run8")
        for tab in (first, second):
            wait(lambda tab=tab: "run8" not in tab.inner_text("#groups"), "run8 is gone")
            assert "run7" in tab.inner_text("#groups")
        port = server.port
    wait_text(first, "#link", "No link to the panel.")
    MadeRun(root / "run9").begin()
    with served(panel_app(root), port=port):
        for tab in (first, second):
            wait_text(tab, "#groups", "run9")
            assert "run7" in tab.inner_text("#groups")


@contextmanager
def run_of(batch, item):
    """A run of a batch; it ends with the block."""
    batch.write("item_begun", item=item, again=False, attempt=1, recorded=0)
    run = MadeRun(batch.folder / "runs" / item).begin()
    yield run
    run.end()
    batch.write("item_ended", item=item, how="finished", why="", noticed_s=0.0, unsafe=[])


def write_solved(run, fx_px, causes=()):
    numbers = {"values": {"fx": fx_px}, "sigma": {"fx": 0.6}}
    run.record_all().write(
        "solved", model="spherical", converged=True, rms_px=0.08, **numbers, causes=list(causes)
    )


def test_a_batch_and_a_run_show_what_a_person_did_and_are_not_green(tmp_path, tabs):
    with run_of(made_batch(tmp_path / "night"), "cam-001") as run:
        write_solved(run, 3345.0, [Cause("computer stood still", 100.0, 60.0, unit="s").to_dict()])
        verdict = {"kind": "marginal", "headline": "Calibrated, with reservations."}
        run.write("written", head="", files={}, verdict=verdict)
    with served(panel_app(tmp_path)) as server:
        tab = tabs.open(f"{server.url}batch/night")
        wait_text(tab, "#done", "This computer stood still for 60 s during the run")
        assert tab.inner_text("#done .pill.warn") == "finished"
        tab.goto(f"{server.url}run/night/runs/cam-001")
        wait_text(tab, "#calibrated", "Calibrated, with reservations.")
        wait_text(tab, "#calibrated", "This computer stood still for 60 s")
        assert tab.query_selector("#calibrated.warn")
        assert not tab.is_visible("#leave")


@pytest.mark.parametrize("page", ["", "run/run7", "batch/night"])
def test_nothing_is_cut_on_a_phone(run, chromium, page):
    root = run.folder.parent
    made_batch(root / "night")
    MadeRun(root / ("a-run-with-a-very-long-name-" * 3)).begin().end(
        "failed", "a_reason_without_any_space_" * 8
    )
    tabs = Tabs(chromium, width=390)
    with served(panel_app(root)) as server:
        tab = tabs.open(f"{server.url}{page}")
        wait_text(tab, "main", {"": "Failed", "run/run7": "Gates", "batch/night": "Still to come"}[page])
        wait_text(tab, "main", {"": "run7", "run/run7": "Made up", "batch/night": "Night"}[page])
        assert tab.evaluate("document.documentElement.scrollWidth") == 390
    tabs.context.close()
    assert tabs.errors == []


def test_a_token_is_asked_for_and_stands_in_no_address(run, tabs):
    token = "0123456789abcdef"
    with served(panel_app(run.folder.parent), token=PageToken(token)) as server:
        tab = tabs.open(f"{server.url}run/run7")
        tab.fill("#token", "something else")
        tab.click("button")
        wait_text(tab, "#wrong", "This token is wrong.")
        tab.fill("#token", token)
        tab.click("button")
        tab.wait_for_url("**/run/run7", timeout=1000 * PATIENCE_S)
        wait_text(tab, "#log", "attempt 1 at pose 1: accepted")
        assert token not in tab.url
        by_fragment = Tabs(tab.context.browser)
        other = by_fragment.open(f"{server.url}run/run7#token={token}")
        wait_text(other, "body", "attempt 1 at pose 1: accepted")
        assert token not in other.url
        by_fragment.context.close()
        port = server.port
    with served(panel_app(run.folder.parent), token=PageToken("another token 123"), port=port):
        tab.wait_for_url(
            "**/sign-in?next=*", timeout=1000 * PATIENCE_S
        )  # a panel with a new token asks for it


@pytest.mark.parametrize(
    "elsewhere", ["/%09/127.0.0.1:9/x", "//127.0.0.1:9/x", "/%5C127.0.0.1:9/x", "javascript:1"]
)
def test_a_sign_in_leads_to_pages_of_this_server_only(run, tabs, elsewhere):
    token = "0123456789abcdef"
    with served(panel_app(run.folder.parent), token=PageToken(token)) as server:
        tab = tabs.open(f"{server.url}sign-in?next={elsewhere}#token={token}")
        tab.wait_for_url(lambda url: "/sign-in" not in url, timeout=1000 * PATIENCE_S)
        assert re.match(r"http://starbench-[0-9a-f]{16}\.localhost:", tab.url)


@pytest.mark.slow
def test_a_real_run_is_watched_killed_resumed_and_aborted(tmp_path, tabs):
    root, folder = tmp_path / "runs", tmp_path / "runs" / "real"
    files = write_sequence(tmp_path / "sequence.yaml"), write_station(tmp_path / "station.yaml")
    first = start("run", files[0], "-s", files[1], "-o", folder, home=tmp_path)
    with served(panel_app(root)) as server:
        tab = tabs.open(server.url)
        tab.click("#groups a", timeout=1000 * PATIENCE_S)
        tab.wait_for_selector("#picture img", timeout=1000 * PATIENCE_S)
        assert re.search(r"\d+ stars; residuals against", tab.inner_text("#picture-note"))
        wait_text(tab, "#coverage-note", "of the image has stars")
        end_when(first, folder, entering("recording", 3), signal.SIGKILL)
        wait_text(tab, "#verdict", "interrupted")
        wait_text(tab, "#leave", "Its journal does not say how it left the bench")
        second = start("resume", folder, home=tmp_path)
        wait_text(tab, "#verdict", "running")
        wait(lambda: tab.is_enabled("#abort"))
        tab.fill("#person", "Ada")
        tab.click("#abort")
        tab.click("#dialog-do")
        wait_text(tab, "#verdict", "stopped")
        assert second.wait(PATIENCE_S) == 3
        second.communicate()
        lines = log_lines(tab)
        assert lines == sorted(set(lines))
    assert journal(folder)[-1]["why"] == "abort by Ada"
