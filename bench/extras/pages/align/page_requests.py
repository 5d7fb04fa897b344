"""What the align page can ask for: one JSON object each, checked, refused in words, or one call of the session."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bench.base.encoding import plain_number
from bench.base.errors import ControlRefused, UsageError
from bench.extras.pages.align.readiness import check_readiness
from bench.extras.pages.align.session import Session
from bench.extras.pages.align.write_down import (
    Proposal,
    must_be_copied,
    propose_pose,
    propose_values,
    station_values,
)
from bench.plan.plan import SHIPPED_SEQUENCES
from bench.stations.station import Station

Action = Callable[[str, Mapping[str, Any]], Any]
_PAGE_ID = re.compile(r"[A-Za-z0-9_-]{8,64}")
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,79}")
_MOST_NAMED = 100  # A menu of more is not read
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


class PageRequests:
    """What the page can ask for, as methods of a page's id and its request; each lists what it has done."""

    def __init__(self, session: Session, files: PageFiles) -> None:
        self._session = session
        self._files = files

    def actions(self) -> Mapping[str, Action]:
        """Return what the page can ask for, by the names that it uses."""
        named = ("jog", "home", "light", "bias", "frame", "hands", "check", "propose", "write")
        more = ("stop", "leave", "take", "beat", "forget")
        return {"open": self.reopen} | {name: getattr(self, name) for name in (*named, *more)}

    # ------------------------------------------------------------ what turns or opens something

    def jog(self, page: str, body: Mapping[str, Any]) -> Any:
        """Turn axes by small steps."""
        steps = body.get("steps_deg")
        if not isinstance(steps, dict) or not steps:
            raise UsageError("The request names no axis.", remedy=_AGAIN)
        wanted = {str(axis): _number(steps, axis) for axis in steps}
        goals = self._session.bench.stage.move_by(wanted, page)
        asked = " and ".join(f"{axis} {goal:.2f}°" for axis, goal in goals.items())
        self._told(page, f"asked for {asked}", "jog")
        return goals

    def home(self, page: str, _body: Mapping[str, Any]) -> None:
        """Search the references of the stage."""
        self._session.bench.stage.home(page)
        self._told(page, "started the homing of the stage")

    def reopen(self, page: str, _body: Mapping[str, Any]) -> Any:
        """Open the devices again."""
        self._told(page, "asked to open the devices again")
        failure = self._session.reopen()
        return failure.to_dict() if failure else None

    # ------------------------------------------------------------ light and camera

    def light(self, page: str, body: Mapping[str, Any]) -> Any:
        """Switch or set the light."""
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
        light = self._session.light(on=on, **numbers)
        if on is not None:
            self._told(page, f"switched the light {'on' if light['on'] else 'off'}")
        if numbers:
            self._told(page, f"set the light to {_light_text(light)}", "light")
        return light

    def bias(self, page: str, body: Mapping[str, Any]) -> Any:
        """Change one bias."""
        value = _number(body, "value")
        if value != int(value):
            raise ControlRefused("A bias is a whole number. Nothing was sent.", remedy="Give a whole number.")
        name = str(body.get("name"))
        return self._read_back(page, name, self._session.bench.camera.set_bias(name, int(value)))

    def frame(self, page: str, body: Mapping[str, Any]) -> Any:
        """Change exposure or gain."""
        name = str(body.get("name"))
        return self._read_back(page, name, self._session.bench.camera.set_frame(name, _number(body, "value")))

    def hands(self, page: str, body: Mapping[str, Any]) -> Any:
        """Do something with the hands at the simulated camera."""
        action, names = str(body.get("action")), [name for name in body if name not in ("page", "action")]
        numbers = {name: _number(body, name) for name in names}
        answer = self._session.bench.hands.do(action, numbers)
        by = ", ".join([action, *(f"{name} {value:g}" for name, value in numbers.items())])
        self._told(page, f"changed the simulated bench by hand: {by}", action)
        return answer

    # ------------------------------------------------------------ checks and files

    def check(self, page: str, body: Mapping[str, Any]) -> Any:
        """Make the checks that a run makes before it moves."""
        name = body.get("sequence") or ""
        sequence = str(self._files.sequence(str(name))) if name else None
        checks = check_readiness(self._session, sequence=sequence, station_file=self._files.station)
        bad = sum(check.verdict != "good" for check in checks)
        self._told(page, f"made {len(checks)} checks; {bad} {'is' if bad == 1 else 'are'} not good")
        return [check.as_data() for check in checks]

    def propose(self, _page: str, body: Mapping[str, Any]) -> Any:
        """Show the change of a file."""
        return self._proposal(body).as_data()

    def write(self, page: str, body: Mapping[str, Any]) -> Any:
        """Write the change of a file that was shown."""
        proposal = self._proposal(body)
        proposal.write(str(body.get("mark")))
        self._told(page, f"wrote {proposal.path}")
        return {"file": str(proposal.path)}

    # ------------------------------------------------------------ the page itself

    def stop(self, page: str, _body: Mapping[str, Any]) -> None:
        """Stop the stage."""
        self._session.stop(f"on request of {self._session.owners.name(page)}")

    def leave(self, page: str, _body: Mapping[str, Any]) -> None:
        """Stop what the page has set in motion: it closes."""
        self._session.stop_for_lost(page)

    def take(self, page: str, _body: Mapping[str, Any]) -> None:
        """Give the controls to the page.

        A motion that another page started is stopped: nobody looks after it any more.
        """
        session, before = self._session, self._session.owners.holder
        session.owners.take(page)
        if before != page:
            session.say(f"{session.owners.name(page)} has the controls now.")
        if before != page and session.is_open and session.bench.stage.moving:
            session.stop("because another page took over the controls")

    def beat(self, page: str, _body: Mapping[str, Any]) -> None:
        """Note that the page is there."""
        self._session.owners.beat(page)

    def forget(self, page: str, _body: Mapping[str, Any]) -> None:
        """Begin the curve of the focus anew."""
        self._session.bench.loop.forget()
        self._told(page, "began the curve of the focus anew")

    # ------------------------------------------------------------ inside

    def _told(self, page: str, what: str, topic: str = "") -> None:
        """List what a page has done. Several entries in a row with the same topic become one."""
        session = self._session
        session.say(f"{session.owners.name(page)} {what}.", f"{topic} {page}" if topic else "")

    def _read_back(self, page: str, name: str, answer: Mapping[str, Any]) -> dict[str, Any]:
        self._told(page, f"set {name} to {answer.get(name)}, as read back", name)
        return dict(answer)

    def _proposal(self, body: Mapping[str, Any]) -> Proposal:
        """Return the change of a file that a request asks for."""
        copy = body.get("copy") or ""
        target = self._files.in_folder(str(copy)) if copy else None
        bench, kind = self._session.bench, body.get("kind")
        if kind == "pose":
            source = self._files.sequence(str(body.get("sequence") or ""))
            return propose_pose(
                source,
                {axis: round(angle, 4) for axis, angle in bench.stage.position_to_write_deg().items()},
                poses=str(body["poses"]) if body.get("poses") else None,
                name=str(body["name"]) if body.get("name") else None,
                light=self._light_values() if body.get("light") is True else None,
                target=target,
            )
        if kind != "station":
            raise UsageError("The request does not say what to write.", remedy=_AGAIN)
        wanted = body.get("what") or []
        if not isinstance(wanted, list) or not wanted:
            raise ControlRefused(
                "Nothing is chosen.", remedy="Choose what to write down: zero, biases or light."
            )
        values, notes = station_values(
            self._session.station.value,
            position_deg=bench.stage.position_to_write_deg() if "zero" in wanted else None,
            biases=bench.camera.biases if "biases" in wanted and bench.camera.is_event else None,
            frame=bench.camera.frame_settings if "biases" in wanted else None,
            level_percent=bench.light.reading.flicker.level_percent if "light" in wanted else None,
            hands=bench.hands.seen,
        )
        proposal = propose_values(Path(self._files.station), values, Station, target=target)
        return replace(proposal, notes=(*notes, *proposal.notes))

    def _light_values(self) -> dict[str, str]:
        """Return the present flicker as a sequence states it. Its level is relative to the station's brightest one."""
        now = self._session.bench.light.reading.flicker
        return {
            "waveform": now.waveform,
            "frequency_hz": plain_number(now.frequency_hz, 6),
            "duty_percent": plain_number(now.duty_percent, 4),
            "level_percent": plain_number(now.level_percent, 4),
        }


def read_page(body: Mapping[str, Any]) -> str:
    """Return the id of the page that sends a request."""
    page = body.get("page")
    if not isinstance(page, str) or not _PAGE_ID.fullmatch(page):
        raise UsageError("The request does not say which page sends it.", remedy=_AGAIN)
    return page


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
