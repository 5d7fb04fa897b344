"""The page of a run that failed or was aborted: why it ended, what to do, what was recorded.

Text from the journal alone, so that a run without results has its page too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from bench.records.history import Attempt, History
from bench.report.device_tables import left
from bench.report.html import environment
from bench.report.text import NOTHING, moment, number, value_text


class RecordedRow(NamedTuple):
    """A recording, as printed."""

    pose: str
    attempt: int
    verdict: str  # ``pass``, ``fail``, or ``marginal`` if it was not measured
    label: str
    stars: str
    events: str
    reasons: str
    capture: str


def render_ended(history: History, way_on: tuple[str, str], journal_head: str, namespace: str) -> str:
    """Render the page of a run that did not finish.

    way_on: What there is to know and the command that can work (`bench.records.way_on`).
    journal_head: Hash of the journal's last line; it identifies the whole journal.
    namespace: Namespace of the bench's signatures.
    """
    failure = history.failures[-1] if history.ended == "failed" and history.failures else None
    return (
        environment()
        .get_template("ended.html.j2")
        .render(
            run=history.started,
            how="failed" if history.ended == "failed" else "was aborted",
            what=failure["what"] if failure else history.why,
            where=failure["where"] if failure else "",
            remedy=failure["remedy"] if failure else "",
            way_on=way_on,
            identification=_identification(history),
            recordings=[_row(attempt) for attempt in history.attempts],
            accepted=len(history.accepted()),
            lost=sum(history.lost.values()),
            deviations=[*history.deviations, *history.holds],
            devices_left=left(history.devices_at_end),
            journal_head=journal_head,
            namespace=namespace,
        )
    )


def _identification(history: History) -> list[tuple[str, str]]:
    started, camera = history.started, history.devices.get("camera", {})
    place: Any = history.ledger
    return [
        ("Sequence", value_text(started.get("sequence"))),
        ("Station", value_text(started.get("station"))),
        ("Operator", value_text(started.get("operator"))),
        ("Camera", value_text(camera.get("serial"))),
        ("Begun", moment(history.started_utc)),
        ("Number of the run", value_text(place.get("number"))),
        ("Times resumed", number(history.resumed)),
    ]


def _row(attempt: Attempt) -> RecordedRow:
    checked, facts = attempt.checked, attempt.stored["facts"]
    verdict, label = ("marginal", "not measured") if checked is None else ("fail", "refused")
    if attempt.accepted:
        verdict, label = "pass", "accepted"
    return RecordedRow(
        attempt.pose_name or str(attempt.pose_index),
        attempt.attempt,
        verdict,
        label,
        NOTHING if checked is None else number(checked["stars"]),
        number(facts.get("events")),
        NOTHING
        if checked is None or not checked["reasons"]
        else "; ".join(why.removesuffix(".") for why in checked["reasons"]),
        attempt.stored["capture"],
    )
