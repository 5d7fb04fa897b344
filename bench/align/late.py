"""Stage and light that open while the picture is shown: said when they are open, or why they are not.

The module reads the devices' states, and tries to open again what has failed. It moves nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from bench.align.open_bench import Bench
from bench.base.failure import Failure
from drivers.errors import StillOpening

_ALL_OPEN = "All devices are open. Nothing was moved, and the light was not switched."


def follow(bench: Bench, say: Callable[[str], None]) -> None:
    """Say when stage and light are open too, or why they could not be opened.

    say: Called with a sentence for the person, by any thread.
    """
    if not bench.devices.late:
        say(_ALL_OPEN)
    for name, device in bench.devices.late.items():
        device.listen(partial(_ended, bench, say, name))


def try_again(bench: Bench) -> bool:
    """Begin to open again what could not be opened.

    Returns: Whether there was anything.
    """
    failed = [device for device in bench.devices.late.values() if device.state == "failed"]
    for device in failed:
        device.start()
    return bool(failed)


def failures_of(bench: Bench) -> list[Failure]:
    """Return why stage or light cannot be used now.

    Returns: Empty if both answer, or are still being opened.
    """
    return [one for one in _failures(bench) if one.kind != StillOpening.__name__]


def is_opening(bench: Bench) -> bool:
    """Return whether stage or light is still being opened, or has not been read since.

    Returns: False also if one of them could not be opened.
    """
    if any(device.state == "opening" for device in bench.devices.late.values()):
        return True
    return any(one.kind == StillOpening.__name__ for one in _failures(bench))


def _failures(bench: Bench) -> list[Failure]:
    return [one for one in (bench.stage.failure, bench.light.reading.failure) if one is not None]


def _ended(bench: Bench, say: Callable[[str], None], name: str) -> None:
    """Read a device that has just been opened, or say why it could not be."""
    if name == "light":
        bench.light.look()
        failure = bench.light.reading.failure
    else:
        bench.stage.look_safely(thoroughly=True)
        failure = bench.stage.failure
    late = bench.devices.late
    if late[name].state == "failed" and failure is not None:
        say(f"The {name} could not be opened. {failure.message}")
    elif all(one.state == "open" for one in late.values()):
        say(_ALL_OPEN)
