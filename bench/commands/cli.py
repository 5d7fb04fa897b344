"""The command line: `starbench`. Knows words and exits; the work stands in the modules it calls.

With ``--json`` a command prints one object on standard output and everything else on standard error. Exit status:
0 done, 1 failed, 2 a wrong word or file, 3 stopped on request (`bench.commands.output`).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from bench import __version__
from bench.commands.batch_commands import BATCH_COMMANDS, BEGIN
from bench.commands.engine_commands import ENGINE_COMMANDS
from bench.commands.help_text import Sections, complete
from bench.commands.options import JSON, RUN, SEED, ExistingFile, NewFile, OutputFolder, RunFolder
from bench.commands.run_commands import RUN_COMMANDS

_SET = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="PATH=VALUE",
    help="Set something otherwise than the files say: station.camera.biases.bias_diff_on=20. As often as needed.",
)


@click.group(cls=Sections, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="starbench")
@click.option("--debug", is_flag=True, help="On an error, show where in the program it arose.")
def cli(debug: bool) -> None:
    """Calibrate event cameras on a collimator bench, unattended, and prove what was done.

    Begin with: starbench run three_pose --station simulated

    Each command has its own help, with an example: starbench run --help
    """


@cli.command()
@click.argument("sequence")
@click.option(
    "--station", "-s", required=True, help="Station file, or the name of a shipped one (simulated)."
)
@click.option(
    "--output",
    "-o",
    type=OutputFolder(),
    help="New folder for the run; by default one in runs/, by date and name.",
)
@click.option("--seed", type=SEED, metavar="N", help="Seed of a simulated bench.")
@click.option("--operator", metavar="NAME", help="Who runs it; printed in the report.")
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
    """Run a SEQUENCE on a station, up to the sealed report.

    SEQUENCE is a file, or the name of a shipped one (three_pose, nine_pose, turntable).

    Ctrl-C stops it safely: stage stopped, light off, files closed. The third one ends the process at once.
    """
    from bench.base.clock import BenchClock
    from bench.commands.calibration_output import show_run
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
    return show_run(end, as_json=as_json)


@cli.command()
@RUN
@click.option("--dry-run", is_flag=True, help="Only say what would be done.")
@JSON
def resume(run_folder: Path, dry_run: bool, as_json: bool) -> int:
    """Go on with a RUN that was stopped, failed, killed or cut off; first say what will be done."""
    from bench.base.clock import BenchClock
    from bench.commands.calibration_output import show_run
    from bench.commands.evidence_output import ask_passphrase
    from bench.commands.run_output import show_intentions
    from bench.run.launch import Launch, read_intentions, resume_run

    if dry_run:
        return show_intentions(read_intentions(run_folder), as_json=as_json)
    launch = Launch(BenchClock(), ask_passphrase=ask_passphrase)
    return show_run(resume_run(run_folder, launch), as_json=as_json)


@cli.command()
@click.argument("sequence")
@click.option("--station", "-s", help="Station file, or the name of a shipped one; not with a queue.")
@click.option(
    "--suggest", type=click.IntRange(0, 50), metavar="N", default=0, help="Suggest so many further poses."
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
    """Check a SEQUENCE against a station, or a queue file, without touching anything.

    Shows every fault of both files, the poses, the time and disk a run will take, and what its poses will be worth.
    Of a queue: when each run will begin and end, and what there will be no time for.
    """
    from bench.batch.batch_plan import is_queue
    from bench.commands.plan_output import show_plan
    from bench.plan.plan import load_documents, make_plan

    if is_queue(sequence):
        from bench.commands.batch_output import refuse_extra, show_night

        refuse_extra(Path(sequence), station, suggest)
        return show_night(Path(sequence), begin=begin, as_json=as_json)
    if station is None:
        raise click.UsageError("Missing option '--station' / '-s'.")
    planned = make_plan(*load_documents(sequence, station, _settings(settings)))
    return show_plan(planned, suggest=suggest, as_json=as_json)


@cli.command()
@click.argument("run_folder", metavar="RUN", type=RunFolder(journal=False))
@click.option("--allowed-signers", type=ExistingFile(), help="Trusted keys; by default this bench's own.")
@click.option("--serial", help="Serial number the calibrated camera must have.")
@click.option("--again", is_flag=True, help="Also calibrate again from the recordings, and compare.")
@JSON
def verify(
    run_folder: Path, allowed_signers: Path | None, serial: str | None, again: bool, as_json: bool
) -> int:
    """Check the seal of a RUN: signature, every file, the journal, the printed numbers."""
    from bench.base.home import home_folder
    from bench.commands.evidence_output import show_verification
    from bench.evidence.keys import SIGNERS_FILE, read_signers
    from bench.evidence.verify import verify_run

    signers = read_signers(allowed_signers or home_folder() / SIGNERS_FILE)
    recalculate: Callable[[Path], Sequence[str]] | None = None
    if again:
        from bench.results.reproduce import differences

        recalculate = differences
    found = verify_run(run_folder, signers, camera_serial=serial, recalculate=recalculate)
    return show_verification(found, as_json=as_json)


@cli.command()
@click.option(
    "--station", "-s", default="simulated", show_default=True, help="Station whose devices to simulate."
)
@click.option("--seed", type=SEED, metavar="N", default=1, show_default=True, help="Of its chance.")
def simulate(station: str, seed: int) -> int:
    """Keep a simulated bench running in a process of its own, and print its ports.

    A line on standard input orders a fault, as docs/simulated-bench.md lists them: pan stall share=0.3
    """
    from bench.commands.bench_output import serve_simulated_bench

    return serve_simulated_bench(station, seed)


@cli.command()
@JSON
def devices(as_json: bool) -> int:
    """List what is connected, what a station file calls it, and what is missing. Sends nothing to any device."""
    from bench.commands.bench_output import show_devices
    from bench.stations.discovery import discover

    return show_devices(discover(), as_json=as_json)


@cli.group()
def station() -> None:
    """Write station files."""


@station.command("new")
@click.argument("path", type=NewFile())
@click.option("--name", default="My bench", show_default=True, help="Name of the bench.")
@click.option(
    "--stage",
    type=click.Choice(["zaber_ascii", "ximc", "grbl", "esp30x"]),
    default="zaber_ascii",
    show_default=True,
    help="Family of the stage.",
)
@click.option(
    "--camera",
    type=click.Choice(["metavision", "neuromorphic_evk4", "opencv", "recorded", "pictures"]),
    help="Family of the camera.  [default: what is connected]",
)
def station_new(path: Path, name: str, stage: str, camera: str | None) -> int:
    """Write a new station file to PATH, with what is connected filled in."""
    from bench.commands.bench_output import write_station
    from bench.stations.discovery import discover

    return write_station(path, name, stage, camera, discover())


@cli.group(invoke_without_command=True)
@click.pass_context
def keys(context: click.Context) -> None:
    """Show (without a further word), make and trust signing keys."""
    if context.invoked_subcommand is None:
        context.invoke(keys_show)


@keys.command("show")
def keys_show() -> int:
    """Show this bench's key, the line to give to others, and the keys it trusts."""
    from bench.commands.evidence_output import show_keys

    return show_keys()


@keys.command("create")
@click.option("--principal", help="Who signs, as name@place; by default bench@ and the machine's name.")
@click.option("--passphrase", is_flag=True, help="Protect the key; asked for whenever it signs.")
def keys_create(principal: str | None, passphrase: bool) -> int:
    """Make this bench's key."""
    from bench.commands.evidence_output import make_key

    return make_key(principal, protect=passphrase)


@keys.command("trust")
@click.argument("line")
def keys_trust(line: str) -> int:
    """Trust another bench's key: LINE as its `keys show` prints it."""
    from bench.commands.evidence_output import trust_key

    return trust_key(line)


@cli.command()
@click.argument("document", type=click.Choice(["sequence", "station", "queue", "job"]))
def schema(document: str) -> int:
    """Print the JSON Schema of sequence, station or queue files, for editors."""
    from bench.commands.bench_output import print_schema

    return print_schema(document)


for engine_command in ENGINE_COMMANDS:
    cli.add_command(engine_command)
for run_command in (*RUN_COMMANDS, *BATCH_COMMANDS):
    cli.add_command(run_command)
complete(cli)


def _settings(words: tuple[str, ...]) -> dict[str, str]:
    """Take PATH=VALUE words apart."""
    for word in words:
        if "=" not in word:
            raise click.BadParameter(f"{word!r} is not PATH=VALUE.", param_hint="--set")
    return {path.strip(): value for path, _, value in (word.partition("=") for word in words)}


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit; every foreseen error is one message, never a traceback."""
    # Our matrices are small: more threads than one cost three times the time. Before numpy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from bench.base.kernel_cache import set_kernel_cache
    from bench.terminal.encoding import replace_unencodable

    set_kernel_cache(os.environ)
    replace_unencodable(sys.stdout, sys.stderr)
    words = sys.argv[1:] if arguments is None else arguments
    sys.exit(_guarded(lambda: cli.main(args=words, prog_name="starbench", standalone_mode=False), words))


def _guarded(command: Callable[[], Any], words: list[str]) -> int:
    try:
        status = command()
    except click.exceptions.Abort:
        click.echo("Stopped.", err=True)
        return 128 + 2
    except click.ClickException as error:
        from bench.commands.output import print_json

        if "--json" in words:
            print_json({"error": {"kind": "UsageError", "message": error.format_message(), "remedy": ""}})
        error.show()
        return error.exit_code
    except KeyboardInterrupt:
        click.echo("Stopped.", err=True)
        return 128 + 2
    except (
        BrokenPipeError
    ):  # whoever read it has read enough (| head): nothing to tell, and nobody to tell it to
        os.dup2(
            os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
        )  # else the interpreter fails at its flush
        return 1
    except Exception as error:  # noqa: BLE001 - the last place where an error can be told in plain words
        from bench.commands.output import tell_error

        return tell_error(error, as_json="--json" in words, debug="--debug" in words)
    return int(status or 0)
