"""Settings of a camera behind the Metavision HAL: biases, filters, region of interest, trigger input, monitoring.

A camera may lack some facilities of the HAL. Their getters then return None, and their values are left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from drivers.camera import CameraSettings
from drivers.camera.metavision_discovery import reason_of
from drivers.camera.recording import (
    BIASES,
    check_bias,
    connection_lost,
    refuse_filters,
    refuse_unknown_biases,
)
from drivers.errors import CameraSettingRefused

_NOT_MEASURED: Final = -1.0
"""OpenEB 5.1.1, ``imx636_tz_device.cpp``: temperature and illumination if the sensor does not end the measurement."""

_OFFSETS: Final = "IMX636"
"""The sensor whose biases are offsets from the factory values. Those of GenX320 and Gen3.1 are register values."""

_CONNECTION: Final = re.compile(
    r"libusb|\busb\b|connection|disconnected|no such device|i/o error", re.IGNORECASE
)
"""Words of the HAL's message when the camera has gone, whatever was asked of it."""


def read_biases(device: Any, *, where: str) -> dict[str, int]:
    """Read the biases as offsets from the factory value; empty if the camera cannot be asked."""
    facility = device.get_i_ll_biases()
    if facility is None:
        return {}
    with _refusal("read its biases", where):
        return {name: int(value) for name, value in facility.get_all_biases().items() if name in BIASES}


def factory_biases(device: Any, sensor: str, *, where: str) -> dict[str, int]:
    """Return the biases of a camera that was just opened, which resets it; empty if its factory values are 0."""
    return {} if sensor == _OFFSETS else read_biases(device, where=where)


def bias_ranges(device: Any, *, where: str) -> dict[str, tuple[int, int]]:
    """Return the lowest and highest value of each bias that the camera has."""
    facility = device.get_i_ll_biases()
    if facility is None:
        return {}
    with _refusal("list its biases", where):
        present = facility.get_all_biases()
        known = [name for name in BIASES if name in present]
        return {name: tuple(facility.get_bias_info(name).get_bias_range()) for name in known}


def read_filters(device: Any, hal: Any, *, where: str) -> dict[str, bool]:
    """Read which of the on-chip filters that the camera has are on."""
    filters = {}
    with _refusal("read its filters", where):
        if (antiflicker := device.get_i_antiflicker_module()) is not None:
            filters["afk"] = bool(antiflicker.is_enabled())
        if (trail := device.get_i_event_trail_filter_module()) is not None:
            on = bool(trail.is_enabled())
            kind = trail.get_type()
            only_trail = kind == hal.I_EventTrailFilterModule.Type.TRAIL
            filters["stc"] = on and not only_trail
            filters["trail"] = on and kind != hal.I_EventTrailFilterModule.Type.STC_KEEP_TRAIL
        if (controller := device.get_i_erc_module()) is not None:
            filters["erc"] = bool(controller.is_enabled())
    return filters


def read_monitoring(device: Any, call: str) -> float | None:
    """Read a number of the monitoring facility, in its method's unit; None if closed, not measured, or failed."""
    monitoring = device.get_i_monitoring() if device is not None else None
    if monitoring is None:
        return None
    try:
        value = float(getattr(monitoring, call)())
    except RuntimeError:  # the HAL's sign of "not implemented by this camera"
        return None
    return None if value == _NOT_MEASURED else value


def apply_settings(
    device: Any, hal: Any, settings: CameraSettings, factory: Mapping[str, int], *, where: str
) -> CameraSettings:
    """Change all settings, switch the filters off, and read everything back; refuse the settings if it differs.

    ``factory`` holds the values of biases that the settings do not name, from `factory_biases`; 0 where it has none.
    The region of interest returned is the wanted one, as the HAL cannot read it back.
    """
    _set_biases(device, settings, factory, where)
    for getter in ("get_i_antiflicker_module", "get_i_event_trail_filter_module", "get_i_erc_module"):
        if (facility := getattr(device, getter)()) is not None:
            with _refusal(f"switch off {getter.removeprefix('get_i_')}", where):
                facility.enable(False)
    _set_roi(device, hal, settings.roi, where)
    refuse_filters(read_filters(device, hal, where=where), where)
    trigger_in = _set_trigger_in(device, hal, settings.trigger_in, where)
    return CameraSettings(read_biases(device, where=where), trigger_in, settings.roi)


def _set_biases(device: Any, settings: CameraSettings, factory: Mapping[str, int], where: str) -> None:
    facility = device.get_i_ll_biases()
    if facility is None:
        if any(settings.biases.values()):
            raise CameraSettingRefused(
                "The camera has no biases.", where=where, remedy="Leave the biases out of the station file."
            )
        return
    ranges = bias_ranges(device, where=where)
    refuse_unknown_biases(settings, list(ranges), where)
    for name, (lowest, highest) in ranges.items():
        value = settings.biases.get(name, factory.get(name, 0))
        check_bias(name, value, lowest, highest, where)
        with _refusal(f"set {name} to {value}", where):
            taken = facility.set(name, value)
            held = int(facility.get(name))
        if not taken or held != value:
            raise CameraSettingRefused(
                f"The bias {name} was set to {value}, but reads back {held}.",
                where=where,
                remedy="Reconnect the camera, or use another value.",
            )


def _set_roi(device: Any, hal: Any, roi: tuple[int, int, int, int] | None, where: str) -> None:
    """Let only a window of the sensor send events, or all of it. The HAL cannot read the window back."""
    facility = device.get_i_roi()
    if facility is None:
        if roi is not None:
            raise CameraSettingRefused(
                "The camera has no region of interest.",
                where=where,
                remedy="Leave roi out of the station file.",
            )
        return
    with _refusal("set its region of interest", where):
        taken = True
        if roi is not None:
            x, y, width, height = roi
            geometry = device.get_i_geometry()
            if x + width > geometry.get_width() or y + height > geometry.get_height():
                raise CameraSettingRefused(
                    f"The region of interest {roi} reaches beyond the sensor of {geometry.get_width()} x "
                    f"{geometry.get_height()} px.",
                    where=where,
                    remedy="Correct roi in the station file.",
                )
            taken = facility.set_mode(hal.I_ROI.Mode.ROI) is not False
            taken &= facility.set_window(hal.I_ROI.Window(x, y, width, height)) is not False
        taken &= facility.enable(roi is not None) is not False
    if not taken:
        raise CameraSettingRefused(
            f"The camera did not accept the region of interest {roi or 'off'}.",
            where=where,
            remedy="Reconnect the camera.",
        )


def _set_trigger_in(device: Any, hal: Any, on: bool, where: str) -> bool:
    """Switch the main trigger input; return what was read back."""
    facility = device.get_i_trigger_in()
    if facility is None:
        if on:
            raise CameraSettingRefused(
                "The camera has no trigger input, so the light's phase cannot be recorded.",
                where=where,
                remedy="Use a camera with a trigger input, or switch trigger_in off in the station file.",
            )
        return False
    channel = hal.I_TriggerIn.Channel.MAIN
    switch: Callable[[Any], Any] = facility.enable if on else facility.disable
    with _refusal("switch its trigger input", where):
        switch(channel)
        is_on = bool(facility.is_enabled(channel))
    if is_on != on:
        raise CameraSettingRefused(
            f"The trigger input stays {'on' if is_on else 'off'}.",
            where=where,
            remedy="Reconnect the camera.",
        )
    return is_on


@contextmanager
def _refusal(doing: str, where: str) -> Iterator[None]:
    """Convert the HAL's RuntimeError to CameraLost if the connection has failed, else to CameraSettingRefused."""
    try:
        yield
    except RuntimeError as error:
        reason = reason_of(error)
        if _CONNECTION.search(str(error)):
            raise connection_lost(f"{reason}; it could not {doing}", where) from error
        raise CameraSettingRefused(
            f"The camera refused to {doing} ({reason}).",
            where=where,
            remedy="Correct this setting, or reconnect the camera.",
        ) from error
