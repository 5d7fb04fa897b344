"""The command `messages`: what this bench has sent and what still waits."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from bench.base.clock import BenchClock
from bench.base.home import home_folder
from bench.commands.options import epilog, status_text
from bench.commands.output import JSON, show

if TYPE_CHECKING:
    from bench.messaging.outbox import Delivery


@click.command(
    epilog=epilog(
        "starbench messages",
        "starbench messages --send",
        status=status_text("0 messages shown, 1 a message is still waiting after --send{invalid}{ctrl_c}"),
    )
)
@click.option("--send", "send_now", is_flag=True, help="Try to send the waiting messages now.")
@JSON
def messages(send_now: bool) -> int:
    """List the messages of this bench: sent ones and waiting ones."""
    from bench.messaging.messages import send
    from bench.messaging.outbox import Outbox

    outbox = Outbox(home_folder())
    waiting = outbox.deliver(send, BenchClock().utc_now(), all_waiting=True) if send_now else 0
    found = outbox.deliveries()
    show(
        {"schema": "starbench/messages/1", "messages": [asdict(delivery) for delivery in found]},
        _lines(found),
    )
    return 1 if waiting else 0


def _lines(found: Sequence[Delivery]) -> Iterator[str]:
    for delivery in found:
        marks = f", {delivery.tries} tries" if delivery.tries > 1 else ""
        marks += ", perhaps sent twice" if delivery.perhaps_twice else ""
        marks += f"; {delivery.last_error}" if delivery.last_error else ""
        kind = next(iter(json.loads(delivery.channel)))
        written, subject = delivery.message.utc[:16].replace("T", " "), delivery.message.subject
        yield f"{written}  {kind:<7} {delivery.state:<7}  {subject}{marks}"
    if not found:
        yield "No messages."
