"""The station file: the devices of a bench, their ports, and their limits.

The sections of stage and light are in `stages_and_lights`, that of the camera in `cameras`. docs/stations.md describes
every key.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from bench.stations.cameras import (
    CameraConfig,
    PictureFolderConfig,
    RecordedCameraConfig,
    SimulatedEvk4Config,
)
from bench.stations.messages_section import MessagesConfig
from bench.stations.sections import AxisConfig
from bench.stations.stages_and_lights import LightConfig, StageConfig
from bench.stations.station_budget import BudgetConfig, CollimatorConfig, GimbalConfig
from bench.stations.station_fields import (
    SIMULATED_PREFIX,
    FocalLength,
    InterlocksConfig,
    Serial,
    TargetConfig,
    Text,
)
from bench.stations.station_text import use_descriptions
from calib.studies.predicted_views import TYPICAL_DEFOCUS, TYPICAL_RMS_PX, CollimatorErrors, ExpectedBench
from sequences.reader import Located, find_document, read_document
from sequences.schema import Name, ResultLimits
from sequences.strict_model import StrictModel, Within

_STRICT = "strict"

_Side = Annotated[int, Within(8, 65_536, "px")]
_Coefficient = Annotated[float, Within(-1000, 1000)]

SHIPPED_STATIONS = Path(__file__).parent

_TRUTHS = {"true": True, "false": False}
_NUMBER = re.compile(r"[-+]?(?!0\d)(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


class LedgerConfig(StrictModel):
    """What an unexplained break of the bench's ledger does."""

    anchor: str | None = None
    """Not used any more; stations of earlier runs name it."""
    strict: bool = False
    """Whether a break of the ledger that nobody has explained stops a run."""

    bare_words = (_STRICT,)

    @model_validator(mode="before")
    @classmethod
    def _from_word(cls, value: Any) -> Any:
        return {"strict": "true"} if value == _STRICT else value


class ExpectedCollimatorConfig(StrictModel):
    """How far the views of this collimator deviate from an ideal one."""

    rms_px: Annotated[float, Field(ge=0, le=100)] = TYPICAL_RMS_PX
    """RMS length of the errors that follow the collimator, star noise included, px; 0: none."""
    pupil_wander_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """Random shift of the camera's pupil across the beam between poses."""
    pose_rms_px: Annotated[float, Field(ge=0, le=100)] = 0.0
    """RMS length of the errors that differ from pose to pose, px; 0: small."""


class ExpectedConfig(StrictModel):
    """Approximate properties of the bench, for plans and studies only; no estimator uses them."""

    focal_px: Annotated[float, Within(10, 1e6, "px")]
    r_mm: FocalLength
    half_angle_deg: Annotated[float, Field(ge=0.01, lt=60)]
    """Half angle of the beam."""
    image_size: tuple[_Side, _Side] = (1280, 720)
    k1: _Coefficient = 0.0
    k2: _Coefficient = 0.0
    star_sigma_px: Annotated[float, Within(1e-4, 100, "px")] = ExpectedBench.star_sigma_px
    """Uncertainty of a star, per axis."""
    collimator: ExpectedCollimatorConfig = ExpectedCollimatorConfig()

    def errors(self, collimator: CollimatorConfig) -> CollimatorErrors:
        """Return the collimator's expected errors; a defocus that is not stated has a typical size."""
        return CollimatorErrors(
            self.collimator.rms_px,
            self.collimator.pupil_wander_mm,
            collimator.defocus.value if collimator.defocus else TYPICAL_DEFOCUS,
            self.collimator.pose_rms_px,
        )


class DiskConfig(StrictModel):
    """Disk space that must be free before a run, in addition to what the run needs."""

    min_free_gb: Annotated[float, Field(ge=0, le=1_000_000)] = 1.0


class CheckStandardConfig(StrictModel):
    """One camera that is measured again and again on this station: its control chart watches the bench."""

    serial: Serial
    every_days: Annotated[float, Within(0.01, 3650, "days")] | None = None
    baseline: Annotated[int, Within(5, 1000)] = 20
    """Number of first runs from which the limits come."""
    stop_batch: bool = False
    """Whether no other camera is measured in a batch while it is out of control or due."""


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


class OfflineStation(StrictModel):
    """A station file as calibrations of existing data use it: it may leave out the devices."""

    format: Literal["starbench/station/1"]
    name: Name
    laboratory: Text | None = None
    operator: Text | None = None
    stage: StageConfig | None = None
    light: LightConfig | None = None
    camera: CameraConfig | None = None
    target: TargetConfig = TargetConfig()
    collimator: CollimatorConfig = CollimatorConfig()
    gimbal: GimbalConfig | None = None
    budget: BudgetConfig = BudgetConfig()
    expected: ExpectedConfig | None = None
    disk: DiskConfig = DiskConfig()
    messages: MessagesConfig = MessagesConfig()
    interlocks: InterlocksConfig = InterlocksConfig()
    ledger: LedgerConfig = LedgerConfig()
    limits: ResultLimits = ()
    check_standard: CheckStandardConfig | None = None
    simulation: Annotated[dict[str, Any], BeforeValidator(_plain_values)] | None = None


class Station(OfflineStation):
    """A station file with its devices."""

    stage: StageConfig
    light: LightConfig
    camera: CameraConfig

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
    def sees_simulated_bench(self) -> bool:
        """Whether a simulated camera looks from a simulated stage: else the views are not of the simulated world."""
        return all(
            any(port.startswith(SIMULATED_PREFIX) for port in device.ports)
            for device in (self.stage, self.camera)
        )

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
            self.camera, SimulatedEvk4Config | RecordedCameraConfig | PictureFolderConfig
        )


def load_station(name_or_path: str, settings: Mapping[str, str] | None = None) -> Located[Station]:
    """Read a station by its path, or a shipped one's name; ``settings`` replace values, YAML by path."""
    station = read_document(find_document(name_or_path, SHIPPED_STATIONS), Station, settings)
    use_descriptions(station)
    return station


def load_offline_station(name_or_path: str) -> Located[OfflineStation]:
    """Read what a station states beside its devices, as `load_station` finds it."""
    return read_document(find_document(name_or_path, SHIPPED_STATIONS), OfflineStation)
