"""Asks stage and light for what a new station file must state: serial numbers, scale, limits and dialect.

Only questions are sent: nothing moves, nothing is switched, nothing is set. The driver is the one that the operator
chose; a port on which no such device answers is tried for the other one. Controllers whose messages are no text are
asked only at ports that the system calls by their maker, and a GRBL board, which opening its port may restart, only
after the operator has agreed (`RESTARTS`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import Final

from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.light.gardasoft import IDENTITY, GardasoftLight, RtLine
from drivers.light.scpi import ScpiLight
from drivers.light.scpi_dialects import DialectName
from drivers.serial_port import SerialPort
from drivers.stage.esp import EspStage
from drivers.stage.grbl import GrblStage
from drivers.stage.grbl_controller import GrblController
from drivers.stage.thorlabs import ThorlabsStage
from drivers.stage.thorlabs_controller import ThorlabsController
from drivers.stage.ximc import XimcController, XimcStage
from drivers.stage.zaber import ZaberChain, ZaberStage
from drivers.text_line import ScpiLine

AXES: Final = ("pan", "tilt", "roll")
"""Names of axes in the order in which a new station file gives them to the devices of a chain."""
WANTED_DEG: Final = 12.0
"""Limit of an axis in a new station file, degrees, if its controller allows it: the field of a usual collimator."""
GRBL_ZERO_DEG: Final = 15.0
"""Angle at the switches of a board in a new station file, degrees: its machine positions lie below it."""
RESTARTS: Final = frozenset({"grbl"})
"""Drivers whose controller may restart when its port is opened: it then loses its position."""
NAMED_BY_MAKER: Final[Mapping[str, str]] = {"ximc": "XIMC", "thorlabs_apt": "Thorlabs"}
"""A word in the system's name of the ports of controllers with messages that are no text."""
_SCALE: Final = 100  # First of GRBL's settings of steps a degree
_TRAVEL: Final = 130
"""Numbers of the settings of GRBL's first axis: steps per unit, travel in units."""
_NUMBERED: Final = ("RIGOL", "335")
"""Beginnings of makers and models that number their channels."""


@dataclass(frozen=True)
class AskedAxis:
    """What the controller of an axis states."""

    name: str
    device: int  # Address of the device in a chain; or the axis number, where one controller has several axes
    serial: str
    microsteps_per_deg: float | None  # None if the controller does not know it; 1 if it counts in degrees
    limits_microsteps: tuple[float, float] | None = None
    port: str = ""  # Of a controller with one axis
    model: str = ""  # As the controller tells it; may be empty

    def limits_deg(self) -> tuple[float, float]:
        """Return limits within those of the controller, degrees; the wanted ones if its scale is not known."""
        if self.limits_microsteps is None or self.microsteps_per_deg is None:
            return -WANTED_DEG, WANTED_DEG
        low, high = (steps / self.microsteps_per_deg for steps in self.limits_microsteps)
        return round(max(low, -WANTED_DEG), 4), round(min(high, WANTED_DEG), 4)

    @property
    def remark(self) -> str:
        """What to check, as a comment of the file; empty if all is known."""
        if self.limits_microsteps is None or self.microsteps_per_deg is not None:
            return ""
        low, high = self.limits_microsteps
        return f"the controller allows {low:.0f} to {high:.0f} microsteps: keep limits_deg within that"


@dataclass(frozen=True)
class AskedStage:
    """A stage that answered."""

    port: str
    axes: Sequence[AskedAxis]

    @property
    def ports(self) -> set[str]:
        """The ports of its controllers."""
        return {axis.port or self.port for axis in self.axes}

    @property
    def what(self) -> str:
        """The stage in words, for the operator."""
        axes = [f"{axis.name} (serial {axis.serial})" if axis.serial else axis.name for axis in self.axes]
        return f"a stage with {' and '.join(axes)}"


@dataclass(frozen=True)
class AskedLight:
    """A light that answered."""

    port: str
    what: str  # Maker and model
    serial: str  # Empty if it has none
    dialect: DialectName | None = None  # Of a generator
    model: str = ""  # Of a controller that is recognised by it


def ask_stage(driver: str, ports: Sequence[str], clock: Clock) -> AskedStage | None:
    """Return the first stage that answers on one of the ports; None if none does, or the driver cannot ask."""
    ask, alone = _STAGES.get(driver), _CONTROLLERS.get(driver)
    axes: list[AskedAxis] = []
    for port in ports:
        with suppress(DriverError):  # another device, or none
            if ask is not None and (axes := ask(port, clock)):
                return AskedStage(port, axes)
            if alone is not None and len(axes) < len(AXES):
                axes.append(alone(port, AXES[len(axes)], clock))
    return AskedStage(axes[0].port, axes) if axes else None


def ask_light(driver: str, ports: Sequence[str], clock: Clock) -> AskedLight | None:
    """Return the first light that answers on one of the ports; None if none does, or the driver cannot ask."""
    ask = _LIGHTS.get(driver)
    if ask is not None:
        for port in ports:
            with suppress(DriverError):  # another device, or none
                return ask(port, clock)
    return None


def dialect_of(maker: str, model: str) -> DialectName:
    """Return the dialect of a generator by its answer to ``*IDN?``.

    >>> dialect_of("Rigol Technologies", "DG1022Z"), dialect_of("Agilent Technologies", "33522B")
    ('numbered', 'numbered')
    """
    if maker.upper().startswith("SIGLENT"):
        return "siglent"
    return "numbered" if maker.upper().startswith(_NUMBERED) or model.startswith(_NUMBERED) else "keysight"


def _zaber_axes(port: str, clock: Clock) -> list[AskedAxis]:
    """Return the devices of a chain, from address 1 on, one axis each."""
    axes = []
    with closing(SerialPort(port, ZaberStage.SETTINGS)) as line:
        chain = ZaberChain(line, range(1, len(AXES) + 1), clock=clock)
        for device, name in enumerate(AXES, start=1):
            try:
                serial = chain.query(device, 0, "get system.serial", strict=False).data
            except DriverError:
                break  # the end of the chain
            turn, *limits = (
                chain.parse_integer(chain.query(device, 1, f"get {setting}", strict=False).data)
                for setting in ("limit.cycle.dist", "limit.min", "limit.max")
            )
            scale = turn / 360.0 if turn else None
            axes.append(AskedAxis(name, device, serial, scale, (limits[0], limits[1])))
    return axes


def _esp_axes(port: str, clock: Clock) -> list[AskedAxis]:
    """Return the axes of an ESP controller that have a stage, with their limits; they count in degrees."""
    axes = []
    with closing(SerialPort(port, EspStage.SETTINGS)) as line:
        link = EspStage.line(line, clock)
        for number, name in enumerate(AXES, start=1):
            try:
                serial = link.query(f"{number}ID?").partition(",")[2].strip()
                low, high = (link.query_number(f"{number}{limit}?") for limit in ("SL", "SR"))
            except DriverError:
                break  # no stage at this number
            if serial:
                axes.append(AskedAxis(name, number, serial, 1.0, (low, high)))
    return axes


def _grbl_axes(port: str, clock: Clock) -> list[AskedAxis]:
    """Return pan and tilt of a board, X and Y, with the scales and the travel that it has stored."""
    with closing(SerialPort(port, GrblStage.SETTINGS)) as line:
        board = GrblController(line, clock=clock)
        name, settings = board.query_build_info()[1], board.query_settings()
    axes = []
    for at, axis in enumerate(AXES[:2]):
        steps, travel_deg = (settings.get(first + at) for first in (_SCALE, _TRAVEL))
        if steps and travel_deg:
            limits = (steps * (GRBL_ZERO_DEG - travel_deg), steps * GRBL_ZERO_DEG)
            axes.append(AskedAxis(axis, at, name, steps, limits))
    return axes


def _ximc_axis(port: str, name: str, clock: Clock) -> AskedAxis:
    with closing(SerialPort(port, XimcStage.SETTINGS)) as line:
        return AskedAxis(name, 1, XimcController(line, clock=clock).serial, None, port=port)


def _thorlabs_axis(port: str, name: str, clock: Clock) -> AskedAxis:
    with closing(SerialPort(port, ThorlabsStage.SETTINGS)) as line:
        controller = ThorlabsController(line, clock=clock)
        information, scale = controller.read_information(), controller.family.counts_per_deg or None
    return AskedAxis(name, 1, information.serial, scale, port=port, model=information.model)


def _generator(port: str, clock: Clock) -> AskedLight:
    with closing(SerialPort(port, ScpiLight.SETTINGS)) as line:
        maker, model, serial, _ = ScpiLine(line, clock=clock).identity
    return AskedLight(port, f"{maker} {model}", "" if serial == "0" else serial, dialect_of(maker, model))


def _strobe_controller(port: str, clock: Clock) -> AskedLight:
    with closing(SerialPort(port, GardasoftLight.SETTINGS)) as line:
        text = RtLine(line, clock=clock).identity_text
    identity = IDENTITY.fullmatch(text)
    model = identity[1] if identity else text
    return AskedLight(port, f"Gardasoft {model}", "", model=model)


_STAGES: Final[Mapping[str, Callable[[str, Clock], list[AskedAxis]]]] = {
    "zaber_ascii": _zaber_axes,
    "esp30x": _esp_axes,
    "grbl": _grbl_axes,
}
_CONTROLLERS: Final[Mapping[str, Callable[[str, str, Clock], AskedAxis]]] = {
    "ximc": _ximc_axis,
    "thorlabs_apt": _thorlabs_axis,
}
_LIGHTS: Final[Mapping[str, Callable[[str, Clock], AskedLight]]] = {
    "scpi": _generator,
    "gardasoft": _strobe_controller,
}
