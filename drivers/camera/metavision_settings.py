"""Settings of a camera behind the Metavision HAL: biases, filters, region, trigger input, monitoring.

A camera lacks some facilities: their getters then return None, and what they would tell is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from drivers.camera import CameraSettings
from drivers.errors import CameraSettingRefused

BIASES: Final = ("bias_diff_on", "bias_diff_off", "bias_fo", "bias_hpf", "bias_refr")
"""Those that CameraSettings may name; ``bias_diff`` is the reference of two others and stays."""


def read_biases(device: Any, *, where: str) -> dict[str, int]:
    """Biases as offsets from the factory value; empty where the camera does not tell them."""
    facility = device.get_i_ll_biases()
    if facility is None:
        return {}
    with _refusal("read its biases", where):
        return {name: int(value) for name, value in facility.get_all_biases().items() if name in BIASES}


def read_filters(device: Any, hal: Any, *, where: str) -> dict[str, bool]:
    """Filters that the camera has, and whether each is on."""
    found = {}
    with _refusal("read its filters", where):
        if (antiflicker := device.get_i_antiflicker_module()) is not None:
            found["afk"] = bool(antiflicker.is_enabled())
        if (trail := device.get_i_event_trail_filter_module()) is not None:
            on = bool(trail.is_enabled())
            kind = trail.get_type()
            only_trail = kind == hal.I_EventTrailFilterModule.Type.TRAIL
            found["stc"] = on and not only_trail
            found["trail"] = on and kind != hal.I_EventTrailFilterModule.Type.STC_KEEP_TRAIL
        if (controller := device.get_i_erc_module()) is not None:
            found["erc"] = bool(controller.is_enabled())
    return found


def read_monitoring(device: Any, call: str) -> float | None:
    """One number of the monitoring facility; None where the camera does not measure it."""
    monitoring = device.get_i_monitoring() if device is not None else None
    if monitoring is None:
        return None
    try:
        return float(getattr(monitoring, call)())
    except RuntimeError:  # how the HAL says "not implemented by this camera"
        return None


def apply_settings(device: Any, hal: Any, settings: CameraSettings, *, where: str) -> CameraSettings:
    """Set everything and return what was read back. Raises CameraSettingRefused."""
    _set_biases(device, settings.biases, where)
    for getter in ("get_i_antiflicker_module", "get_i_event_trail_filter_module", "get_i_erc_module"):
        if (facility := getattr(device, getter)()) is not None:
            with _refusal(f"switch off {getter.removeprefix('get_i_')}", where):
                facility.enable(False)
    _set_roi(device, hal, settings.roi, where)
    if left_on := [name for name, on in read_filters(device, hal, where=where).items() if on]:
        raise CameraSettingRefused(
            f"Its filter {', '.join(left_on)} stays on.",
            where=where,
            remedy="A filter falsifies the recording: reconnect the camera.",
        )
    trigger_in = _set_trigger_in(device, hal, settings.trigger_in, where)
    return CameraSettings(read_biases(device, where=where), trigger_in, settings.roi)


def _set_biases(device: Any, wanted: Mapping[str, int], where: str) -> None:
    facility = device.get_i_ll_biases()
    if facility is None:
        if any(wanted.values()):
            raise CameraSettingRefused(
                "It has no biases to set.", where=where, remedy="Leave the biases out of the station file."
            )
        return
    with _refusal("tell its biases", where):
        present = facility.get_all_biases()
        known = [name for name in BIASES if name in present]
        ranges = {name: facility.get_bias_info(name).get_bias_range() for name in known}
    if unknown := sorted(set(wanted) - set(known)):
        raise CameraSettingRefused(
            f"It has no bias {', '.join(unknown)}.",
            where=where,
            remedy=f"Biases of this camera: {', '.join(known)}.",
        )
    for name in known:
        value = wanted.get(name, 0)
        lowest, highest = ranges[name]
        if not lowest <= value <= highest:
            raise CameraSettingRefused(
                f"It takes {name} from {lowest} to {highest}, not {value}.",
                where=where,
                remedy="Correct the bias in the station file.",
            )
        with _refusal(f"set {name} to {value}", where):
            taken = facility.set(name, value)
            held = int(facility.get(name))
        if not taken or held != value:
            raise CameraSettingRefused(
                f"{name} was set to {value}, but reads back {held}.",
                where=where,
                remedy="Reconnect the camera, or use another value.",
            )


def _set_roi(device: Any, hal: Any, roi: tuple[int, int, int, int] | None, where: str) -> None:
    """Let only a window of the sensor send events, or all of it. The HAL cannot be asked for the window it has."""
    facility = device.get_i_roi()
    if facility is None:
        if roi is not None:
            raise CameraSettingRefused(
                "It has no region of interest.", where=where, remedy="Leave roi out of the station file."
            )
        return
    with _refusal("set its region of interest", where):
        taken = True
        if roi is not None:
            x, y, width, height = roi
            geometry = device.get_i_geometry()
            if x + width > geometry.get_width() or y + height > geometry.get_height():
                raise CameraSettingRefused(
                    f"The region of interest {roi} reaches beyond its {geometry.get_width()} x "
                    f"{geometry.get_height()} px.",
                    where=where,
                    remedy="Correct roi in the station file.",
                )
            taken = facility.set_mode(hal.I_ROI.Mode.ROI) is not False
            taken &= facility.set_window(hal.I_ROI.Window(x, y, width, height)) is not False
        taken &= facility.enable(roi is not None) is not False
    if not taken:
        raise CameraSettingRefused(
            f"It did not take the region of interest {roi or 'off'}.",
            where=where,
            remedy="Reconnect the camera.",
        )


def _set_trigger_in(device: Any, hal: Any, on: bool, where: str) -> bool:
    """Switch the main trigger input; returns what was read back."""
    facility = device.get_i_trigger_in()
    if facility is None:
        if on:
            raise CameraSettingRefused(
                "It has no trigger input, so the light's phase cannot be recorded.",
                where=where,
                remedy="Use a camera with a trigger input, or switch trigger_in off.",
            )
        return False
    channel = hal.I_TriggerIn.Channel.MAIN
    switch: Callable[[Any], Any] = facility.enable if on else facility.disable
    with _refusal("switch its trigger input", where):
        switch(channel)
        found = bool(facility.is_enabled(channel))
    if found != on:
        raise CameraSettingRefused(
            f"Its trigger input stays {'on' if found else 'off'}.",
            where=where,
            remedy="Reconnect the camera.",
        )
    return found


@contextmanager
def _refusal(doing: str, where: str) -> Iterator[None]:
    """Turn the HAL's RuntimeError into ours."""
    try:
        yield
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise CameraSettingRefused(
            f"It would not {doing} ({reason}).",
            where=where,
            remedy="Correct that setting, or reconnect the camera.",
        ) from error
