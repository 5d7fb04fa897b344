"""The station file: the devices of a bench, their ports, and their limits.

The sections of the devices are in `station_stages`, `station_lights` and `station_cameras`, those of the collimator and
of the gimbal's readings in `station_collimator`, the printed target in `station_target`, a board in its place in
`station_board`, and the expected values in `station_expected`; `devices` opens the devices. docs/stations.md describes
every key. A simulated bench and a real one differ in the station file only; the same sequences run on both.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from bench.stations.sections import AxisConfig
from bench.stations.station_board import BoardConfig
from bench.stations.station_budget import BudgetConfig
from bench.stations.station_cameras import CameraConfig, PictureFolderConfig, RecordedCameraConfig
from bench.stations.station_collimator import CollimatorConfig, GimbalConfig
from bench.stations.station_expected import ExpectedConfig
from bench.stations.station_fields import SIMULATED_PREFIX, Text
from bench.stations.station_interlocks import InterlocksConfig
from bench.stations.station_ledger import LedgerConfig
from bench.stations.station_lights import LightConfig
from bench.stations.station_messages import MessagesConfig
from bench.stations.station_stages import StageConfig
from bench.stations.station_target import TargetConfig
from bench.stations.station_text import use_descriptions
from sequences.reader import Located, find_document, read_document
from sequences.schema import Name
from sequences.strict_model import StrictModel

SHIPPED_STATIONS = Path(__file__).parent


class DiskConfig(StrictModel):
    """Disk space that must be free before a run, in addition to what the run needs."""

    min_free_gb: Annotated[float, Field(ge=0, le=1_000_000)] = 1.0


_TRUTHS = {"true": True, "false": False}
_NUMBER = re.compile(r"[-+]?(?!0\d)(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def _plain_values(section: Any) -> Any:
    """Convert the texts of a section without a schema to numbers and booleans. Serial numbers and 007 remain text."""
    if isinstance(section, Mapping):
        return {key: value if "serial" in key else _plain_values(value) for key, value in section.items()}
    if isinstance(section, list):
        return [_plain_values(value) for value in section]
    if not isinstance(section, str) or not _NUMBER.fullmatch(section):
        return _TRUTHS.get(section, section) if isinstance(section, str) else section
    number = float(section)
    if not math.isfinite(number):
        return section
    return int(section) if section.lstrip("+-").isdigit() else number


class Station(StrictModel):
    """A station file."""

    format: Literal["starbench/station/1"]
    name: Name
    laboratory: Text | None = None
    operator: Text | None = None
    stage: StageConfig
    light: LightConfig
    camera: CameraConfig
    target: TargetConfig = TargetConfig()
    board: BoardConfig | None = None
    collimator: CollimatorConfig = CollimatorConfig()
    gimbal: GimbalConfig | None = None
    budget: BudgetConfig = BudgetConfig()
    expected: ExpectedConfig | None = None
    disk: DiskConfig = DiskConfig()
    messages: MessagesConfig = MessagesConfig()
    interlocks: InterlocksConfig = InterlocksConfig()
    ledger: LedgerConfig = LedgerConfig()
    simulation: Annotated[dict[str, Any], BeforeValidator(_plain_values)] | None = None

    @property
    def axes(self) -> Mapping[str, AxisConfig]:
        """Axes of the stage by name."""
        return {str(name): axis for name, axis in self.stage.axes.items()}

    @property
    def needs_simulated_bench(self) -> bool:
        """Whether any device belongs to the simulated bench."""
        ports = (*self.stage.ports, *self.light.ports, *self.camera.ports)
        return any(port.startswith(SIMULATED_PREFIX) for port in ports)

    @property
    def simulated_world(self) -> dict[str, Any]:
        """Configuration of the simulated bench: section ``simulation``, with the target of this station."""
        given, print_ = self.simulation or {}, self.target.in_simulation()
        reticle = given.get("reticle", {})
        merged = {**print_["reticle"], **reticle} if isinstance(reticle, Mapping) else reticle
        return {**print_, **given, "reticle": merged}

    @property
    def is_simulated(self) -> bool:
        """Whether a run measures no real camera: a device is simulated, or recordings are replayed."""
        return self.needs_simulated_bench or isinstance(
            self.camera, RecordedCameraConfig | PictureFolderConfig
        )


def load_station(name_or_path: str, settings: Mapping[str, str] | None = None) -> Located[Station]:
    """Read a station file.

    name_or_path: Path of the file, or name of a shipped station such as ``simulated``.
    settings: Values that replace those of the file: YAML texts by path, such as ``camera.biases.bias_fo``.
    Raises DocumentFaults: When the file is not valid, with all faults.
    """
    station = read_document(find_document(name_or_path, SHIPPED_STATIONS), Station, settings)
    use_descriptions(station)
    return station
