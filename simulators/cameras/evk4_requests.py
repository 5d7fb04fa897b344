"""What a host of the simulated EVK4 may ask, checked: a request's JSON, names, switches and numbers.

Knows the protocol's error codes; neither the camera nor the socket.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


class Refusal(Exception):
    """A command that is refused: an error code of the protocol, and a sentence."""

    def __init__(self, code: str, message: str) -> None:
        self.code = code
        super().__init__(message)


def parse_request(payload: bytes) -> dict[str, Any]:
    """Parse a request. Raises Refusal."""
    try:
        request = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise Refusal("bad_request", f"The request is no JSON: {error}.") from error
    if not isinstance(request, dict):
        raise Refusal("bad_request", "The request is no JSON object.")
    return request


def read_name(what: str, name: object, known: Mapping[str, Any]) -> str:
    """Check a bias's or a filter's name. Raises Refusal."""
    if not isinstance(name, str) or name not in known:
        raise Refusal(f"unknown_{what}", f"There is no {what} {name!r}; there are {', '.join(known)}.")
    return name


def read_enabled(request: Mapping[str, Any]) -> bool:
    """Check the switch of a request. Raises Refusal."""
    enabled = request.get("enabled")
    if not isinstance(enabled, bool):
        raise Refusal("bad_value", f'"enabled" is true or false, not {enabled!r}.')
    return enabled


def read_frames(request: Mapping[str, Any]) -> int | None:
    """Check how many frames the host says it has kept; None when it says nothing. Raises Refusal."""
    frames = request.get("frames")
    if frames is not None and (isinstance(frames, bool) or not isinstance(frames, int) or frames < 0):
        raise Refusal("bad_value", f"A number of frames is a whole one, not {frames!r}.")
    return frames
