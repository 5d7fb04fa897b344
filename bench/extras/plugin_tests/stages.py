"""The contract tests of a stage: what every driver of a stage must do, with any device."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

import pytest

from bench.extras.plugin_tests.rig import (
    SPOILT,
    ConnectedContract,
    LibraryStage,
    Rig,
    SimulatedLight,
    SimulatedStage,
    WithAngles,
    fails_in_time,
    rig,
    station_of,
)
from bench.stations.station import Station
from drivers.clock import SystemClock
from drivers.errors import (
    DriverError,
    MoveFailed,
    NotHomed,
    OutsideLimits,
    PortBusy,
    PortLost,
    ReplyError,
    SettingRefused,
    WrongDevice,
)
from drivers.light import Light, LightSettings
from drivers.stage import Stage

Opener = Callable[..., Any]
"""Opens the device of a contract; keywords are keys of its section with other values."""


class ContractClock(SystemClock):
    """The system's clock, as a run's."""

    def utc_now(self) -> datetime:
        """Return the time of the system.

        Returns
        -------
        datetime
            In UTC.
        """
        return datetime.now(UTC)


class DeviceTime:
    """Time of a simulated device, s. While it is held, only the test moves it on: a busy computer changes nothing."""

    def __init__(self) -> None:
        self._behind_s = 0.0
        self._held_s: float | None = None

    def __call__(self) -> float:
        """Return the time, s."""
        held_s = self._held_s
        return time.monotonic() - self._behind_s if held_s is None else held_s

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the time during the block.

        Yields
        ------
        None
            While it is held.
        """
        self._held_s = self()
        yield
        self._behind_s = time.monotonic() - self._held_s
        self._held_s = None

    def step(self) -> None:
        """Let the other threads work, then let 10 ms pass."""
        time.sleep(0.005)
        assert self._held_s is not None
        self._held_s += 0.01


class RealTime(DeviceTime):
    """The system's time, for a device whose time no test can hold."""

    @contextmanager
    def held(self) -> Iterator[None]:
        """Let the time pass.

        Yields
        ------
        None
            At once.
        """
        yield

    def step(self) -> None:
        """Let 5 ms pass."""
        time.sleep(0.005)


@contextmanager
def _unmoved(simulated: WithAngles, within_deg: float = 1e-6) -> Iterator[None]:
    """Check that no axis has moved at the end of the block."""
    before = dict(simulated.angles_deg())
    yield
    assert dict(simulated.angles_deg()) == pytest.approx(before, abs=within_deg)


def _opened(kind: Literal["stage", "light"], station: Station) -> Any:
    clock: Any = ContractClock()
    section = station.stage if kind == "stage" else station.light
    return section.open_device(str, clock=clock, wire_log=None)


class SerialContract:
    """What the contracts of stages and of lights share.

    Attributes
    ----------
    kind
        Kind of the section: ``stage`` or ``light``.
    section
        The section of the station file; ``PORT`` stands in place of the port.
    other_serial
        A serial number that the simulated device does not have; empty if the device has none.
    """

    kind: ClassVar[Literal["stage", "light"]]
    section: ClassVar[Mapping[str, Any]]
    other_serial: ClassVar[str] = ""

    def device(self, clock: Callable[[], float]) -> Any:
        """Return a simulated device, fresh from power-up. Write it by the maker's manual, not by the driver.

        Parameters
        ----------
        clock
            Returns the time in seconds.

        Returns
        -------
        SimulatedStage or SimulatedLight
            The device.

        Raises
        ------
        NotImplementedError
            If a subclass does not write it.
        """
        raise NotImplementedError

    @pytest.fixture
    def device_time(self) -> DeviceTime:
        """The time of the simulated device."""
        return DeviceTime()

    @pytest.fixture
    def simulated(self, device_time: DeviceTime) -> Any:
        """The simulated device."""
        return self.device(device_time)

    @pytest.fixture
    def rig(self, simulated: Any, tmp_path: Path) -> Iterator[Rig]:
        """The device on its port."""
        with rig(self.kind, self.section, simulated, tmp_path) as made:
            yield made

    @pytest.fixture
    def opens(self, rig: Rig) -> Opener:
        """Opens the device, with changed keys of its section."""
        return lambda **changes: _opened(self.kind, rig.station(changes))

    def test_a_stranger_on_the_port_is_refused(self, rig: Rig, opens: Opener) -> None:
        """A stranger on the port is refused."""
        rig.spoil("stranger", count=None)
        fails_in_time(opens)


class AnyStageContract:
    """What the contracts of stages share, on lines of bytes and behind a maker's library.

    Attributes
    ----------
    section
        The section of the station file; ``PORT`` stands in place of what names the simulated stage.
    other_serial
        A serial number that the simulated stage does not have; empty if it has none.
    tolerance_deg
        Largest difference between a reading and the simulated axis, in degrees.
    """

    section: ClassVar[Mapping[str, Any]]
    other_serial: ClassVar[str] = ""
    tolerance_deg: ClassVar[float] = 0.01

    @pytest.fixture
    def stage(self, opens: Opener) -> Iterator[Stage]:
        """The open stage."""
        with closing(opens()) as stage:
            yield stage

    @pytest.fixture
    def homed(self, stage: Stage) -> Stage:
        """The open stage with its reference."""
        stage.home()
        return stage

    def test_opening_and_closing_move_nothing(self, opens: Opener, simulated: WithAngles) -> None:
        """Opening and closing move nothing."""
        with _unmoved(simulated):
            for _ in range(2):
                opens().close()

    def test_the_axes_are_those_of_the_section(self, stage: Stage) -> None:
        """The axes are those of the section."""
        names = list(self.section["axes"])
        assert list(stage.axes) == names
        assert [axis.name for axis in stage.identify()] == names
        assert list(stage.limits) == names

    def test_without_a_reference_nothing_moves(self, stage: Stage, simulated: WithAngles) -> None:
        """Without a reference nothing moves."""
        if stage.is_homed():
            pytest.skip("this device knows its position from power-up on")
        with _unmoved(simulated):
            fails_in_time(lambda: stage.move_to({stage.axes[0]: 1.0}), NotHomed)

    def test_homing_and_moves_end_where_the_readings_say(self, homed: Stage, simulated: WithAngles) -> None:
        """Homing and moves end where the readings say."""
        assert homed.is_homed()
        for share in (0.5, -0.7, 0.0):
            goal = {name: round(_at(homed, name, share), 2) for name in homed.axes}
            homed.move_to(goal)
            assert dict(homed.position_deg()) == pytest.approx(goal, abs=self.tolerance_deg)
            assert dict(simulated.angles_deg()) == pytest.approx(goal, abs=self.tolerance_deg)
        assert list(homed.faults()) == []

    def test_a_target_outside_the_limits_moves_nothing(self, homed: Stage, simulated: WithAngles) -> None:
        """A target outside the limits moves nothing."""
        beyond = {name: homed.limits[name].highest_deg + 0.5 for name in homed.axes}
        with _unmoved(simulated):
            for name, angle_deg in {**beyond, "no such axis": 0.0}.items():
                fails_in_time(partial(homed.move_to, {name: angle_deg}), OutsideLimits)

    def test_a_stop_from_another_thread_ends_a_move(
        self, homed: Stage, simulated: WithAngles, device_time: DeviceTime
    ) -> None:
        """A stop from another thread ends a move."""
        name = homed.axes[0]
        homed.move_to({name: _at(homed, name, -1.0)})
        start = simulated.angles_deg()[name]
        with ThreadPoolExecutor() as pool, device_time.held():
            move = pool.submit(homed.move_to, {name: _at(homed, name, 1.0)})
            while abs(simulated.angles_deg()[name] - start) < 1e-3 and not move.done():
                device_time.step()
            stop = pool.submit(homed.stop)
            while not (move.done() and stop.done()):
                device_time.step()
            rest = simulated.angles_deg()[name]
        stop.result()
        assert type(move.exception()) is MoveFailed
        time.sleep(0.2)
        assert simulated.angles_deg()[name] == pytest.approx(rest, abs=0.05)
        assert rest < _at(homed, name, 1.0) - 0.1, "the stop came too late: the axis was at its target"

    def test_another_serial_number_is_refused(self, opens: Opener, simulated: WithAngles) -> None:
        """Another serial number is refused."""
        if not self.other_serial:
            pytest.skip("this device has no serial number")
        with _unmoved(simulated):
            fails_in_time(lambda: opens(serial=self.other_serial), WrongDevice)


class StageContract(AnyStageContract, SerialContract):
    """Derive from this class, name it ``Test...``, and give ``section`` and ``device``, a `SimulatedStage`.

    All axes of the section need limits that contain 0.
    """

    kind = "stage"

    def test_a_second_opening_is_refused(self, opens: Opener, stage: Stage) -> None:
        """A second opening is refused."""
        fails_in_time(opens, PortBusy)
        assert stage.position_deg()

    @pytest.mark.parametrize("kind", SPOILT)
    def test_one_spoilt_message_never_becomes_a_wrong_position(
        self, rig: Rig, homed: Stage, simulated: SimulatedStage, kind: str
    ) -> None:
        """One spoilt message never becomes a wrong position."""
        homed.move_to({name: round(_at(homed, name, 0.5), 2) for name in homed.axes})
        rig.spoil(kind)
        positions = []
        for _ in range(3):
            with suppress(ReplyError):
                positions.append(dict(homed.position_deg()))
        assert positions, "the line must be usable again after one spoilt message"
        for position in positions:
            assert position == pytest.approx(dict(simulated.angles_deg()), abs=self.tolerance_deg)

    def test_a_silent_device_is_an_error_in_bounded_time(self, rig: Rig, homed: Stage) -> None:
        """A silent device is an error in bounded time."""
        rig.spoil("lost", count=None)
        fails_in_time(homed.position_deg, ReplyError)
        fails_in_time(homed.stop)

    def test_a_pulled_cable_is_a_lost_port_and_nothing_moves_when_it_is_back(
        self, rig: Rig, opens: Opener, homed: Stage, simulated: SimulatedStage
    ) -> None:
        """A pulled cable is a lost port and nothing moves when it is back."""
        rig.plugged.unplug()
        fails_in_time(homed.position_deg, PortLost)
        homed.close()
        rig.plugged.replug()
        with _unmoved(simulated, 1e-4), closing(opens()) as again:
            again.identify()


class LibraryStageContract(ConnectedContract, AnyStageContract):
    """The contract of a stage behind a maker's library. Derive, name it ``Test...``, give ``section``, ``connected``.

    All axes of the section need limits that contain 0.
    """

    @pytest.fixture
    def device_time(self) -> DeviceTime:
        """The system's time, which nobody can hold."""
        return RealTime()

    @pytest.fixture
    def opens(self, simulated: LibraryStage) -> Opener:
        """Opens the stage, with changed keys of its section."""
        return lambda **changes: _opened(
            "stage", station_of("stage", self.section, simulated.address, changes)
        )

    def test_a_lost_device_is_an_error_in_bounded_time(
        self, opens: Opener, homed: Stage, simulated: LibraryStage
    ) -> None:
        """A lost device is an error in bounded time, for each of its methods and for opening it."""
        simulated.unplug()
        for act in (
            homed.position_deg,
            homed.stop,
            homed.home,
            lambda: homed.move_to({homed.axes[0]: 1.0}),
            opens,
        ):
            fails_in_time(act)


def _at(stage: Stage, name: str, share: float) -> float:
    """Return an angle inside the limits: 1 is the highest, -1 the lowest, less a little."""
    limits = stage.limits[name]
    return 0.99 * share * (limits.highest_deg if share > 0 else -limits.lowest_deg)


class LightContract(SerialContract):
    """Derive from this class, name it ``Test...``, and give ``section`` and ``device``, a `SimulatedLight`.

    Attributes
    ----------
    flicker
        Settings that the light can make.
    impossible
        Settings that it cannot make.
    """

    kind = "light"
    flicker: ClassVar[LightSettings] = LightSettings("square", 50.0, 50.0, 0.0, 3.0)
    impossible: ClassVar[LightSettings] = LightSettings("square", 1e12, 50.0, 0.0, 3.0)

    @pytest.fixture
    def light(self, opens: Opener) -> Iterator[Light]:
        """The open light."""
        with closing(opens()) as light:
            yield light

    def test_settings_are_read_back_and_the_light_stays_dark(
        self, light: Light, simulated: SimulatedLight
    ) -> None:
        """Settings are read back and the light stays dark."""
        assert light.identify().maker
        got = light.apply(self.flicker)
        assert got.waveform == self.flicker.waveform
        assert got.frequency_hz == pytest.approx(self.flicker.frequency_hz, rel=1e-3)
        assert got.duty_percent == pytest.approx(self.flicker.duty_percent, rel=1e-2)
        assert got.high_v == pytest.approx(self.flicker.high_v, rel=1e-2)
        assert light.read() == got
        assert not light.is_on()
        assert not simulated.is_lit()

    def test_on_and_off_are_what_the_lamp_does(self, light: Light, simulated: SimulatedLight) -> None:
        """On and off are what the lamp does."""
        light.apply(self.flicker)
        light.on()
        assert light.is_on()
        assert simulated.is_lit()
        assert list(light.faults()) == []
        light.off()
        assert not light.is_on()
        assert not simulated.is_lit()

    def test_what_is_impossible_is_refused_and_the_light_still_works(self, light: Light) -> None:
        """What is impossible is refused and the light still works."""
        fails_in_time(lambda: light.apply(self.impossible), SettingRefused)
        light.apply(self.flicker)

    def test_opening_and_closing_switch_nothing(self, opens: Opener, simulated: SimulatedLight) -> None:
        """Opening and closing switch nothing."""
        with closing(opens()) as light:
            assert not simulated.is_lit()
            light.apply(self.flicker)
            light.on()
        assert simulated.is_lit()
        with closing(opens()) as again:
            assert simulated.is_lit()
            assert again.is_on()
            again.off()
        assert not simulated.is_lit()

    def test_another_serial_number_is_refused(self, opens: Opener) -> None:
        """Another serial number is refused."""
        if not self.other_serial:
            pytest.skip("this device has no serial number")
        fails_in_time(lambda: opens(serial=self.other_serial), WrongDevice)

    def test_a_second_opening_is_refused(self, opens: Opener, light: Light) -> None:
        """A second opening is refused."""
        fails_in_time(opens, PortBusy)
        assert light.is_on() is False

    @pytest.mark.parametrize("kind", SPOILT)
    def test_one_spoilt_message_never_becomes_a_wrong_setting(
        self, rig: Rig, light: Light, simulated: SimulatedLight, kind: str
    ) -> None:
        """One spoilt message never becomes a wrong setting."""
        light.apply(self.flicker)
        light.on()
        rig.spoil(kind)
        frequencies_hz = []
        for _ in range(3):
            with suppress(ReplyError):
                frequencies_hz.append(light.read().frequency_hz)
        assert frequencies_hz, "the line must be usable again after one spoilt message"
        assert frequencies_hz == pytest.approx([self.flicker.frequency_hz] * len(frequencies_hz), rel=1e-3)
        rig.spoil(kind)
        try:
            light.off()
        except DriverError:
            light.off()
        assert not simulated.is_lit()

    def test_a_silent_device_is_an_error_in_bounded_time(self, rig: Rig, light: Light) -> None:
        """A silent device is an error in bounded time."""
        rig.spoil("lost", count=None)
        fails_in_time(light.is_on, ReplyError)
        fails_in_time(light.off)

    def test_a_pulled_cable_is_a_lost_port(self, rig: Rig, light: Light) -> None:
        """A pulled cable is a lost port."""
        rig.plugged.unplug()
        fails_in_time(light.is_on, PortLost)
