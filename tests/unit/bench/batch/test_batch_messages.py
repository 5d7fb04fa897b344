"""What a batch tells: of workers that cannot tell themselves, of its own end; nothing twice."""

import re
from datetime import UTC, datetime

import pytest
from station_texts import PLAIN

from bench.base.clock import VirtualClock
from bench.batch.batch_messages import BatchMessages
from bench.batch.supervisor import WorkerEnd
from bench.commands.batch import show_summary
from bench.record.device_end import DeviceEnd
from bench.record.journal import Journal
from bench.record.summaries import newest_place
from bench.run.messages.outbox import Message, Outbox
from bench.stations.station import load_station
from tests.unit.bench.report.test_batch_page import item, summary

NOW = datetime(2026, 3, 1, 20, tzinfo=UTC)
MAIL = "\nmessages: {mail: {host: 127.0.0.1, port: 1, security: none, sender: b@lab.example, to: [a@lab.example]}%s}\n"


@pytest.fixture
def outbox(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    return Outbox(tmp_path / "home")


@pytest.fixture
def messages():
    messages = BatchMessages(VirtualClock(NOW), lambda _line: None)
    yield messages
    messages.close()


def station(folder, more=""):
    path = folder / "station.yaml"
    path.write_text(PLAIN + MAIL % more)
    return str(path)


def delivered(outbox):
    return [(d.message.occasion, d.message.subject) for _, d in outbox.deliveries()]


@pytest.mark.parametrize(
    ("how", "count"), [("died", 1), ("hung", 1), ("failed", 1), ("aborted", 0), ("finished", 0)]
)
def test_what_a_worker_cannot_tell_itself_is_told_once(tmp_path, outbox, messages, how, count):
    for _ in range(2):
        messages.run_ended("cam-001", station(tmp_path), tmp_path / "run", WorkerEnd(how, "so"), "a" * 64)
    assert delivered(outbox) == [("failure", f"Starbench: run cam-001 {how}: so")] * count


def test_what_a_failed_run_told_itself_is_not_told_again(tmp_path, outbox, messages):
    (tmp_path / "run").mkdir()
    with Journal.create(tmp_path / "run" / "journal.jsonl", VirtualClock(NOW)) as journal:
        key = journal.append("run_ended", how="failed", why="so").hash
    words = station(tmp_path)
    messages.add_recipients([words])
    outbox.put(
        Message(key, "failure", "by itself", "", "run", "", NOW.isoformat()),
        load_station(words).value.messages.channels,
    )
    messages.run_ended("cam-001", words, tmp_path / "run", WorkerEnd("failed", "so"), "a" * 64)
    assert delivered(outbox) == [("failure", "by itself")]


LEFT = [DeviceEnd("stage", "confirmed safe", "it stands"), DeviceEnd("light", "not confirmed", "gone")]


@pytest.mark.parametrize(
    ("ends", "told"),
    [(LEFT, ["stage: confirmed safe", "light: not confirmed: gone"]), ([], ["No device was asked"])],
)
def test_a_message_says_how_each_device_was_left_and_claims_nothing_where_nobody_asked(
    tmp_path, outbox, messages, ends, told
):
    """Once every such message said: its stage is stopped, its light is off."""
    end = WorkerEnd("died", "by SIGKILL", 0.0, ends)
    messages.run_ended("cam-001", station(tmp_path), tmp_path / "run", end, "a" * 64)
    ((_, delivery),) = outbox.deliveries()
    assert all(fact in delivery.message.text for fact in told)
    assert ("safe" in delivery.message.text) is bool(ends)


def test_the_end_of_a_batch_says_how_runs_without_a_result_go_on(tmp_path, outbox, messages, capsys):
    begun = tmp_path / "cam 2" / "runs" / "cam-001"
    begun.mkdir(parents=True)
    (begun / "journal.jsonl").touch()
    items = [item(name, "failed") for name in ("cam-001", "never-begun")]
    ended = summary(*items, item("cam-003"), how="failed")
    show_summary(tmp_path / "cam 2", ended)
    printed = capsys.readouterr().out
    messages.add_recipients([station(tmp_path)])
    messages.batch_ended(ended, tmp_path / "cam 2", "a" * 64)
    ((_, delivery),) = outbox.deliveries()
    assert delivery.message.text in printed
    assert f"  starbench resume '{begun}'\n" in printed
    assert printed.count("resume") == 1


def test_the_end_of_a_batch_names_a_drift_as_the_control_charts_judge_it(tmp_path, capsys):
    def group(title, *, seen):
        drift = {"per_day": {"seen": seen}, "per_c": None}
        chart = {"drift": drift}
        return {"title": title, "state": "in control", "verdict": f"{title} judged.", "parameters": [chart]}

    charts = {"groups": [group("Camera 1", seen=True), group("Camera 2", seen=False)]}
    show_summary(tmp_path, summary(item("cam-001"), charts=charts))
    printed = capsys.readouterr().out
    assert "Camera 1: Camera 1 judged." in printed
    assert "Camera 2" not in printed


@pytest.mark.parametrize(
    ("how", "occasion"),
    [("finished", "end"), ("aborted", "end"), ("failed", "failure"), ("stopped", "failure")],
)
def test_everybody_hears_how_the_batch_ended(tmp_path, outbox, messages, how, occasion):
    messages.add_recipients([station(tmp_path)])
    messages.batch_ended(summary(item("cam-001"), how=how), tmp_path, "b" * 64)
    ((_, delivery),) = outbox.deliveries()
    assert delivery.message.occasion == occasion
    assert delivery.message.subject == f"Starbench: batch Night {how}"
    assert re.search("cam-001 +finished +1 attempt", delivery.message.text)


def test_a_message_holds_the_place_of_the_newest_run_in_the_ledger(tmp_path, outbox, messages):
    places = {"c": (10, "b" * 64), "b": (9, "a" * 64), "a": (None, None)}
    items = [item(key, ledger_number=number, ledger_head=head) for key, (number, head) in places.items()]
    assert newest_place(items[2:]) is None
    messages.add_recipients([station(tmp_path)])
    messages.batch_ended(summary(*items), tmp_path, "c" * 64)
    ((_, delivery),) = outbox.deliveries()
    assert f"Ledger: run 10 of this bench, line {'b' * 64}" in delivery.message.text


def test_who_does_not_want_to_hear_of_failures_does_not(tmp_path, outbox, messages):
    words = station(tmp_path, ", occasions: [end]")
    messages.run_ended("cam-001", words, tmp_path / "run", WorkerEnd("died", "so"), "a" * 64)
    assert delivered(outbox) == []


def test_a_station_file_that_is_gone_does_not_end_the_batch(tmp_path, outbox):
    lines = []
    messages = BatchMessages(VirtualClock(NOW), lines.append)
    messages.run_ended("cam-001", str(tmp_path / "gone.yaml"), tmp_path, WorkerEnd("died", "so"), "a" * 64)
    assert "no message" in lines[0]
