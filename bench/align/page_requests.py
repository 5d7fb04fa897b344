"""What the align page can ask for: one JSON object each, checked, refused in words, or one call of the session."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.align.readiness import check_readiness
from bench.align.session import Session
from bench.align.write_down import (
    Proposal,
    must_be_copied,
    plain_number,
    propose_pose,
    propose_values,
    station_values,
)
from bench.base.errors import ControlRefused, UsageError
from bench.plan.plan import SHIPPED_SEQUENCES
from bench.stations.station import Station

Action = Callable[[str, Mapping[str, Any]], Any]
_PAGE_ID = re.compile(r"[A-Za-z0-9_-]{8,64}")
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,79}")
_MOST_NAMED = 100
_AGAIN = "Load the page again."


@dataclass(frozen=True)
class PageFiles:
    """The files that a page may read and write."""

    station: str
    # The only folder for copies and for sequences that the page names.
    folder: Path = field(default_factory=Path.cwd)

    def as_data(self) -> dict[str, Any]:
        """Return station file, why it must be copied (or an empty text), folder, and the names of the sequences."""
        here = sorted(path.name for path in self.folder.glob("*.yaml") if _is_sequence(path))
        return {
            "station": self.station,
            "copy_needed": must_be_copied(Path(self.station)),
            "folder": str(self.folder),
            "sequences": here[:_MOST_NAMED],
            "shipped": sorted(path.stem for path in SHIPPED_SEQUENCES.glob("*.yaml")),
        }

    def in_folder(self, name: str) -> Path:
        """Return the path of a plain file name that the page gives; the ending ``.yaml`` is added if it is missing."""
        if not _FILE_NAME.fullmatch(name) or ".." in name:
            raise ControlRefused(
                f"{name!r} is not a plain file name.",
                remedy=f"Give a name such as my_bench.yaml. The file is in {self.folder}.",
            )
        return self.folder / (name if name.endswith((".yaml", ".yml")) else f"{name}.yaml")

    def sequence(self, name: str) -> Path:
        """Return the path of a sequence in ``folder``, or of a shipped one, that the page names."""
        here = self.in_folder(name)
        if here.is_file():
            return here
        shipped = SHIPPED_SEQUENCES / f"{name}.yaml"
        if shipped.is_file():
            return shipped
        raise ControlRefused(
            f"There is no sequence {name!r}.",
            where=str(self.folder),
            remedy="Name a file of this folder, or a sequence that came with Starbench, such as three_pose.",
        )


def actions(session: Session, files: PageFiles) -> Mapping[str, Action]:
    """Return what the page can ask for."""
    return {
        **_stage_actions(session),
        **_light_actions(session),
        **_camera_actions(session),
        **_file_actions(session, files),
        **_page_actions(session),
    }


def _stage_actions(session: Session) -> dict[str, Action]:
    """Return the requests that turn something, and the one that opens devices again."""

    def jog(page: str, body: Mapping[str, Any]) -> Any:
        steps = body.get("steps_deg")
        if not isinstance(steps, dict) or not steps:
            raise UsageError("The request names no axis.", remedy=_AGAIN)
        wanted = {str(axis): _number(steps, axis) for axis in steps}
        goals = session.bench.stage.move_by(wanted, page)
        _told(
            session,
            page,
            "asked for " + " and ".join(f"{axis} {goal:.2f}°" for axis, goal in goals.items()),
            "jog",
        )
        return goals

    def home(page: str, _body: Mapping[str, Any]) -> Any:
        session.bench.stage.home(page)
        _told(session, page, "started the homing of the stage")

    def reopen(page: str, _body: Mapping[str, Any]) -> Any:
        _told(session, page, "asked to open the devices again")
        failure = session.reopen()
        return failure.to_dict() if failure else None

    return {"jog": jog, "home": home, "open": reopen}


def _light_actions(session: Session) -> dict[str, Action]:
    """Return the request that switches or sets the light."""

    def light(page: str, body: Mapping[str, Any]) -> Any:
        numbers = {
            name: _number(body, name)
            for name in ("frequency_hz", "duty_percent", "level_percent")
            if name in body
        }
        if "waveform" in body:
            numbers["waveform"] = body["waveform"]
        on = body.get("on")
        if on is not None and not isinstance(on, bool):
            raise UsageError("`on` must be true or false.", remedy=_AGAIN)
        found = session.light(on=on, **numbers)
        if on is not None:
            _told(session, page, f"switched the light {'on' if found['on'] else 'off'}")
        if numbers:
            _told(session, page, f"set the light to {_light_text(found)}", "light")
        return found

    return {"light": light}


def _camera_actions(session: Session) -> dict[str, Action]:
    """Return the requests that set the camera, and those to the hands of the simulated bench."""

    def bias(page: str, body: Mapping[str, Any]) -> Any:
        value = _number(body, "value")
        if value != int(value):
            raise ControlRefused("A bias is a whole number. Nothing was sent.", remedy="Give a whole number.")
        name = str(body.get("name"))
        found = dict(session.bench.camera.set_bias(name, int(value)))
        _told(session, page, f"set {name} to {found.get(name)}, as read back", name)
        return found

    def frame(page: str, body: Mapping[str, Any]) -> Any:
        name = str(body.get("name"))
        found = dict(session.bench.camera.set_frame(name, _number(body, "value")))
        _told(session, page, f"set {name} to {found.get(name)}, as read back", name)
        return found

    def hands(page: str, body: Mapping[str, Any]) -> Any:
        action, names = str(body.get("action")), [name for name in body if name not in ("page", "action")]
        numbers = {name: _number(body, name) for name in names}
        found = session.bench.hands.do(action, numbers)
        by = ", ".join(f"{name} {value:g}" for name, value in numbers.items())
        _told(
            session, page, f"used the hands of the simulated bench: {action}{', ' if by else ''}{by}", action
        )
        return found

    return {"bias": bias, "frame": frame, "hands": hands}


def _file_actions(session: Session, files: PageFiles) -> dict[str, Action]:
    """Return the requests that check or write something."""

    def check(page: str, body: Mapping[str, Any]) -> Any:
        name = body.get("sequence") or ""
        sequence = str(files.sequence(str(name))) if name else None
        checks = check_readiness(session, sequence=sequence, station_file=files.station)
        bad = sum(one.verdict != "good" for one in checks)
        _told(session, page, f"made {len(checks)} checks; {bad} {'is' if bad == 1 else 'are'} not good")
        return [one.as_data() for one in checks]

    def propose(_page: str, body: Mapping[str, Any]) -> Any:
        return _proposal(session, files, body).as_data()

    def write(page: str, body: Mapping[str, Any]) -> Any:
        proposal = _proposal(session, files, body)
        proposal.write(str(body.get("mark")))
        _told(session, page, f"wrote {proposal.path}")
        return {"file": str(proposal.path)}

    return {"check": check, "propose": propose, "write": write}


def _page_actions(session: Session) -> dict[str, Action]:
    """Return the requests of the page itself: stop, who has the controls, what it shows."""

    def forget(page: str, _body: Mapping[str, Any]) -> Any:
        session.bench.loop.forget()
        _told(session, page, "began the course of the focus anew")

    return {
        "stop": lambda page, _: session.stop(f"on request of {session.owners.name(page)}"),
        "leave": lambda page, _: session.stop_for_lost(page),
        "take": lambda page, _: _take(session, page),
        "beat": lambda page, _: session.owners.beat(page),
        "forget": forget,
    }


def _told(session: Session, page: str, what: str, topic: str = "") -> None:
    """List what a page has done. Several entries in a row with the same topic become one."""
    session.say(f"{session.owners.name(page)} {what}.", f"{topic} {page}" if topic else "")


def read_page(body: Mapping[str, Any]) -> str:
    """Return the id of the page that sends a request."""
    page = body.get("page")
    if not isinstance(page, str) or not _PAGE_ID.fullmatch(page):
        raise UsageError("The request does not say which page sends it.", remedy=_AGAIN)
    return page


def _take(session: Session, page: str) -> None:
    """Give the controls to a page. A motion that another page started is stopped: nobody looks after it any more."""
    before = session.owners.holder
    session.owners.take(page)
    if before != page:
        session.say(f"{session.owners.name(page)} has the controls now.")
    if before != page and session.is_open and session.bench.stage.moving:
        session.stop("because another page took over the controls")


def _proposal(session: Session, files: PageFiles, body: Mapping[str, Any]) -> Proposal:
    """Return the change of a file that a request asks for."""
    copy = body.get("copy") or ""
    target = files.in_folder(str(copy)) if copy else None
    bench, kind = session.bench, body.get("kind")
    if kind == "pose":
        source = files.sequence(str(body.get("sequence") or ""))
        return propose_pose(
            source,
            {axis: round(angle, 4) for axis, angle in bench.stage.state.position_deg.items()},
            poses=str(body["poses"]) if body.get("poses") else None,
            name=str(body["name"]) if body.get("name") else None,
            light=_light_values(session) if body.get("light") is True else None,
            target=target,
        )
    if kind != "station":
        raise UsageError("The request does not say what to write.", remedy=_AGAIN)
    wanted = body.get("what") or []
    if not isinstance(wanted, list) or not wanted:
        raise ControlRefused("Nothing is chosen.", remedy="Choose what to write down: zero, biases or light.")
    values, notes = station_values(
        session.station.value,
        position_deg=bench.stage.state.position_deg if "zero" in wanted else None,
        biases=bench.camera.biases if "biases" in wanted and bench.camera.is_event else None,
        frame=bench.camera.frame_settings if "biases" in wanted else None,
        level_percent=bench.light.reading.flicker.level_percent if "light" in wanted else None,
        hands=bench.hands.seen,
    )
    proposal = propose_values(Path(files.station), values, Station, target=target)
    return Proposal(
        proposal.path, proposal.source, proposal.before, proposal.after, (*notes, *proposal.notes)
    )


def _light_values(session: Session) -> dict[str, str]:
    """Return the present flicker as a sequence states it. Its level is relative to the station's brightest one."""
    now = session.bench.light.reading.flicker
    return {
        "waveform": now.waveform,
        "frequency_hz": plain_number(now.frequency_hz, 6),
        "duty_percent": plain_number(now.duty_percent, 4),
        "level_percent": plain_number(now.level_percent, 4),
    }


def _light_text(light: Mapping[str, Any]) -> str:
    """Return the settings of the light in words."""
    if light["waveform"] == "steady":
        return f"steady, level {light['level_percent']:g} %"
    return (
        f"{light['waveform']}, {light['frequency_hz']:g} Hz, duty {light['duty_percent']:g} %, "
        f"level {light['level_percent']:g} %"
    )


def _is_sequence(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return b"starbench/sequence/" in stream.read(4096)
    except OSError:
        return False


def _number(body: Mapping[str, Any], name: str) -> float:
    value = body.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ControlRefused(f"{name} is not a number. Nothing was changed.", remedy="Give a number.")
    return float(value)
