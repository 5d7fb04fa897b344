"""Plug-ins: the example package, installed into a folder of its own, and packages that are broken in every way."""

import json
import os
import shutil
import tomllib
import zipfile
from pathlib import Path

import pytest
from quick_runs import THREE, write_sequence, write_station
from running import python
from slow_cases import slow
from station_texts import without

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "docs" / "plugins" / "starbench_epics"
STATION = """\
format: starbench/station/1
name: Bench
stage:
  driver: epics_motor
  axes: {pan: {record: "IOC:m1", limits_deg: [-90, 90], speed_deg_s: 30, acceleration_deg_s2: 1000}}
light: {driver: scpi, port: /dev/ttyUSB1}
camera: {driver: metavision, serial: 00051234}
"""
SECTION = """\
from typing import Literal
from bench.stations.sections import (StageSection)
class Section(StageSection):
    driver: Literal['NAME']
"""
READ = """
import sys
from bench.stations.station import load_station
from sequences.errors import DocumentFaults
for name in sys.argv[1:]:
    try:
        print(type(load_station(name).value.stage).__name__)
    except DocumentFaults as error:
        print(error)
"""


def wheel(source: Path, folder: Path) -> Path:
    """Build a wheel of a pure package as a build tool does, so that no build tool is needed here."""
    project = tomllib.loads((source / "pyproject.toml").read_text())["project"]
    name, version = project["name"].replace("-", "_"), project["version"]
    info = f"{name}-{version}.dist-info"
    files = {str(path.relative_to(source)): path.read_text() for path in (source / name).glob("*.py")}
    files[f"{info}/METADATA"] = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {version}\n"
    files[f"{info}/WHEEL"] = "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    files[f"{info}/entry_points.txt"] = "".join(
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
        for group, entries in project["entry-points"].items()
    )
    files[f"{info}/RECORD"] = "".join(f"{file},,\n" for file in [*files, f"{info}/RECORD"])
    path = folder / f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for file, text in files.items():
            archive.writestr(file, text)
    return path


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example, installed by pip into a folder."""
    folder = tmp_path_factory.mktemp("plugin")
    shutil.copytree(EXAMPLE, folder / "source")
    options = ["--quiet", "--no-deps", "--no-index", "--disable-pip-version-check"]
    python("-m", "pip", "install", *options, "--target", folder / "site", wheel(EXAMPLE, folder))
    (folder / "source" / "starbench_epics").rename(folder / "not_here")
    return folder


def run(site: Path, *arguments: str | Path, cwd: Path = ROOT) -> str:
    paths = os.pathsep.join(filter(None, [str(site), str(ROOT), os.environ.get("PYTHONPATH")]))
    done = python(*arguments, status=None, cwd=cwd, PYTHONPATH=paths, PYTHONDONTWRITEBYTECODE=1)
    return done.stdout + done.stderr


def package(
    site: Path,
    code: str,
    entry_points: str = "[starbench.stages]\nepics_motor = badly:Section\n",
    distribution: str = "badly",
) -> None:
    """Write a package, as an installer would leave it."""
    site.mkdir(exist_ok=True)
    (site / f"{distribution}.py").write_text(code)
    info = site / f"{distribution}-0.3.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 0.3\n")
    (info / "entry_points.txt").write_text(entry_points)


def test_the_example_is_a_driver_like_any_other(installed, tmp_path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text(STATION)
    (tmp_path / "wrong.yaml").write_text(STATION.replace("record:", "recrod:"))
    output = run(installed / "site", "-c", READ, path, tmp_path / "wrong.yaml")
    assert output.startswith("EpicsStageConfig\n")
    assert "stage.axes.pan.recrod: unknown key." in output
    assert "EpicsStageConfig" in run(installed / "site", "-m", "bench", "schema", "station")
    assert "epics_motor" in run(installed / "site", "-m", "bench", "devices")


@pytest.mark.slow
def test_the_example_passes_the_contract_tests(installed) -> None:
    """caproto's simulated motor record is the device."""
    pytest.importorskip("caproto", reason="pip install caproto")
    output = run(installed / "site", "-m", "pytest", "-q", "tests", cwd=installed / "source")
    assert "7 passed, 1 skipped" in output, output


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise RuntimeError('no library')", "RuntimeError: no library"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        slow("", "has no attribute 'Section'"),
        slow(SECTION.replace("NAME", "other"), "its key driver must be Literal['epics_motor']"),
        (SECTION.replace("NAME", "epics_motor"), "it does not implement open_device, ports"),
    ],
)
def test_a_broken_plugin_is_named_and_breaks_nothing_else(tmp_path, code, reason) -> None:
    site = tmp_path / "site"
    package(site, code)
    (tmp_path / "bench.yaml").write_text(STATION)
    lines = run(site, "-c", READ, tmp_path / "bench.yaml", "simulated").splitlines()
    assert "'epics_motor' of badly 0.3" in lines[0]
    assert reason in lines[0]
    assert "bench.yaml:4:3: stage" in lines[0] or "bench.yaml:3:" in lines[0]
    assert lines[-1] == "ZaberStageConfig"


LAB = """\
from datetime import UTC, datetime
from typing import Literal
from bench.stations.sections import (EventCameraSection, LightSection)
from drivers.camera.simulated_evk4 import SimulatedEvk4Camera
from drivers.light.scpi import ScpiLight
class Camera(EventCameraSection):
    driver: Literal['labcam']
    address: str
    @property
    def ports(self):
        return (self.address,)
    def open_device(self, port, *, clock):
        return SimulatedEvk4Camera.open(
            port(self.address), serial=self.serial, clock=clock, utc_now=lambda: datetime.now(UTC)
        )
class Lamp(LightSection):
    driver: Literal['lablamp']
    wire: str
    @property
    def ports(self):
        return (self.wire,)
    def open_device(self, port, *, clock, wire_log):
        return ScpiLight.open(port(self.wire), clock=clock, wire_log=wire_log)
"""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A package with a camera and a light, as an installer would leave it."""
    site = tmp_path / "site"
    points = "[starbench.cameras]\nlabcam = lab:Camera\n[starbench.lights]\nlablamp = lab:Lamp\n"
    package(site, LAB, points, "lab")
    text = write_station(tmp_path / "bench.yaml").read_text()
    text = without(text, "light").replace("driver: simulated_evk4", "driver: labcam")
    (tmp_path / "bench.yaml").write_text(text + "light: {driver: lablamp, wire: sim:light}\n")
    return site


def test_a_camera_and_a_light_of_a_package_have_sections_like_any_other(lab, tmp_path) -> None:
    (tmp_path / "wrong.yaml").write_text((tmp_path / "bench.yaml").read_text().replace("wire:", "wier:"))
    output = run(lab, "-c", READ.replace("stage", "camera"), tmp_path / "bench.yaml", tmp_path / "wrong.yaml")
    assert output.startswith("Camera\n")
    assert "light.wier: unknown key." in output
    schema = run(lab, "-m", "bench", "schema", "station")
    assert '"labcam"' in schema
    assert '"lablamp"' in schema


@pytest.mark.slow
def test_a_run_uses_a_camera_and_a_light_of_a_package(lab, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    sequence = write_sequence(tmp_path / "sequence.yaml", THREE)
    station, folder = tmp_path / "bench.yaml", tmp_path / "run"
    output = run(lab, "-m", "bench", "run", sequence, "-s", station, "-o", folder, "--seed", "1")
    assert "Report: " in output, output
    run_facts = json.loads((tmp_path / "run" / "results.json").read_bytes())["run"]
    assert run_facts["software"]["lab"] == "0.3"
    assert run_facts["plugins"] == {"lab": ["light lablamp", "camera labcam"]}
    assert "(plug-in: light lablamp, camera labcam)" in (tmp_path / "run" / "report.html").read_text()
    output = run(lab, "-m", "bench", "verify", "--again", tmp_path / "run")
    assert "plug-in: lab 0.3" in output, output
    assert output.startswith("SEALED: ")
    elsewhere = run(tmp_path, "-m", "bench", "verify", "--again", tmp_path / "run")
    assert "needs lab 0.3" in elsewhere, elsewhere


def test_two_packages_of_one_name_are_both_named_and_a_built_in_driver_stays(installed, tmp_path) -> None:
    site = tmp_path / "site"
    shutil.copytree(installed / "site", site)
    package(site, "raise RuntimeError")
    package(site, "raise RuntimeError", "[starbench.stages]\nzaber_ascii = thief:Section\n", "thief")
    (tmp_path / "bench.yaml").write_text(STATION)
    lines = run(site, "-c", READ, tmp_path / "bench.yaml", "simulated").splitlines()
    assert "two packages" in lines[0]
    assert lines[-1] == "ZaberStageConfig"
