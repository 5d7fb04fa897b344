"""Faults as a run meets them: what a driver raises or reports, when, and how the run may end.

That drivers raise these is shown with the simulated devices, byte for byte; here they come as they are.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from rehearsed import Scene

from bench.base.errors import StorageError
from bench.record.unsynced_journal import UnsyncedJournal
from bench.run.control import Command
from drivers.errors import (
    CameraLost,
    DeviceRefused,
    LightFault,
    MoveFailed,
    MoveTimeout,
    NotHomed,
    PortLost,
    PortNotFound,
    RecordingFailed,
    ReplyGarbled,
    ReplyTimeout,
    SettingRefused,
    WrongDevice,
)

LOST = "\ninterlocks: {device_lost: {retry_s: 5, max_hold_s: 60}}\n"


class Died(BaseException):
    """The process is gone: nothing of it is written any more, and no device hears from it."""


def mortal(scene):
    """The journal of a process that may die, and whose disk may fail: ``scene.dead``, ``scene.disk``."""

    class Mortal(UnsyncedJournal):
        def put(self, event, data, *, synced):
            if scene.dead:
                raise Died
            try:
                scene.disk()
            except OSError as error:
                raise StorageError(str(error), where=str(self.path)) from error
            return super().put(event, data, synced=synced)

    return Mortal


@dataclass(frozen=True)
class Fault:
    """A fault as a run meets it."""

    name: str
    # Beginnings of the calls it strikes: ``stage.``, ``light.off``; ``tick`` for anything that passes the
    # clock.
    of: tuple[str, ...]
    # Called with the scene when it strikes: raises, or returns what becomes of the call's result.
    strike: Callable[[Scene], object]
    ends: frozenset[str]  # How the run may end
    lasts: bool = False  # Whether it strikes every such call from then on, until the cause is removed
    station: str = ""


def command(scene, word, **more):
    """Play the thread that takes commands."""
    inbox = getattr(scene.runner, "inbox", None)
    if inbox is not None and not inbox.closed:
        inbox.decide(Command(word=word, by="ada", **more), "command.json")


def raising(error):
    def strike(_scene):
        raise error

    return strike


def _stop(scene):
    scene.clock.request_stop("SIGTERM received")


def _abort(scene):
    command(scene, "abort")


def _die(scene):
    scene.dead = True
    raise Died


def _light_off(scene):
    scene.light_and_stage()[0].lit = False


def _moved(scene):
    stage = scene.light_and_stage()[1]
    stage.at_deg = {axis: angle + 0.01 for axis, angle in stage.at_deg.items()}


def _facts(**changed):
    return lambda _scene: lambda facts: replace(facts, **changed)


def _back_after(error, seconds):
    def strike(scene):
        if scene.struck_at_s is None:
            scene.struck_at_s = scene.clock.monotonic()
        if scene.clock.monotonic() < scene.struck_at_s + seconds:
            raise error

    return strike


FAILED, ENDED = frozenset({"failed"}), frozenset({"finished", "failed"})
MOVE, MOVES, STAGE = ("stage.move_to",), ("stage.move_to", "stage.home"), ("stage.", "open")
ABORTED, FINISHED = frozenset({"aborted"}), frozenset({"finished"})
GONE = raising(PortLost("gone"))
FAULTS = (
    Fault("stage unplugged", STAGE, GONE, FAILED, lasts=True),
    Fault("light unplugged", ("light.", "open"), GONE, FAILED, lasts=True),
    # After the last recording the camera is only asked how it is left: the run finishes, and says that it
    # does not answer.
    Fault("camera unplugged", ("camera.", "open"), raising(CameraLost("gone")), ENDED, lasts=True),
    *(
        Fault(
            f"{device} lost for 20 s, interlock `device_lost`",
            (f"{device}.", "open"),
            _back_after(error("gone"), 20),
            FINISHED,
            True,
            LOST,
        )
        for device, error in (("stage", PortLost), ("light", PortLost), ("camera", CameraLost))
    ),
    Fault("stage lost permanently, interlock `device_lost`", STAGE, GONE, FAILED, True, LOST),
    Fault("another device on the port", ("open",), raising(WrongDevice("another serial number")), FAILED),
    Fault("no such port", ("open",), raising(PortNotFound("no such port")), FAILED),
    Fault("stage: reply lost or late", ("stage.",), raising(ReplyTimeout("silent")), FAILED),
    Fault("stage: reply garbled, echo, wrong id", ("stage.",), raising(ReplyGarbled("checksum")), FAILED),
    Fault("light: reply lost or late", ("light.",), raising(ReplyTimeout("silent")), FAILED),
    Fault("light: reply garbled", ("light.",), raising(ReplyGarbled("form")), FAILED),
    Fault("stage stalls, limit switch, twist", MOVES, raising(MoveFailed("stalled")), FAILED),
    Fault("stage stops short, slips, restarts during a move", MOVE, raising(MoveFailed("short")), FAILED),
    Fault("stage always busy, no progress", MOVES, raising(MoveTimeout("busy")), FAILED),
    Fault("stage without reference after a loss of power", MOVE, raising(NotHomed("no reference")), FAILED),
    Fault("stage refuses a command (emergency stop)", MOVES, raising(DeviceRefused("stopped")), FAILED),
    Fault("lamp open or too hot", ("light.on", "light.read"), raising(LightFault("lamp open")), FAILED),
    Fault("light: level or frequency clipped", ("light.apply",), raising(SettingRefused("clipped")), FAILED),
    Fault("light silently off", ("camera.record",), _light_off, ENDED),
    Fault("stage creeps during a recording", ("camera.record",), _moved, FAILED),
    Fault("recording interrupted", ("camera.record",), raising(RecordingFailed("USB drop")), FINISHED),
    Fault("events or triggers lost", ("camera.record",), _facts(gaps=("12 ms are missing",)), FINISHED),
    Fault("recording cut short", ("camera.record",), _facts(complete=False), FINISHED),
    Fault("event rate too high", ("camera.record",), _facts(events=10**9), FINISHED),
    Fault("disk full", ("disk",), raising(OSError(28, "No space left on device")), FAILED),
    Fault("disk fails", ("disk",), raising(OSError(5, "Input/output error")), FAILED),
    Fault("process killed", ("stage.", "light.", "camera.", "tick"), _die, frozenset({"died"})),
    Fault("SIGINT, SIGTERM, SIGHUP", ("stage.", "light.", "camera.", "tick"), _stop, ABORTED | FINISHED),
    Fault("abort by an operator", ("stage.", "light.", "camera.", "tick"), _abort, ABORTED | FINISHED),
)
