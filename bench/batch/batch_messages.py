"""Messages of a batch that no run can send: a process died, hung or could not begin; the batch ended.

The station file of each run names the recipients. If a run has sent a message about its failure itself,
the batch uses the same key, so that nobody receives the message twice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from bench.base.clock import BenchClock
from bench.base.errors import BenchError
from bench.batch.batch_summary import batch_name, summary_lines
from bench.batch.supervisor import WorkerEnd
from bench.record.stored_run import StoredRun
from bench.record.summaries import BatchSummary, newest_place
from bench.run.messages.courier import Courier, courier_of
from bench.run.status import read_plan, read_status, status_text
from bench.stations.messages_section import MessagesConfig
from bench.stations.station import load_station
from sequences.errors import DocumentFaults

REPORTED_BY_BATCH = frozenset({"died", "hung", "failed"})


class BatchMessages:
    """Messages of one batch; ``say`` hears of those that could not be sent, which do not end the batch."""

    def __init__(self, clock: BenchClock, say: Callable[[str], None]) -> None:
        self._clock = clock
        self._say = say
        self._courier: Courier | None = None
        self._stations: list[MessagesConfig] = []

    def run_ended(self, key: str, station: str, run: Path, end: WorkerEnd, line: str) -> None:
        """Send a message about a run that failed, died or hung, which the journal line with this hash records."""
        messages = self._messages_of(station)
        if messages is None or self._courier is None or end.how not in REPORTED_BY_BATCH:
            return
        what = f"{end.how}{': ' if end.why else ''}{end.why}"
        text, place = _status_of(run, asked=bool(end.devices))
        if end.how != "failed":
            answers = [device.text for device in end.devices] or ["No device was asked after that."]
            text = "\n".join([f"Its process {what}", *answers, "", text])
        simulated = " (SIMULATED)" if read_plan(run).simulated else ""
        subject = f"Starbench: run {key}{simulated} {what}"
        own_message = _journal_head(run) if end.how == "failed" else ""
        self._courier.write(
            messages, "failure", subject, text, run=key, folder=run, key=own_message or line, place=place
        )

    def batch_ended(self, summary: BatchSummary, folder: Path, line: str) -> None:
        """Send what the terminal prints at the batch's end to all; ``line`` is the hash of its journal line."""
        if self._courier is None:
            return
        name, how, why = summary["queue"], summary["how"], summary["why"]
        what = f"{how}{': ' if why else ''}{why}"
        text = "\n".join(summary_lines(summary, folder))
        for messages in self._stations:
            self._courier.write(
                messages,
                "end" if how in {"finished", "aborted"} else "failure",
                f"Starbench: batch {batch_name(summary)} {what}",
                text,
                run=name,
                folder=folder,
                key=line,
                place=newest_place(summary["items"]),
            )

    def add_recipients(self, stations: Iterable[str]) -> None:
        """Add the recipients that these stations name."""
        for station in stations:
            self._messages_of(station)

    def close(self) -> None:
        """Try once more to send the messages that are waiting."""
        if self._courier is not None:
            self._courier.close()

    def _messages_of(self, station: str) -> MessagesConfig | None:
        """Return what a station says about messages, and count it among the recipients; None if it cannot be read."""
        try:
            messages = load_station(station).value.messages
        except DocumentFaults as error:
            self._say(f"{station} cannot be read any more, so no message can be sent: {error}")
            return None
        if messages not in self._stations:
            self._stations.append(messages)
            self._courier = self._courier or courier_of(messages, self._clock, self._say)
        return messages


def _status_of(run: Path, *, asked: bool) -> tuple[str, tuple[int, str] | None]:
    """Return the status of a run as text, without its devices if they were asked since, and its place in the ledger."""
    try:
        status = read_status(run)
    except BenchError as error:
        return str(error), None
    return status_text(replace(status, devices=()) if asked else status), status.place


def _journal_head(run: Path) -> str:
    """Return the hash of the last line of a run's journal; empty if there is none."""
    try:
        return StoredRun(run).head
    except BenchError:
        return ""
