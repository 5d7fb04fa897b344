"""What a run's journal states about the devices: who they are, and how they were left. Types only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NotRequired, TypedDict


class DevicesFound(TypedDict):
    """Payload of ``devices``: identities, and the camera's settings as read back."""

    camera: Mapping[str, Any]
    stage: Sequence[Mapping[str, Any]]
    light: Mapping[str, Any]
    camera_settings: Mapping[str, Any]
    connections: NotRequired[Mapping[str, str]]


class DevicesLeft(TypedDict):
    """Payload of ``devices_left``: each device as in `RunEnded`, asked after the last step that needs devices."""

    devices: Sequence[Mapping[str, str]]
