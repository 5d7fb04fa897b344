"""What the align page can ask for: one JSON object each, checked, refused in words, or one call of the session."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from bench.base.errors import ControlRefused, UsageError
from bench.extras.pages.align.session import Session

Action = Callable[[str, Mapping[str, Any]], Any]
_PAGE_ID = re.compile(r"[A-Za-z0-9_-]{8,64}")
_AGAIN = "Load the page again."


class PageRequests:
    """What the page can ask for, as methods of a page's id and its request."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def actions(self) -> Mapping[str, Action]:
        """Return what the page can ask for, by the names that it uses."""
        names = ("jog", "home", "light", "camera", "hands", "stop", "take", "beat", "forget")
        return {"open": self.reopen} | {name: getattr(self, name) for name in names}

    def jog(self, _page: str, body: Mapping[str, Any]) -> Any:
        """Turn axes by small steps."""
        steps = body.get("steps_deg")
        if not isinstance(steps, dict) or not steps:
            raise UsageError("The request names no axis.", remedy=_AGAIN)
        return self._session.bench.stage.move_by({str(axis): _number(steps, axis) for axis in steps})

    def home(self, _page: str, _body: Mapping[str, Any]) -> None:
        """Search the references of the stage."""
        self._session.bench.stage.home()

    def reopen(self, _page: str, _body: Mapping[str, Any]) -> Any:
        """Open the devices again."""
        failure = self._session.reopen()
        return failure.to_dict() if failure else None

    def light(self, _page: str, body: Mapping[str, Any]) -> Any:
        """Switch or set the light."""
        names = ("frequency_hz", "duty_percent", "level_percent")
        numbers = {name: _number(body, name) for name in names if name in body}
        on = body.get("on")
        if on is not None and not isinstance(on, bool):
            raise UsageError("`on` must be true or false.", remedy=_AGAIN)
        control = self._session.bench.light
        control.set(on=on, **numbers)
        return control.as_data()

    def camera(self, _page: str, body: Mapping[str, Any]) -> Any:
        """Change a bias, or exposure or gain."""
        return dict(self._session.bench.camera.set(str(body.get("name")), _number(body, "value")))

    def hands(self, _page: str, body: Mapping[str, Any]) -> Any:
        """Do something with the hands at the simulated camera."""
        numbers = {name: _number(body, name) for name in body if name not in ("page", "action")}
        return self._session.bench.hands.do(str(body.get("action")), numbers)

    def stop(self, _page: str, _body: Mapping[str, Any]) -> None:
        """Stop the stage."""
        self._session.stop()

    def take(self, page: str, _body: Mapping[str, Any]) -> None:
        """Give the controls to the page. A motion of another page is stopped."""
        if self._session.holder.take(page):
            self._session.stop_motion()
        self._session.changes.tell()

    def beat(self, page: str, _body: Mapping[str, Any]) -> None:
        """Note that the page is there."""
        self._session.holder.beat(page)

    def forget(self, _page: str, _body: Mapping[str, Any]) -> None:
        """Begin the curve of the focus anew."""
        self._session.bench.loop.forget()


def read_page(body: Mapping[str, Any]) -> str:
    """Return the id of the page that sends a request."""
    page = body.get("page")
    if not isinstance(page, str) or not _PAGE_ID.fullmatch(page):
        raise UsageError("The request does not say which page sends it.", remedy=_AGAIN)
    return page


def _number(body: Mapping[str, Any], name: str) -> float:
    value = body.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ControlRefused(f"{name} is not a number. Nothing was changed.", remedy="Give a number.")
    return float(value)
