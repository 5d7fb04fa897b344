"""The commands `station`, `devices`, `schema`, `target` and `simulate`: what is connected, what a station says."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from bench.base.clock import Aborted, BenchClock, stop_on_signals
from bench.base.entry_points import SCHEMAS, entry_points, load
from bench.base.errors import BenchError, UsageError
from bench.base.pasteable import pasteable
from bench.commands.options import (
    SEED,
    STATION,
    STATION_NAME,
    Family,
    NewFile,
    command,
    epilog,
    status_text,
)
from bench.commands.output import JSON, STOPPED, print_json, print_line, show

if TYPE_CHECKING:
    from bench.run.wiring import WiringReport
    from bench.stations.discovery import Discovery
    from bench.stations.station_fields import TargetConfig
    from bench.stations.target_files import Optics, TargetUse


@command(
    "starbench target -s my_bench.yaml",
    "starbench target -s my_bench.yaml -o reticle.gds",
    "starbench target -s simulated -o target.pdf",
)
@STATION
@click.option(
    "--output",
    "-o",
    type=NewFile(),
    help="Draw the reticle into this new file instead; its name ends in .svg, .pdf, .dxf or .gds.",
)
@JSON
def target(station: str, output: Path | None) -> int:
    """Show what the target of a station is good for: stars in view, their size in px, the field, and warnings.

    With --output, draw the reticle that the section `target` of the station describes. What is filled in the drawing is
    opaque. SVG and PDF have exact millimetres. DXF and GDSII are for makers of reticles; they need: pip install
    'starbench[draw]'.
    """
    from bench.stations.station import load_station

    described = load_station(station).value
    if output is not None:
        return _draw(described.target, output)
    from bench.stations.target_files import optics_of, use_of

    optics = optics_of(described)
    use = use_of(described.target, optics)
    data = described.target.model_dump(mode="json") | {"size_mm": list(described.target.size_mm)}
    show(
        lambda: {"target": data, "optics": asdict(optics), **asdict(use)},
        _lines(described.target, optics, use),
    )
    return 0


def _lines(target: TargetConfig, optics: Optics, use: TargetUse) -> Iterator[str]:
    columns, rows = target.squares
    width, height = optics.image_size
    left, right, up, down = use.target_deg
    beam = "not known" if use.beam_deg is None else f"{use.beam_deg:.1f} degrees, full angle"
    lines = {
        "target": f"{columns} x {rows} squares of {target.pitch_mm:.6g} mm, {use.stars} stars of {target.segments}"
        f" segments, {target.polarity}",
        "tag": f"family {target.tag_family}, number {target.tag_id}, {use.tag_px:.0f} px wide",
        "optics": f"lens {optics.focal_px:.0f} px, collimator {optics.r_mm:g} mm, image {width} x {height} px",
        "pitch": f"{use.pitch_px:.1f} px; a segment is {use.segment_px:.1f} px wide at 0.4 pitches",
        "stars in view": f"{use.stars_in_view}, when the camera looks at the tag",
        "camera's field": f"{use.camera_deg[0]:.1f} x {use.camera_deg[1]:.1f} degrees",
        "target's field": f"{left:.1f} degrees left of the tag, {right:.1f} right, {up:.1f} up, {down:.1f} down",
        "beam": beam,
    }
    for name, text in lines.items():
        yield f"{name:<15} {text}"
    for warning in use.warnings:
        yield f"{'warning':<15} {warning}"
    if not use.warnings:
        yield f"{'verdict':<15} Nothing speaks against this target."


def _draw(target: TargetConfig, path: Path) -> int:
    """Write the drawing of a target, never over an existing file."""
    from bench.record.storage import write_new
    from bench.stations.reticle_files import drawing_file
    from bench.stations.target_shapes import title_of

    write_new(path, drawing_file(target, path))
    width, height = target.size_mm
    opaque = "black" if target.polarity == "positive" else "white"
    what = f"{title_of(target)}; {width:.6g} x {height:.6g} mm; {target.polarity}"
    filled = f"the {opaque} parts of the pattern are filled, and what is filled is opaque"
    lines = [f"Written: {path}. {what}: {filled}."]
    if target.drawing.mirrored:
        lines.append("Mirrored: the camera sees the pattern through the glass.")
    if path.suffix.lower() == ".pdf":
        lines.append("Print it at 100 % (actual size), and measure the scale bars.")
    show({"drawing": str(path), "title": title_of(target), "size_mm": [width, height]}, lines)
    return 0


@command("starbench simulate --station simulated --seed 1")
@click.option(
    "--station",
    "-s",
    "station_name",
    default="simulated",
    type=STATION_NAME,
    show_default=True,
    help="Station whose devices to simulate.",
)
@click.option(
    "--seed", type=SEED, metavar="N", default=1, show_default=True, help="Random seed of the simulated bench."
)
def simulate(station_name: str, seed: int) -> int:
    """Keep a simulated bench running in its own process, and print its ports.

    Write a line to standard input to simulate a fault, e.g. pan stall share=0.3 (docs/simulated-bench.md lists all).
    """
    from bench.simulated import SimulatedBench
    from bench.stations.station import load_station

    station = load_station(station_name).value
    if station.simulation is None:
        raise BenchError(
            "This station has no simulation section.",
            where=station_name,
            remedy="Use the station `simulated`.",
        )
    clock = BenchClock()
    with stop_on_signals(clock.request_stop), SimulatedBench(station.simulated_world, seed) as bench:
        for name, port in bench.endpoints.items():
            click.echo(f"{name:<8} {port}")
        click.echo(
            "These are the ports of the simulated bench, as a station file names them. To simulate a fault, write a"
            " line (e.g. pan stall share=0.3). To turn the lens by hand, write: lens turn deg=5. Ctrl-C ends the"
            " simulated bench.",
            err=True,
        )

        def obey_orders() -> None:
            for line in sys.stdin:
                click.echo(bench.order(line))

        threading.Thread(target=obey_orders, daemon=True).start()
        with suppress(Aborted):
            while bench.alive:
                clock.sleep(0.5)
            raise BenchError("The simulated bench ended by itself.", where=station_name)
    return 0


@click.group(cls=Family, epilog=epilog("starbench station new my_bench.yaml"))
def station() -> None:
    """Create station files."""


@station.command(
    "new",
    epilog=epilog("starbench station new my_bench.yaml --stage ximc --light gardasoft"),
)
@click.argument("path", type=NewFile())
@click.option(
    "--stage",
    type=click.Choice(["zaber_ascii", "ximc", "grbl", "esp30x", "thorlabs_apt", "text"]),
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
@click.option(
    "--port",
    "ports",
    multiple=True,
    metavar="PORT",
    help="Port on which to ask for stage and light, such as socket://10.0.0.7:5025; may be given again."
    "  [default: the serial ports of this computer]",
)
@click.option("--no-questions", is_flag=True, help="Send nothing to any port.")
@click.option(
    "--stand-ins",
    type=click.Choice(["keysight", "rigol", "siglent", "gardasoft", "microcontroller"]),
    help="Take all devices from the simulated bench, with this light and the stage that --stage names.",
)
@click.pass_context
def station_new(
    context: click.Context,
    path: Path,
    stage: str,
    light: str,
    camera: str | None,
    ports: tuple[str, ...],
    stand_ins: str | None,
    *,
    no_questions: bool,
) -> int:
    """Create a station file at PATH, filled in with the connected devices and with what they answer.

    Stages are asked for serial number, scale and limits as far as they know them, generators and Gardasoft controllers
    for their make. Nothing moves and nothing is switched. Opening the port of a GRBL board may restart it, so it is
    asked only if you agree. Standa and Thorlabs controllers are asked at ports that carry their maker's name, and at
    --port.
    """
    from bench.record.storage import write_new
    from bench.stations.asked_devices import RESTARTS, ask_light, ask_stage
    from bench.stations.discovery import discover
    from bench.stations.placeholders import Unknown
    from bench.stations.practice import draft_stand_ins
    from bench.stations.station_draft import draft_station, free_ports, ports_to_ask

    if stand_ins:
        unused = ("light", "camera", "ports", "no_questions")
        given = [name for name in unused if context.get_parameter_source(name) is ParameterSource.COMMANDLINE]
        if given:
            option = {"ports": "port"}.get(given[0], given[0].replace("_", "-"))
            raise UsageError(
                f"--{option} is not used with --stand-ins, which takes light and camera of the simulated bench.",
                remedy=f"Leave out --{option}. --stand-ins names the light, --stage the stage.",
            )
        write_new(path, draft_stand_ins(stand_ins, stage).encode())
        show(
            {"station": str(path)},
            [f"Written: {path}. Check it with: {pasteable('plan', 'three_pose', '-s', path)}"],
        )
        return 0
    discovery, clock = discover(), BenchClock()
    all_ports = [] if no_questions else [*ports] or free_ports(discovery)
    if stage in RESTARTS and all_ports and not may_restart(all_ports):
        all_ports = []
    own_ports = [port for port in all_ports if ports or port in ports_to_ask(discovery, stage)]
    answered = ask_stage(stage, own_ports, clock)
    taken = answered.ports if answered else set()
    asked = answered, ask_light(light, [port for port in all_ports if port not in taken], clock)
    draft = draft_station(
        discovery, stage=stage, light=light, camera=camera, asked=asked, certified=certified_length()
    )
    write_new(path, draft.encode())
    for device in asked:
        if device is not None:
            print_line(f"It answered: {device.what} at {device.port}.")
    for sentence in discovery.missing:
        print_line(f"Missing: {sentence}")
    print_line(
        f"Written: {path}. Replace every placeholder (such as {Unknown.SERIAL}), check scales and limits, then:"
        f" {pasteable('plan', 'three_pose', '-s', path)}"
    )
    if discovery.missing:
        click.echo(
            "To practise without these devices: starbench station new practice.yaml --stand-ins keysight"
        )
    return 0


def certified_length() -> str | None:
    """Ask which length the collimator's certificate states; None if there is none, or nobody can be asked."""
    if not sys.stdin.isatty():
        return None
    answer: str = click.prompt(
        "Which length does the certificate of the collimator state? focal_length: of the glass, as makers state it;"
        " seen: as a camera on a goniometer saw it; none: there is no certificate",
        type=click.Choice(["focal_length", "seen", "none"]),
        default="none",
        err=True,
    )
    return None if answer == "none" else answer


def may_restart(ports: Sequence[str]) -> bool:
    """Ask whether a board may be restarted by the opening of its port; nobody who can be asked means no."""
    what = "Opening the port of a GRBL board may restart it: it then loses its position. Nothing moves."
    what += f" Ports: {', '.join(ports)}"
    if not sys.stdin.isatty():
        click.echo(f"{what}. The board was not asked, because nobody can agree here.", err=True)
        return False
    return click.confirm(f"{what}. Ask the board?", err=True)


@command("starbench schema sequence > sequence.schema.json")
@click.argument(
    "document", type=click.Choice(["sequence", "station", "queue", "job", *sorted(entry_points(SCHEMAS))])
)
def schema(document: str) -> int:
    """Print the JSON Schema of sequence, station, queue, job or lab files, for use by text editors.

    runs-table: the columns that `starbench history table` writes, each with its meaning and its unit.
    """
    from bench.stations.station import Station
    from sequences.queue import JobFile, Queue
    from sequences.schema import Sequence

    own = {
        "sequence": Sequence.model_json_schema,
        "station": Station.model_json_schema,
        "queue": Queue.model_json_schema,
        "job": JobFile.model_json_schema,
    }
    print_json(own[document]() if document in own else load(SCHEMAS, document)())
    return 0


@command(
    "starbench devices",
    "starbench devices --wiring --station my_bench.yaml",
    status=status_text("0 done, 1 failed{invalid}, 3 you did not confirm the test{ctrl_c}"),
)
@click.option(
    "--wiring",
    is_flag=True,
    help="Test the cable from the light to the camera's trigger input: the light flickers.",
)
@click.option("--station", "-s", type=STATION_NAME, help="Station for --wiring.")
@click.option("--yes", is_flag=True, help="With --wiring: switch the light on without asking.")
@JSON
def devices(wiring: bool, station: str | None, yes: bool) -> int:
    """List connected devices, their names for a station file, and missing software.

    Sends nothing to stages and lights. The camera makers' software asks each camera for its name.

    With --wiring and --station: asks, switches the light on for 2 s at 20 Hz, and compares trigger edges with events.
    Names a trigger cable that is missing, inverted, on the wrong channel, or of the wrong level. Nothing moves.
    """
    if wiring:
        if station is None:
            raise click.UsageError("Missing option '--station' / '-s', which --wiring needs.")
        return _show_wiring(station, yes=yes)
    from bench.stations.discovery import discover

    return show_devices(discover())


def show_devices(discovery: Discovery) -> int:
    """Print the connected devices and the missing software."""
    plugins = _plugins()
    show(lambda: {**asdict(discovery), "plugins": plugins}, _device_lines(discovery, plugins))
    return 0


def _device_lines(discovery: Discovery, plugins: list[dict[str, str]]) -> Iterator[str]:
    for port in discovery.ports:
        note = f"  ({port.note})" if port.note else ""
        yield f"serial port  {port.name}  {port.what}{note}"
    for camera in discovery.cameras:
        trouble = f"  ({camera.trouble})" if camera.trouble else ""
        keys = {"driver": camera.driver, "source": camera.source, "serial": camera.serial}
        entry = "  ".join(f"{name}: {value}" for name, value in keys.items() if value)
        yield f"camera       {entry}  # {camera.description}{trouble}"
    for plugin in plugins:
        trouble = f"  (cannot be used: {plugin['trouble']})" if plugin["trouble"] else ""
        yield f"plug-in      {plugin['driver']}  {plugin['kind']}  # {plugin['package']}{trouble}"
    for sentence in discovery.missing:
        yield f"missing      {sentence}"
    yield (
        "simulated    -s simulated, simulated_frames, simulated_ideal, simulated_unaligned: "
        "stations without devices"
    )


def _plugins() -> list[dict[str, str]]:
    """Return the drivers that other packages bring, with the trouble of those that cannot be used."""
    from bench.stations.plugins import GROUPS, plugins

    return [
        {
            "driver": plugin.name,
            "kind": kind,
            "package": plugin.package,
            "trouble": plugin.trouble,
        }
        for kind in GROUPS
        for plugin in plugins(kind)
    ]


def _show_wiring(station_name: str, *, yes: bool) -> int:
    """Ask, test the wiring, print the result; exit status 0: right, 1: not, 3: the person refused."""
    from bench.run.wiring import FREQUENCY_HZ, check_wiring
    from bench.stations.devices import Devices
    from bench.stations.station import load_station

    station = load_station(station_name).value
    if not yes:
        if not sys.stdin.isatty():
            raise UsageError(
                "The wiring test switches the light on, and nobody can be asked.",
                remedy="Run it at a terminal, or give --yes.",
            )
        asked = f"The light will flicker at {FREQUENCY_HZ:g} Hz for about 2 s. Nothing moves. Continue?"
        if not click.confirm(asked, err=True):
            click.echo("Nothing was done.", err=True)
            return STOPPED
    clock = BenchClock()
    devices = Devices(station, seed=1, clock=clock, wire_log=None)
    try:
        report = check_wiring(devices, station, clock)
    finally:
        devices.close()
    show(report.to_dict, _wiring_lines(report))
    return int(bool(report.faults))


def _wiring_lines(report: WiringReport) -> Iterator[str]:
    yield f"Seen: {report.seen}."
    for fault in report.faults:
        yield f"{fault.name}: {fault.what} {fault.remedy}"
    if not report.faults:
        yield "The wiring is right: channel, polarity and number of the trigger edges agree with the light."
