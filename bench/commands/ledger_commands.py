"""Commands about the ledger of the bench: check it, and explain a break of it.

Arguments, options and exit statuses only, like `bench.commands.cli`; other modules do the work.
"""

from __future__ import annotations

import click

from bench.base.errors import UsageError
from bench.commands.options import JSON

_LONGEST_REASON = 2000


@click.group()
def ledger() -> None:
    """Check the ledger of this bench, and explain a break of it."""


@ledger.command("check")
@JSON
def ledger_check(as_json: bool) -> int:
    """Compare the ledger with its second places and with the sealed runs of this bench."""
    from bench.commands.ledger_output import show_check

    return show_check(as_json=as_json)


@ledger.command("explain")
@click.option("--reason", required=True, metavar="TEXT", help="What happened to the ledger.")
@click.option("--operator", "by", metavar="NAME", help="Your name.  [default: user@host]")
@JSON
def ledger_explain(reason: str, by: str | None, as_json: bool) -> int:
    """State why the ledger was broken. The reason is added to the ledger; nothing is rewritten."""
    from bench.commands.ledger_output import explain_breaks

    return explain_breaks(_reason(reason), by=_name(by), as_json=as_json)


@ledger.command("forget-place")
@click.argument("place")
@click.option("--reason", required=True, metavar="TEXT", help="Why the place is not used any more.")
@click.option("--operator", "by", metavar="NAME", help="Your name.  [default: user@host]")
def ledger_forget_place(place: str, reason: str, by: str | None) -> int:
    """Write the ledger to the second PLACE no longer, for example to a share that was taken away."""
    from bench.commands.ledger_output import forget_place

    return forget_place(place, _reason(reason), by=_name(by))


def _name(by: str | None) -> str | None:
    return " ".join((by or "").split())[:200] or None


def _reason(reason: str) -> str:
    """Return a reason as one line. Raises UsageError if it is too short or too long."""
    text = " ".join(reason.split())
    if not 3 <= len(text) <= _LONGEST_REASON:
        raise UsageError(
            f"--reason has {len(text)} characters.",
            remedy=f"State in one or two sentences what happened, in 3 to {_LONGEST_REASON} characters.",
        )
    return text


LEDGER_COMMANDS = (ledger,)
