"""The command `convert`: event files in the formats of other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.errors import UsageError
from bench.commands.options import AnyPath, EventFile, NewFile, OutputFolder, command
from bench.commands.output import print_line
from bench.commands.workers import WORKERS, CountLine, kept_work, open_workers

if TYPE_CHECKING:
    from bench.extras.tools.conversions import Converted
    from bench.work.workers import Workers
    from drivers.camera.event_arrays import ReadingChoices, TimeUnit
    from drivers.camera.formats.event_conversion import Kind

_ASSUMED = {
    "time_unit": "the file does not state the unit of its times; they were read as {}. --time-unit says another one.",
    "sensor_size": "its events fill only {} px of --sensor-size. Is the sensor as large as that?",
}


@command(
    "starbench convert pose-001-attempt-1.raw pose.hdf5",
    "starbench convert pose.hdf5 pose.raw",
    "starbench convert captures/*.raw converted/ --as hdf5",
)
@click.argument("sources", metavar="SOURCE...", nargs=-1, type=EventFile())
@click.argument("output", type=AnyPath())
@click.option(
    "--as",
    "kind",
    type=click.Choice(["raw", "metavision", "hdf5", "numpy", "parquet", "csv"]),
    help="Format of OUTPUT.  [default: by its name: .raw, .hdf5 (Metavision, ECF), .h5 (plain HDF5), .npz,"
    " .parquet or .csv]",
)
@click.option(
    "--sensor-size", metavar="WxH", help="Size of the sensor, px, for a SOURCE that does not state it."
)
@click.option(
    "--stream",
    "--topic",
    metavar="NAME",
    help="Which events of a SOURCE with several: topic of a bag, stream of AEDAT4, group of HDF5.",
)
@click.option(
    "--time-unit",
    type=click.Choice(["s", "ms", "us", "ns"]),
    help="Unit of the times of a SOURCE that does not state it.  [default: s if they have fractions, else us]",
)
@WORKERS
def convert(
    sources: tuple[Path, ...],
    output: Path,
    kind: Kind | None,
    sensor_size: str | None,
    stream: str | None,
    time_unit: TimeUnit | None,
    workers: int | str | None,
) -> int:
    """Convert an event file SOURCE to a new file OUTPUT of another format. The format of SOURCE is detected.

    Many SOURCEs are converted into the folder OUTPUT, by all processors of this computer or by the workers of a Dask
    scheduler; say the format with --as. After an interruption, the same command continues.

    Formats: RAW (EVT3), Metavision's HDF5 (ECF), plain HDF5, NumPy's .npz, Parquet (needs starbench[table]), and text
    (CSV, without triggers). SOURCE may also be RAW with EVT2 or EVT2.1 words, DAT; HDF5, .npz, .npy, Parquet or text
    with columns named t, x, y, p; AEDAT 4, or a bag of ROS 1 or ROS 2 (file or folder); AEDAT 4, bags and some HDF5
    need starbench[formats]. What a SOURCE does not state and was assumed is printed. The header of a converted RAW file
    states that it was converted, so it cannot be taken for a camera's original file.
    """
    from bench.base.image_size import parse_image_size
    from drivers.camera.event_arrays import ReadingChoices
    from drivers.camera.formats import event_conversion

    if not sources:
        raise click.UsageError(f"Two files are needed, SOURCE and OUTPUT; only {output} is given.")
    choices = ReadingChoices(parse_image_size(sensor_size, "--sensor-size"), stream, time_unit)
    many = len(sources) > 1 or output.is_dir() or isinstance(workers, str)
    kind = kind or (None if many else event_conversion.kind_of_name(output))
    if kind is None:
        endings = ", ".join(event_conversion.ENDINGS.values())
        remedy = "Give --as." if many else f"Use a name that ends in one of {endings}, or give --as."
        raise UsageError("The format of the output is not given.", where=str(output), remedy=remedy)
    if many:
        OutputFolder().check(output)
        return _convert_many(sources, output, kind, open_workers(workers, most=len(sources)), choices)
    NewFile().check(output)
    return _convert_one(sources[0], output, kind, choices)


def _convert_one(source: Path, output: Path, kind: Kind, choices: ReadingChoices) -> int:
    from drivers.camera.formats import event_conversion

    files = source.rglob("*") if source.is_dir() else [source]
    line = CountLine(sum(file.stat().st_size for file in files) // 1_000_000, "MB read")
    try:
        written = event_conversion.convert(source, output, kind, choices, progress=line.show_share)
    finally:
        line.clear()
    _say(source, output, asdict(written))
    return 0


def _say(source: Path, output: Path, written: Mapping[str, Any]) -> None:
    moved = written["moved_events"]
    late = f", {moved} given the time of the event before" if moved else ""
    span = f", {written['span_us'] / 1e6:g} s" if written.get("span_us") else ""
    print_line(f"{output}: {written['events']} events{late}, {written['triggers']} triggers{span}")
    for fact, assumed in written.get("assumed", {}).items():
        print_line(f"{source}: {_ASSUMED[fact].format(assumed)}", err=True)
    if written.get("unknown_words"):
        what = "words whose type EVT3 does not define were left out"
        print_line(f"{source}: {what}: {written['unknown_words']}.", err=True)
    if written.get("edges_left_out"):
        print_line(f"{source}: CSV holds no triggers; {written['edges_left_out']} were left out.", err=True)
    if written["cut_off"]:
        print_line(
            f"{source}: the file ends in the middle of a word or a line; everything before it was converted.",
            err=True,
        )


def _convert_many(
    sources: Sequence[Path], folder: Path, kind: Kind, workers: Workers, choices: ReadingChoices
) -> int:
    """Convert into a folder; return the exit status: 0 all done, 1 a file failed."""
    from bench.extras.tools.conversions import CONVERTED, convert_many, plan_targets

    pairs = plan_targets(sources, folder, kind)
    line = CountLine(len(pairs), "files")
    ends: list[Converted] = []

    def ended(conversion: Converted) -> None:
        ends.append(conversion)
        line.clear()
        if conversion.failure is not None:
            print_line(f"{conversion.source}: FAILED. {conversion.failure.message}", err=True)
        elif conversion.before:
            print_line(f"{conversion.target}: was converted before")
        elif conversion.summary is not None:
            _say(conversion.source, conversion.target, conversion.summary)
        line.count()

    with kept_work(workers, folder, CONVERTED, line, "converted") as kept:
        assert kept is not None
        convert_many(pairs, kind, workers, kept, ended, choices)
    failed = sum(end.failure is not None for end in ends)
    before = sum(end.before for end in ends)
    parts = [f"{len(ends) - failed - before} of {len(pairs)} files converted"]
    parts += [f"{before} were converted before"] if before else []
    parts += [f"{failed} FAILED"] if failed else []
    print_line(f"{'; '.join(parts)}.")
    return 1 if failed else 0
