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

    text, name = " ".join(reason.split()), " ".join((by or "").split())
    if not 3 <= len(text) <= _LONGEST_REASON:
        raise UsageError(
            f"--reason has {len(text)} characters.",
            remedy=f"State in one or two sentences what happened, in 3 to {_LONGEST_REASON} characters.",
        )
    return explain_breaks(text, by=name[:200] or None, as_json=as_json)


LEDGER_COMMANDS = (ledger,)
