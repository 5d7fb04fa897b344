"""The command `convert`: arguments, options and exit statuses; drivers and `bench.cluster` do the work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands.options import EventFile, NewFile, OutputFolder, epilog
from bench.commands.workers import CONTINUES, WORKERS, CountLine, open_workers

if TYPE_CHECKING:
    from bench.cluster.verifications import Converted
    from bench.cluster.work import Workers


@click.command(
    epilog=epilog(
        "starbench convert pose-001-attempt-1.raw pose.hdf5",
        "starbench convert pose.hdf5 pose.raw",
        "starbench convert captures/*.raw converted/ --as hdf5",
    )
)
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, type=EventFile())
@click.argument("output", type=click.Path(path_type=Path))
@click.option(
    "--as",
    "kind",
    type=click.Choice(["raw", "metavision", "hdf5", "numpy"]),
    help="Format of OUTPUT.  [default: by its name: .raw, .hdf5 (Metavision, ECF), .h5 (plain HDF5) or .npz]",
)
@WORKERS
def convert(
    sources: tuple[Path, ...],
    output: Path,
    kind: str | None,
    workers: int | str | None,
) -> int:
    """Convert an event file SOURCE to a new file OUTPUT of another format. The format of SOURCE is detected.

    Many SOURCEs are converted into the folder OUTPUT, by all processors of this computer or by the workers of a Dask
    scheduler; say the format with --as. After an interruption, the same command continues.

    Formats: RAW (EVT3), Metavision's HDF5 (ECF), plain HDF5, NumPy's .npz. SOURCE may also be RAW with EVT2 words,
    DAT, AEDAT4, or a bag of ROS 1 or ROS 2 (file or folder); AEDAT4 and bags need starbench[formats]. The header of
    a converted RAW file states that it was converted, so it cannot be taken for a camera's original file.
    """
    from bench.base.errors import UsageError
    from drivers.camera.formats import event_conversion

    many = len(sources) > 1 or output.is_dir() or isinstance(workers, str)
    kind = kind or (None if many else event_conversion.kind_of_name(output))
    if kind is None:
        what = "The format of the new files is not given." if many else (
            "The name of the output file does not show its format."
        )  # fmt: skip
        raise UsageError(
            what,
            where=str(output),
            remedy="Give --as."
            if many
            else "Use a name that ends in .raw, .hdf5, .h5 or .npz, or give --as.",
        )
    if many:
        OutputFolder().check(output)
        return _convert_many(sources, output, kind, open_workers(workers, most=len(sources)))
    NewFile().check(output)
    return _convert_one(sources[0], output, kind)


def _convert_one(source: Path, output: Path, kind: str) -> int:
    from dataclasses import asdict

    from bench.terminal.signals import reliable_interrupts
    from drivers.camera.formats import event_conversion

    with reliable_interrupts():
        written = event_conversion.convert(
            source,
            output,
            kind,  # type: ignore[arg-type]
            utc_now=lambda: datetime.now(UTC),
        )
    click.echo(_text(output, asdict(written)))
    _say_if_cut_off(source, asdict(written))
    return 0


def _text(output: Path, written: Mapping[str, Any]) -> str:
    moved = written["moved_events"]
    late = f", {moved} given the time of the event before" if moved else ""
    return f"{output}: {written['events']} events{late}, {written['triggers']} triggers"


def _say_if_cut_off(source: Path, written: Mapping[str, Any]) -> None:
    if written["cut_off"]:
        click.echo(
            f"{source}: the file ends in the middle of a word; everything before it was converted.", err=True
        )


def _convert_many(sources: Sequence[Path], folder: Path, kind: str, workers: Workers) -> int:
    """Convert into a folder; return the exit status: 0 all done, 1 a file failed."""
    from contextlib import ExitStack

    from bench.cluster.verifications import CONVERTED, convert_many, plan_targets
    from bench.cluster.work import KeptRows
    from bench.terminal.encoding import printable
    from bench.terminal.signals import reliable_interrupts

    pairs = plan_targets(sources, folder, kind)
    line = CountLine(len(pairs), "files")
    ends: list[Converted] = []

    def ended(one: Converted) -> None:
        ends.append(one)
        line.clear()
        if one.failure is not None:
            click.echo(printable(f"{one.source}: FAILED. {one.failure.message}"), err=True)
        elif one.before:
            click.echo(f"{one.target}: was converted before")
        elif one.summary is not None:
            click.echo(_text(one.target, one.summary))
            _say_if_cut_off(one.source, one.summary)
        line.count()

    with reliable_interrupts(), ExitStack() as stack:
        stack.callback(workers.close)
        kept = stack.enter_context(KeptRows(folder, CONVERTED))
        try:
            convert_many(pairs, kind, workers, kept, ended)
        except BaseException:
            line.clear()
            click.echo(f"{line.text()} converted. {CONTINUES}", err=True)
            raise
    line.clear()
    failed = sum(one.failure is not None for one in ends)
    before = sum(one.before for one in ends)
    parts = [f"{len(ends) - failed - before} of {len(pairs)} files converted"]
    parts += [f"{before} were converted before"] if before else []
    parts += [f"{failed} FAILED"] if failed else []
    click.echo(f"{'; '.join(parts)}.")
    return 1 if failed else 0
