"""What is connected, and the station file drafted from it."""

import io
import re
import sys
import types

import pytest
from calling import call, out_of
from filled_stations import filled, filled_example
from slow_cases import first_quick

from bench.base.clock import BenchClock
from bench.commands.station import show_devices, station_new
from bench.plan.plan import load_documents, make_plan
from bench.simulated import SimulatedBench
from bench.stations import discovery
from bench.stations.asked_devices import ask_light, ask_stage, dialect_of
from bench.stations.discovery import Discovery, FoundPort, discover
from bench.stations.placeholders import Unknown
from bench.stations.practice import draft_stand_ins
from bench.stations.station import SHIPPED_STATIONS, load_station
from bench.stations.station_draft import draft_station, ports_to_ask
from drivers.camera import FoundCamera
from drivers.errors import ReplyTimeout

CHOICES = {
    option.name: option.type.choices for option in station_new.params if hasattr(option.type, "choices")
}
PORTS = (
    FoundPort("/dev/serial/by-id/zaber", "/dev/ttyUSB0", "X-USBDC", "A1", ""),
    FoundPort("/dev/ttyS0", "/dev/ttyS0", "", "", ""),
    FoundPort("/dev/ttyACM1", "/dev/ttyACM1", "", "", ""),
)


NOTHING = Discovery((), (), ())


@pytest.fixture
def written(tmp_path):
    """Write a station file; return what it says."""

    def write(text):
        (tmp_path / "bench.yaml").write_text(text)
        return load_station(str(tmp_path / "bench.yaml")).value

    return write


def test_a_port_is_called_by_its_id_where_it_has_one(tmp_path, monkeypatch):
    device = tmp_path / "ttyUSB0"
    device.touch()
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    (by_id / "usb-Zaber-if00").symlink_to(device)
    infos = [types.SimpleNamespace(device=str(device), description="X-USBDC", serial_number="A1")]
    monkeypatch.setattr(discovery.list_ports, "comports", lambda: infos)
    monkeypatch.setattr(discovery, "find_cameras", lambda: ([FoundCamera("metavision", "00051", "EVK4")], []))
    connected = discover(by_id)
    assert [(port.name, port.note) for port in connected.ports] == [(str(by_id / "usb-Zaber-if00"), "")]
    assert connected.cameras[0].serial == "00051"
    assert connected.missing == ()


@pytest.mark.parametrize("stage", CHOICES["stage"])
@pytest.mark.parametrize("light", CHOICES["light"])
@pytest.mark.parametrize("ports", [(), PORTS])
def test_a_draft_reads_without_a_fault_and_names_what_is_connected(written, stage, light, ports):
    discovery = Discovery(ports, (FoundCamera("neuromorphic_evk4", "00051", "EVK4"),) if ports else (), ())
    station = written(draft_station(discovery, stage=stage, light=light))
    assert (station.stage.driver, station.light.driver) == (stage, light)
    assert station.camera.serial == ("00051" if ports else Unknown.SERIAL)
    if ports:
        assert station.stage.ports[0] == "/dev/serial/by-id/zaber"
        assert station.light.port == "/dev/ttyACM1"


WEBCAM = FoundCamera("opencv", "8A0A3C5F", "video device", source="/dev/v4l/by-id/usb-Maker")
TROUBLED = FoundCamera("metavision", "00051", "EVK4", trouble="access denied")


@pytest.mark.parametrize(
    ("cameras", "family", "driver", "named"),
    [
        ((), None, "metavision", Unknown.SERIAL),
        ((WEBCAM,), None, "opencv", "8A0A3C5F"),
        ((WEBCAM, FoundCamera("neuromorphic_evk4", "00051", "EVK4")), None, "neuromorphic_evk4", "00051"),
        ((WEBCAM, TROUBLED), None, "opencv", "8A0A3C5F"),
        ((), "opencv", "opencv", ""),
        ((WEBCAM,), "metavision", "metavision", Unknown.SERIAL),
        ((), "recorded", "recorded", Unknown.SERIAL),
        ((), "pictures", "pictures", ""),
    ],
)
def test_a_draft_takes_the_camera_that_is_connected_or_asked_for(written, cameras, family, driver, named):
    drafted = draft_station(Discovery((), cameras, ()), stage="zaber_ascii", camera=family)
    camera = written(drafted).camera
    assert (camera.driver, camera.serial) == (driver, named)
    if driver == "opencv":
        assert camera.source == (WEBCAM.source if cameras else "/dev/v4l/by-id/CHOOSE-A-CAMERA")


def test_each_camera_is_listed_in_the_words_of_a_station_file(capsys):
    show_devices(Discovery(PORTS, (WEBCAM, TROUBLED), ("Something.",)))
    output = capsys.readouterr().out
    assert "source: /dev/v4l/by-id/usb-Maker  serial: 8A0A3C5F" in output
    assert "serial: 00051  # EVK4  (access denied)" in output
    assert "missing      Something." in output


@pytest.mark.parametrize("stage", CHOICES["stage"])
@pytest.mark.parametrize("light", CHOICES["light"])
def test_a_draft_cannot_be_planned_before_all_of_it_is_filled_in(tmp_path, stage, light):
    path = tmp_path / "bench.yaml"
    path.write_text(draft_station(NOTHING, stage=stage, light=light))
    faults = [str(fault) for fault in make_plan(*load_documents("turntable", str(path))).faults]
    assert len(faults) == len(re.findall("ASK-THE|CHOOSE-A|NAME-THE|YOUR-LAB", path.read_text()))
    row = next(n for n, line in enumerate(path.read_text().splitlines(), 1) if Unknown.PORT in line)
    place = "stage.axes.pan.port" if stage in {"ximc", "thorlabs_apt"} else "stage.port"
    assert any(fault.startswith(f"{path}:{row}:") and f" {place}: " in fault for fault in faults)
    path.write_text(filled(path.read_text()))
    assert make_plan(*load_documents("turntable", str(path))).faults == ()


def test_sections_that_a_draft_and_each_example_offer_as_comments_are_accepted(written):
    drafted = draft_station(NOTHING, stage="grbl")
    texts = [drafted, *(path.read_text(encoding="utf-8") for path in SHIPPED_STATIONS.glob("example_*.yaml"))]
    for text in texts:
        offered = re.search(r"^# collimator:(\n#   .*)+", text, re.MULTILINE).group()
        assert offered == re.search(r"^# collimator:(\n#   .*)+", drafted, re.MULTILINE).group()
        # A section begins at its name; what is indented below belongs to it.
        used = re.sub(r"^# (?=[a-z_]+:|  )", "", text, flags=re.MULTILINE)
        written(filled(used))


# ---------------------------------------------------------------- what the devices answer


@pytest.mark.parametrize(
    ("light", "driver", "stage"),
    first_quick(
        [
            ("keysight", "scpi", "zaber_ascii"),
            ("rigol", "scpi", "ximc"),
            ("siglent", "scpi", "esp30x"),
            ("gardasoft", "gardasoft", "grbl"),
            ("microcontroller", "text", "text"),
            ("keysight", "scpi", "thorlabs_apt"),
        ],
    ),
)
def test_every_stage_and_every_light_has_a_stand_in_that_can_be_planned(
    written, tmp_path, light, driver, stage
):
    station = written(draft_stand_ins(light, stage))
    assert (station.stage.driver, station.light.driver) == (stage, driver)
    assert set(station.axes) == {"pan", "tilt"}
    assert make_plan(*load_documents("three_pose", str(tmp_path / "bench.yaml"))).faults == ()


def test_stage_and_light_are_found_at_whichever_port_they_answer(written, tmp_path):
    clock = BenchClock()
    with SimulatedBench({}, 1) as bench:
        ports = [bench.endpoints["light"], bench.endpoints["gimbal"]]
        stage, light = ask_stage("zaber_ascii", ports, clock), ask_light("scpi", ports, clock)
    assert (stage.port, light.port) == (ports[1], ports[0])
    assert [axis.microsteps_per_deg for axis in stage.axes] == [None, None]  # a goniometer does not know it
    discovery = Discovery((FoundPort(ports[1], ports[1], "", "", ""),), (), ())
    text = draft_station(discovery, stage="zaber_ascii", asked=(stage, light))
    assert "-64000 to 64000 microsteps" in text
    assert written(text).light.port == ports[0]
    assert ask_stage("zaber_ascii", [str(tmp_path / "nothing")], clock) is None


def test_a_stage_that_counts_in_degrees_states_its_limits_and_a_strobe_controller_its_model(written):
    clock = BenchClock()
    axes = {"pan": {"serial": "1", "limit_deg": 9.5}, "tilt": {"serial": "2", "limit_deg": 40}}
    with SimulatedBench({"stage": {"kind": "esp301", **axes}, "light": {"kind": "gardasoft"}}, 1) as bench:
        ports = [bench.endpoints["light"], bench.endpoints["gimbal"]]
        stage, light = ask_stage("esp30x", ports, clock), ask_light("gardasoft", ports, clock)
    assert (stage.port, light.port) == (ports[1], ports[0])
    station = written(draft_station(NOTHING, stage="esp30x", light="gardasoft", asked=(stage, light)))
    assert {
        name: (axis.number, axis.serial, axis.limits_deg) for name, axis in station.stage.axes.items()
    } == {"pan": (1, "SN1", (-9.5, 9.5)), "tilt": (2, "SN2", (-12.0, 12.0))}
    assert light.what == f"Gardasoft {station.light.model}"


@pytest.mark.parametrize(
    ("driver", "scale"), first_quick([("ximc", "ASK-THE-DATA-SHEET"), ("thorlabs_apt", "136533.333,")])
)
def test_controllers_with_a_port_for_each_axis_are_asked_for_their_serial_numbers(driver, scale):
    with SimulatedBench({"stage": {"kind": driver}}, 1) as bench:
        ports = [bench.endpoints[name] for name in ("light", "gimbal-pan", "gimbal-tilt")]
        stage = ask_stage(driver, ports, BenchClock())
    assert [(axis.name, axis.port, axis.serial) for axis in stage.axes] == [
        ("pan", ports[1], "100101"),
        ("tilt", ports[2], "100102"),
    ]
    text = draft_station(NOTHING, stage=driver, asked=(stage, None))
    for axis in stage.axes:
        assert f"{axis.name}: {{port: {axis.port}, serial: {axis.serial}, " in text
    assert text.count(f"_deg: {scale}") == 2


@pytest.mark.parametrize(
    "others",
    # The port of a light takes more than 10 s: it is asked as long as a board may need to start
    [(), pytest.param(("light",), marks=pytest.mark.slow)],
)
def test_a_board_is_asked_for_scales_and_travel(others):
    """Its tilt axis reaches from 15 degrees down to -6."""
    with SimulatedBench({"stage": {"kind": "grbl"}}, 1) as bench:
        stage = ask_stage("grbl", [bench.endpoints[name] for name in (*others, "gimbal")], BenchClock())
        assert stage.ports == {bench.endpoints["gimbal"]}
    text = draft_station(NOTHING, stage="grbl", asked=(stage, None))
    for letter, lowest in (("X", -12), ("Y", -6)):
        assert f"{letter}, steps_per_deg: 640, zero_deg: 15, limits_deg: [{lowest}, 12]," in text


@pytest.mark.parametrize("agrees", [True, False])
def test_a_board_is_asked_only_if_the_operator_agrees(capsys, tmp_path, monkeypatch, agrees):
    """Otherwise no port is opened, not even to look for the light."""
    opened = []
    monkeypatch.setattr(
        "bench.stations.asked_devices.SerialPort", lambda port, _: opened.append(port) or io.BytesIO()
    )
    monkeypatch.setattr("bench.commands.station.may_restart", lambda _: agrees)
    monkeypatch.setattr("bench.stations.asked_devices.GrblController", refused_link)
    monkeypatch.setattr("bench.stations.asked_devices.ScpiLine", refused_link)
    call(capsys, "station", "new", tmp_path / "a.yaml", "--stage", "grbl", "--port", "/dev/board")
    assert opened == (["/dev/board", "/dev/board"] if agrees else [])


def refused_link(*_, **__):
    raise ReplyTimeout("no complete reply", where="/dev/board")


def test_where_nobody_can_agree_a_board_is_not_asked(capsys, tmp_path):
    words = ("--stage", "grbl", "--port", "/dev/none")
    errors = call(capsys, "station", "new", tmp_path / "a.yaml", *words).err
    assert "may restart" in errors
    assert "was not asked" in errors


@pytest.mark.parametrize(("stage", "asked"), [("thorlabs_apt", [1]), ("ximc", []), ("zaber_ascii", [0, 1])])
def test_controllers_without_text_are_asked_only_at_ports_named_by_their_maker(stage, asked):
    names = (
        "/dev/serial/by-id/usb-FTDI_A1",
        "/dev/serial/by-id/usb-Thorlabs_Kinesis_K10CR1_55000123-if00-port0",
    )
    ports = [FoundPort(name, f"/dev/ttyUSB{at}", "", "", "") for at, name in enumerate(names)]
    assert ports_to_ask(Discovery(tuple(ports), (), ()), stage) == [names[at] for at in asked]


@pytest.mark.parametrize(
    ("maker", "model", "dialect"),
    [
        ("Agilent Technologies", "33220A", "keysight"),
        ("Keysight Technologies", "33512B", "numbered"),
        ("RIGOL TECHNOLOGIES", "DG1022Z", "numbered"),
        ("Siglent Technologies", "SDG1032X", "siglent"),
        ("HEWLETT-PACKARD", "33250A", "keysight"),
    ],
)
def test_the_dialect_follows_from_maker_and_model(maker, model, dialect):
    assert dialect_of(maker, model) == dialect


def test_the_plan_tells_a_missing_package(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "neuromorphic_drivers", None)
    path = tmp_path / "bench.yaml"
    path.write_text(filled_example("example_evk4").replace("driver: metavision", "driver: neuromorphic_evk4"))
    output = out_of(capsys, "plan", "three_pose", "-s", path)
    assert "The package neuromorphic-drivers" in output
    assert "pip install 'starbench[evk4]'" in output
