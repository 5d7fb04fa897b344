"""The command line, `starbench`: arguments, options and exit statuses. Other modules do the work.

With ``--json`` a command prints one object to standard output and everything else to standard error. Exit status: 0
done, 1 failed, 2 invalid argument or file, 3 stopped on request (`bench.commands.output`), 130 ended by Ctrl-C.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench import __version__
from bench.commands.align_command import align
from bench.commands.batch_commands import BATCH_COMMANDS, BEGIN
from bench.commands.calibrate_command import calibrate, keep_answer_of_run
from bench.commands.certificate_commands import CERTIFICATE_COMMANDS
from bench.commands.compare_command import compare
from bench.commands.completion import add_completion
from bench.commands.convert_command import convert
from bench.commands.engine_commands import ENGINE_COMMANDS
from bench.commands.help_text import Sections, complete
from bench.commands.keys_commands import keys
from bench.commands.ledger_commands import LEDGER_COMMANDS
from bench.commands.options import JSON, RUN, SEED, NewFile, OutputFolder
from bench.commands.panel_command import panel
from bench.commands.recalibrate_command import recalibrate
from bench.commands.run_commands import RUN_COMMANDS
from bench.commands.target_commands import TARGET_COMMANDS
from bench.commands.verify_command import verify

if TYPE_CHECKING:
    from bench.run.runner import RunEnd

_SET = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="PATH=VALUE",
    help="Replace a value of the sequence or station file, e.g. station.camera.biases.bias_diff_on=20. Can be given"
    " several times.",
)


@click.group(cls=Sections, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="starbench")
@click.option("--debug", is_flag=True, help="On an error, print the traceback too.")
def cli(debug: bool) -> None:
    """Calibrate event cameras on a collimator bench without an operator, and write a report that anyone can verify.

    To begin: starbench run three_pose --station simulated

    Each command has its own help with an example: starbench run --help
    """


@cli.command()
@click.argument("sequence")
@click.option(
    "--station",
    "-s",
    required=True,
    help="Station file, or the name of a station that is included (simulated).",
)
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="New folder for the run.  [default: a folder in runs/, named by date and sequence]",
)
@click.option("--seed", type=SEED, metavar="N", help="Random seed of the simulated bench.")
@click.option("--operator", metavar="NAME", help="Name of the operator; printed in the report.")
@_SET
@JSON
def run(
    sequence: str,
    station: str,
    output: Path | None,
    seed: int | None,
    operator: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Run a SEQUENCE on a station and write a sealed report.

    SEQUENCE is a file, or the name of a sequence that is included (three_pose, nine_pose, turntable, until_good,
    parallax_test, boards).

    The first Ctrl-C stops the run safely: it stops the stage, switches the light off and closes the files. The third
    Ctrl-C ends the process at once.
    """
    from bench.base.clock import BenchClock
    from bench.commands.evidence_output import ask_passphrase
    from bench.run.launch import Launch, start_run

    launch = Launch(BenchClock(), ask_passphrase=ask_passphrase)
    end = start_run(
        sequence,
        station,
        output=output,
        seed=seed,
        operator=operator,
        launch=launch,
        settings=_settings(settings),
    )
    return _shown(end, as_json=as_json)


@cli.command()
@RUN
@click.option("--dry-run", is_flag=True, help="Only print what would be done.")
@click.option(
    "--secrets-revoked",
    is_flag=True,
    help="Seal a finished run though secrets were found in it: you have made them worthless.",
)
@JSON
def resume(run_folder: Path, dry_run: bool, secrets_revoked: bool, as_json: bool) -> int:
    """Continue a RUN that was stopped, failed or was interrupted. It first prints what it will do."""
    from bench.base.clock import BenchClock
    from bench.commands.evidence_output import ask_passphrase
    from bench.commands.run_output import show_intentions
    from bench.run.launch import Launch, read_intentions, resume_run

    if dry_run:
        return show_intentions(read_intentions(run_folder), as_json=as_json)
    launch = Launch(BenchClock(), ask_passphrase=ask_passphrase, secrets_revoked=secrets_revoked)
    return _shown(resume_run(run_folder, launch), as_json=as_json)


def _shown(end: RunEnd, *, as_json: bool) -> int:
    """Print how a run ended, then keep what `calibrate` will say about it. No signal changes the exit status now."""
    from bench.commands.calibration_output import show_run
    from bench.terminal.signals import stop_on_signals

    status = show_run(end, as_json=as_json)
    if end.how == "finished" and end.outcome is not None:
        with suppress(KeyboardInterrupt), stop_on_signals(lambda _reason: None):
            keep_answer_of_run(end.folder)
    return status


@cli.command()
@click.argument("sequence")
@click.option(
    "--station", "-s", help="Station file, or the name of a station that is included; not with a queue."
)
@click.option(
    "--suggest",
    type=click.IntRange(0, 50),
    metavar="N",
    default=0,
    help="Suggest N further poses that lower the uncertainty most.",
)
@BEGIN
@_SET
@JSON
def plan(
    sequence: str,
    station: str | None,
    suggest: int,
    begin: datetime | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Check a SEQUENCE on a station, or a queue file. No device is used.

    For a sequence, it shows all faults of both files, the steps, the time, the disk space and the expected uncertainty.
    For a queue, it shows when each run will begin and end, and which runs do not fit into the night.
    """
    from bench.batch.batch_plan import is_queue
    from bench.plan.plan import load_documents, make_plan

    if is_queue(sequence):
        from bench.commands.batch_output import refuse_extra, show_night

        refuse_extra(Path(sequence), station, suggest)
        return show_night(Path(sequence), begin=begin, as_json=as_json)
    if station is None:
        raise click.UsageError("Missing option '--station' / '-s'.")
    planned = make_plan(*load_documents(sequence, station, _settings(settings)))
    from bench.commands.plan_output import show_plan

    return show_plan(planned, suggest=suggest, as_json=as_json)


@cli.command()
@click.option(
    "--station", "-s", default="simulated", show_default=True, help="Station whose devices to simulate."
)
@click.option(
    "--seed", type=SEED, metavar="N", default=1, show_default=True, help="Random seed of the simulated bench."
)
def simulate(station: str, seed: int) -> int:
    """Keep a simulated bench running in its own process, and print its ports.

    Write a line to standard input to simulate a fault, e.g. pan stall share=0.3 (docs/simulated-bench.md lists all).
    """
    from bench.commands.bench_output import serve_simulated_bench

    return serve_simulated_bench(station, seed)


@cli.command()
@click.option(
    "--wiring",
    is_flag=True,
    help="Test the cable from the light to the camera's trigger input: the light flickers.",
)
@click.option("--station", "-s", help="Station for --wiring.")
@click.option("--yes", is_flag=True, help="With --wiring: switch the light on without asking.")
@click.option("--seed", type=SEED, metavar="N", default=1, hidden=True)
@JSON
def devices(as_json: bool, wiring: bool, station: str | None, yes: bool, seed: int) -> int:
    """List connected devices, their names for a station file, and missing software.

    Sends nothing to stages and lights. The camera makers' software asks each camera for its name.

    With --wiring and --station: asks, switches the light on for 2 s at 20 Hz, and compares trigger edges with events.
    Names a trigger cable that is missing, inverted, on the wrong channel, or of the wrong level. Nothing moves.
    """
    if wiring:
        from bench.commands.wiring_output import show_wiring

        if station is None:
            raise click.UsageError("Missing option '--station' / '-s', which --wiring needs.")
        return show_wiring(station, seed, yes=yes, as_json=as_json)
    from bench.commands.bench_output import show_devices
    from bench.stations.discovery import discover

    return show_devices(discover(), as_json=as_json)


@cli.group()
def station() -> None:
    """Create station files."""


@station.command("new")
@click.argument("path", type=NewFile())
@click.option("--name", default="My bench", show_default=True, help="Name of the bench.")
@click.option(
    "--stage",
    type=click.Choice(["zaber_ascii", "ximc", "grbl", "esp30x", "thorlabs_apt", "dynamixel", "text"]),
    default="zaber_ascii",
    show_default=True,
    help="Kind of stage.",
)
@click.option(
    "--light",
    type=click.Choice(["scpi", "gardasoft", "text"]),
    default="scpi",
    show_default=True,
    help="Kind of light: a function generator, or a strobe controller.",
)
@click.option(
    "--camera",
    type=click.Choice(["metavision", "neuromorphic_evk4", "opencv", "recorded", "pictures"]),
    help="Kind of camera.  [default: the connected one]",
)
def station_new(path: Path, name: str, stage: str, light: str, camera: str | None) -> int:
    """Create a station file at PATH, filled in with the connected devices."""
    from bench.commands.bench_output import write_station
    from bench.stations.discovery import discover

    return write_station(path, name, stage=stage, light=light, camera=camera, found=discover())


@cli.command()
@click.argument("document", type=click.Choice(["sequence", "station", "queue", "job", "lab"]))
def schema(document: str) -> int:
    """Print the JSON Schema of sequence, station, queue, job or lab files, for use by text editors."""
    from bench.commands.bench_output import print_schema

    return print_schema(document)


for engine_command in ENGINE_COMMANDS:
    cli.add_command(engine_command)
for run_command in (*RUN_COMMANDS, *BATCH_COMMANDS, *LEDGER_COMMANDS, *CERTIFICATE_COMMANDS):
    cli.add_command(run_command)
cli.add_command(align)
cli.add_command(keys)
cli.add_command(panel)
cli.add_command(recalibrate)
cli.add_command(convert)
cli.add_command(calibrate)
cli.add_command(compare)
cli.add_command(verify)
for target_command in TARGET_COMMANDS:
    cli.add_command(target_command)
complete(cli)
add_completion(cli)


def _settings(texts: tuple[str, ...]) -> Mapping[str, str]:
    """Split PATH=VALUE arguments."""
    from sequences.settings import OptionSettings

    for text in texts:
        if "=" not in text:
            raise click.BadParameter(f"{text!r} does not have the form PATH=VALUE.", param_hint="--set")
    pairs = (text.partition("=") for text in texts)
    return OptionSettings({path.strip(): value for path, _, value in pairs}, "--set")


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit. Every expected error is printed as one message, without a traceback.

    arguments: Arguments after the program's name; those of the process where None.
    """
    # Our matrices are small: several threads take three times as long as one. Must be set before numpy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from bench.base.kernel_cache import remove_stale_kernels, set_kernel_cache
    from bench.terminal.closed_output import outlive_readers
    from bench.terminal.encoding import replace_unencodable

    outlive_readers()
    set_kernel_cache(os.environ)
    remove_stale_kernels()
    replace_unencodable(sys.stdout, sys.stderr)
    args = sys.argv[1:] if arguments is None else arguments
    sys.exit(_exit_status(lambda: cli.main(args=args, prog_name="starbench", standalone_mode=False), args))


def _exit_status(command: Callable[[], Any], arguments: list[str]) -> int:
    """Run a command; print its error, if it raises one, and return the exit status."""
    try:
        status = command()
    except click.exceptions.Abort:
        click.echo("Stopped.", err=True)
        return 128 + 2
    except click.ClickException as error:
        from bench.commands.output import print_json

        if "--json" in arguments:
            print_json({"error": {"kind": "UsageError", "message": error.format_message(), "remedy": ""}})
        from bench.terminal.encoding import printable

        error.message = printable(error.message)  # type: ignore[misc]
        error.show()
        return error.exit_code
    except KeyboardInterrupt:
        click.echo("Stopped.", err=True)
        return 128 + 2
    except Exception as error:  # noqa: BLE001 - the last place that can print any error in plain words
        from bench.commands.output import print_error

        return print_error(error, as_json="--json" in arguments, debug="--debug" in arguments)
    return int(status or 0)
