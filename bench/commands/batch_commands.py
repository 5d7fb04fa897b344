"""Commands about batches: begin or continue one, add and withdraw jobs, write a summary, rehearse a night.

Arguments, options and exit statuses only, like `bench.commands.cli`; other modules do the work.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import click

from bench.commands.options import JSON, ExistingFile, ExistingFolder, OutputFolder

_BY = click.option("--operator", "by", metavar="NAME", help="Your name.  [default: user@host]")
_FOLDER = click.argument("folder", metavar="FOLDER", type=ExistingFolder())
_QUEUE = click.argument("queue", metavar="QUEUE", type=ExistingFile())
_OUTPUT = click.option(
    "--output",
    "-o",
    required=True,
    type=OutputFolder(),
    help="Folder of the batch. If the batch has begun there, it continues.",
)
BEGIN = click.option(
    "--begin",
    type=click.DateTime(["%Y-%m-%dT%H:%M", "%Y-%m-%d %H:%M"]),
    metavar="DATETHH:MM",
    help="Time at which the night begins, in the time zone of the queue.  [default: now]",
)


class _OfGroup(click.Context):
    """Context of a command whose usage shows the name of its group, because people call it by that name."""

    @property
    def command_path(self) -> str:
        """Name of the group."""
        assert self.parent is not None
        return self.parent.command_path


class _Run(click.Command):
    """The command behind ``batch QUEUE``."""

    context_class = _OfGroup


class _OrQueue(click.Group):
    """A group whose first argument may also be a queue file, which is then run."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put ``run`` before a first argument that is neither a command nor a request for help."""
        if args and args[0] not in {*self.commands, "--help", "-h"}:
            args = ["run", *args]
        return super().parse_args(ctx, args)


@click.group(cls=_OrQueue, subcommand_metavar="QUEUE -o FOLDER | COMMAND ...")
def batch() -> None:
    """Do the runs of a QUEUE file one after another, each under supervision.

    Called again with the same folder, it continues where it was interrupted.

    While it runs: `starbench status FOLDER`, `batch add`, `batch withdraw`.
    """


@batch.command("run", cls=_Run, hidden=True)
@_QUEUE
@_OUTPUT
@JSON
def run(queue: Path, output: Path, as_json: bool) -> int:
    """Do the runs of a QUEUE file one after another, each under supervision.

    Called again with the same folder, it continues where it was interrupted.
    """
    from bench.commands.batch_output import do_batch

    return do_batch(queue, output, as_json=as_json)


@batch.command()
@_FOLDER
@click.argument("job", type=ExistingFile())
@_BY
@JSON
def add(folder: Path, job: Path, by: str | None, as_json: bool) -> int:
    """Add a JOB (a file) to the batch in FOLDER; also possible while the batch runs."""
    from bench.commands.batch_output import ask_batch

    return ask_batch(folder, job=job, name=None, by=by, as_json=as_json)


@batch.command()
@_FOLDER
@click.argument("name")
@_BY
@JSON
def withdraw(folder: Path, name: str, by: str | None, as_json: bool) -> int:
    """Withdraw the job NAME from the batch in FOLDER: no further run of it is begun."""
    from bench.commands.batch_output import ask_batch

    return ask_batch(folder, job=None, name=name, by=by, as_json=as_json)


@batch.command()
@_FOLDER
@JSON
def summary(folder: Path, as_json: bool) -> int:
    """Write the current summary of the batch in FOLDER."""
    from bench.commands.batch_output import summarise_again

    return summarise_again(folder, as_json=as_json)


@click.command()
@_QUEUE
@click.option("--output", "-o", required=True, type=OutputFolder(), help="New folder for the rehearsal.")
@BEGIN
@click.option(
    "--seed",
    type=click.IntRange(0, 2**62),
    metavar="N",
    default=1,
    show_default=True,
    help="Random seed of the rehearsed devices.",
)
@click.option("--quiet", is_flag=True, help="Print only the summary.")
@JSON
def rehearse(queue: Path, output: Path, begin: datetime | None, seed: int, quiet: bool, as_json: bool) -> int:
    """Rehearse the night of a QUEUE file on a virtual clock, without devices and without waiting.

    The journals and the summary have the same form as those of a real night.
    """
    from bench.commands.batch_output import do_rehearsal

    return do_rehearsal(queue, output, begin=begin, seed=seed, quiet=quiet, as_json=as_json)


BATCH_COMMANDS = (batch, rehearse)
