"""The command `compare`: methods of calibration on the simulated bench. `bench.compare` does the work."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.options import JSON
from bench.commands.worker_options import open_workers, worker_options


@click.command()
@click.argument("spec")
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the comparison. An interrupted one continues with the same folder.  [default: comparisons/NAME]",
)
@click.option(
    "--repetitions", type=click.IntRange(1, 1000), metavar="N", help="In place of that of the SPEC."
)
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), metavar="N", help="In place of that of the SPEC.")
@worker_options
@JSON
def compare(
    spec: str,
    output: Path | None,
    repetitions: int | None,
    seed: int | None,
    scheduler: str | None,
    workers: int | None,
    memory: int,
    as_json: bool,
) -> int:
    """Compare calibration methods on the simulated bench, where the truth is known.

    SPEC is a YAML file, or the name of an included specification: table1 (the paper's Table 1 again) or sweep (number
    of images, collimators, noise). Each repetition records new event images of a star target or a board, and every
    method gets the same images. What is done is kept: after Ctrl-C, the same command continues.
    """
    from bench.commands.compare_output import run_and_print
    from bench.compare.spec import read_spec

    read = read_spec(spec)
    given = {"repetitions": repetitions, "seed": seed}
    changed = read.value.model_copy(
        update={name: value for name, value in given.items() if value is not None}
    )
    folder = output or Path("comparisons") / Path(spec).stem
    who = open_workers(scheduler, workers, memory)
    return run_and_print(changed, read.text, folder, who, as_json=as_json)
