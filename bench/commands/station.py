"""The commands `station new` and `schema`: a station file is drafted, and the form of each kind of file is printed."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.options import Family, NewFile, epilog
from bench.commands.output import print_json


@click.group(cls=Family, epilog=epilog("starbench station new my_bench.yaml"))
def station() -> None:
    """Create station files."""


@station.command(
    "new",
    epilog=epilog(
        "starbench station new my_bench.yaml --name 'Optics bench 2' --stage ximc --light gardasoft"
    ),
)
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
    from bench.records.storage import write_atomic
    from bench.stations.discovery import discover
    from bench.stations.placeholders import UNKNOWN_SERIAL
    from bench.stations.station_draft import draft_station

    draft = draft_station(name, discover(), stage=stage, light=light, camera=camera)
    write_atomic(path, draft.encode())
    click.echo(
        f"Written: {path}. Replace every placeholder (such as {UNKNOWN_SERIAL}), check scales and limits, then:"
        f" starbench plan three_pose -s {path}"
    )
    return 0


@click.command(epilog=epilog("starbench schema sequence > sequence.schema.json"))
@click.argument("document", type=click.Choice(["sequence", "station", "queue", "job", "lab"]))
def schema(document: str) -> int:
    """Print the JSON Schema of sequence, station, queue, job or lab files, for use by text editors."""
    from pydantic import BaseModel

    from bench.certificate.lab_config import LabConfig
    from bench.stations.station import Station
    from sequences.queue import JobFile, Queue
    from sequences.schema import Sequence

    models: dict[str, type[BaseModel]] = {
        "sequence": Sequence,
        "station": Station,
        "queue": Queue,
        "job": JobFile,
        "lab": LabConfig,
    }
    print_json(models[document].model_json_schema())
    return 0
