"""The sections of a stage and of a light with driver ``text``: a description of their protocol, ports, scales.

A run folder keeps a copy of each description, which a run that is resumed or derived again reads.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Generic, Literal, TypeVar

from pydantic import AfterValidator, Field, PrivateAttr

from bench.record.run_folder import STATION_COPY
from bench.stations.placeholders import ToFillIn, not_zero
from bench.stations.sections import (
    AnyLight,
    AnyStage,
    AxisConfig,
    Hertz,
    PortName,
    SerialLine,
    differing,
    driver_axes,
)
from bench.stations.station_fields import Port, Serial
from bench.stations.text_descriptions import Described, LightProtocol, StageProtocol
from drivers.clock import Clock
from drivers.light import Light
from drivers.light.text import TextLight
from drivers.stage import Stage
from drivers.stage.text import TextAxis, TextStage
from drivers.wire_log import WireLog
from sequences.errors import DocumentFaults
from sequences.reader import Located, find_document, read_document
from sequences.schema import Axis
from sequences.strict_model import Form, Within
from sequences.tree import DocumentPath, Fault

SHIPPED_DESCRIPTIONS: Final = Path(__file__).parent / "descriptions"
PROTOCOL_COPIES: Final = {"stage": "protocol-stage.yaml", "light": "protocol-light.yaml"}
"""Byte-exact copies of the descriptions in a run folder, by section."""

D = TypeVar("D", bound=Described)


def find_description(name_or_path: str, folder: Path | None) -> Path:
    """Find a description by its shipped name or a path from ``folder`` (None: the cwd); the error lists the names."""
    path = Path(name_or_path)
    if folder is not None and (path.name != name_or_path or path.suffix):
        return folder / path
    return find_document(name_or_path, SHIPPED_DESCRIPTIONS)


class TextAxisConfig(AxisConfig):
    """One axis of a stage with a described protocol."""

    scale_key: ClassVar[str] = "counts_per_deg"
    address: Annotated[
        str, Field(max_length=20), Form(r"^[!-z|~]*$", "ASCII characters without blanks and braces")
    ] = ""
    """The controller's word for the axis: {address} of the description."""
    counts_per_deg: Annotated[
        float, AfterValidator(not_zero), Within(1e-6, 1e9, "counts/deg", either_sign=True), ToFillIn
    ]
    """Negative if the counter decreases; 1 if the controller counts in degrees."""
    encoder_tolerance_deg: Annotated[float, Within(1e-6, 5, "deg")] = 0.05


class _DescribedSection(SerialLine, Generic[D]):
    """What the sections of a stage and of a light share whose text protocol a file describes."""

    form: ClassVar[type[Any]]
    """Form of the description."""
    protocol: Annotated[str, Field(min_length=1, max_length=1000)]
    """Name of a shipped description, or path of a file, relative to the station file."""
    port: Port
    baudrate: Annotated[int, Within(50, 20_000_000, "Bd")] | None = None
    """Default: that of the description."""
    serial: Serial | None = None
    """Of the controller. Without it, any such device is accepted."""
    _read: Located[D] | None = PrivateAttr(default=None)

    @property
    def description(self) -> Located[D]:
        """The description; read from the working directory's point of view unless `use_descriptions` has read it."""
        if self._read is None:
            self.use(find_description(self.protocol, None))
        assert self._read is not None
        return self._read

    @property
    def described(self) -> D:
        """What the description says."""
        return self.description.value

    @property
    def device_names(self) -> tuple[str, ...]:
        """Maker and serial number."""
        return (f"{self.described.maker} {self.serial}",) if self.serial else ()

    def use(self, path: Path) -> None:
        """Read the description from a file."""
        self._read = read_document(path, self.form)

    def misfits(self) -> Iterator[tuple[DocumentPath, str]]:
        """Yield key and message of each fault of this section against its description."""
        if self.serial and self.described.serial is None:
            yield ("serial",), "the description has no query for a serial number."


class TextStageConfig(_DescribedSection[StageProtocol], AnyStage):
    """One to three rotary axes on a controller whose text protocol a file describes."""

    form = StageProtocol
    driver: Literal["text"]
    axes: Annotated[dict[Axis, TextAxisConfig], Field(min_length=1, max_length=3), differing("address")]

    def misfits(self) -> Iterator[tuple[DocumentPath, str]]:
        """See `_DescribedSection.misfits`."""
        protocol = self.described
        if len(self.axes) > 1 and not protocol.has_addresses:
            yield ("axes",), "this device has one axis: its moves name no {address}."
        for axis, config in self.axes.items():
            if protocol.has_addresses and not config.address:
                yield ("axes", axis), "address is missing; the description uses {address}."
            for key in protocol.untold(config.address):
                yield ("axes", axis), f"the reply of {key} has no value of the axis {config.address!r}."
        yield from super().misfits()

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Stage:
        """See `AnyStage.open_device`."""
        return TextStage.open(
            port(self.port),
            driver_axes(TextAxis, self.axes, port),
            self.described.for_driver(),
            serial=self.serial or "",
            **self.line(clock, wire_log),
        )


class TextLightConfig(_DescribedSection[LightProtocol], AnyLight):
    """A light whose text protocol a file describes."""

    form = LightProtocol
    driver: Literal["text"]
    frequency_range_hz: tuple[Hertz, Hertz] = (1.0, 1_000.0)
    sync_output: bool = True
    full_percent: Annotated[float, Within(0.01, 1000, "%")] = 100.0
    """Level of the light at level 100 %."""

    def misfits(self) -> Iterator[tuple[DocumentPath, str]]:
        """See `_DescribedSection.misfits`."""
        if self.sync_output and not self.described.has_sync:
            yield (), "this light has no sync output; write sync_output: false."
        yield from super().misfits()

    def open_device(self, port: PortName, *, clock: Clock, wire_log: WireLog | None) -> Light:
        """See `AnyLight.open_device`."""
        return TextLight.open(
            port(self.port),
            self.described.for_driver(),
            serial=self.serial or "",
            full_percent=self.full_percent,
            **self.line(clock, wire_log),
        )


def use_descriptions(station: Located[Any]) -> None:
    """Read the descriptions that a station file names, and check that they fit its sections."""
    faults: list[Fault] = []
    for name, section in _described_sections(station.value):
        try:
            faults += _use(station, name, section)
        except DocumentFaults as error:
            faults += error.faults
    if faults:
        raise DocumentFaults(faults, station.tree)


def description_documents(station: Any) -> dict[str, bytes]:
    """Return bytes by file name of the descriptions that a run folder keeps."""
    return {PROTOCOL_COPIES[name]: section.description.text for name, section in _described_sections(station)}


def _described_sections(station: Any) -> list[tuple[str, TextStageConfig | TextLightConfig]]:
    sections = [(name, getattr(station, name)) for name in PROTOCOL_COPIES]
    return [(name, part) for name, part in sections if isinstance(part, TextStageConfig | TextLightConfig)]


def _use(station: Located[Any], name: str, section: TextStageConfig | TextLightConfig) -> list[Fault]:
    """Read the description of one section; return the faults of the section against it."""
    path = _copy_in_run_folder(station, name)
    if path is None:
        folder = Path(station.file_at((name, "protocol"), "x")).parent
        path = find_description(section.protocol, folder)
        if not path.is_file():
            return [station.fault((name, "protocol"), f"there is no file {path}.")]
    section.use(path)
    return [station.fault((name, *place), what) for place, what in section.misfits()]


def _copy_in_run_folder(station: Located[Any], name: str) -> Path | None:
    """Return the run folder's copy of a description, if the station file is a run folder's copy too."""
    if station.folder is None or Path(station.file).name != STATION_COPY:
        return None
    copy = station.folder / PROTOCOL_COPIES[name]
    return copy if copy.is_file() else None
