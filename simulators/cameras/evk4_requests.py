"""Checks of the requests to the simulated EVK4: JSON, names, switches and numbers.

Each check raises `Refusal` with an error code of ``docs/protocols/simulated-evk4.md``. Nothing here depends on the
camera or on the socket.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


class Refusal(Exception):
    """A refused command.

    code: Error code of the protocol, e.g. ``bad_value``.
    """

    def __init__(self, code: str, message: str) -> None:
        self.code = code
        super().__init__(message)


def parse_request(payload: bytes) -> dict[str, Any]:
    """Parse the payload of a request.

    Raises Refusal: ``bad_request``: the payload is not JSON, or not a JSON object.
    """
    try:
        request = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise Refusal("bad_request", f"The request is no JSON: {error}.") from error
    if not isinstance(request, dict):
        raise Refusal("bad_request", "The request is no JSON object.")
    return request


def read_name(what: str, name: object, known: Mapping[str, Any]) -> str:
    """Check that a request names something that exists.

    what: Kind of the name: ``command``, ``bias`` or ``filter``.
    Raises Refusal: ``unknown_command``, ``unknown_bias`` or ``unknown_filter``.
    """
    if not isinstance(name, str) or name not in known:
        raise Refusal(f"unknown_{what}", f"There is no {what} {name!r}; there are {', '.join(known)}.")
    return name


def read_enabled(request: Mapping[str, Any]) -> bool:
    """Read ``enabled`` from a request.

    Raises Refusal: ``bad_value``: ``enabled`` is missing or not a boolean.
    """
    enabled = request.get("enabled")
    if not isinstance(enabled, bool):
        raise Refusal("bad_value", f'"enabled" is true or false, not {enabled!r}.')
    return enabled


def read_frames(request: Mapping[str, Any]) -> int | None:
    """Read from a stop request how many frames the host has kept.

    Returns: Number of frames; None if the request does not say.
    Raises Refusal: ``bad_value``: ``frames`` is not a whole number from 0 on.
    """
    frames = request.get("frames")
    if frames is not None and (isinstance(frames, bool) or not isinstance(frames, int) or frames < 0):
        raise Refusal("bad_value", f"A number of frames is a whole one, not {frames!r}.")
    return frames
