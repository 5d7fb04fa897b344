"""Words that devices of a station file share: ports, simulated or real, serial numbers, texts, numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field, ValidationInfo
from pydantic_core import PydanticCustomError

SIMULATED_PREFIX = "sim:"
SIMULATED_PORTS = (
    "sim:gimbal",
    "sim:gimbal-pan",
    "sim:gimbal-tilt",
    "sim:gimbal-roll",
    "sim:light",
    "sim:camera",
    "sim:frame-camera",
)


def _simulated_or_real(port: str, info: ValidationInfo) -> str:
    """Let a simulated port pass only where the station has a simulation to give it."""
    if not port.startswith(SIMULATED_PREFIX):
        return port
    if port not in SIMULATED_PORTS:
        known = ", ".join(SIMULATED_PORTS)
        raise PydanticCustomError(
            "no_such_simulated_port", "no such simulated device; known: {known}.", {"known": known}
        )
    document = (info.context or {}).get("document", {})
    if "simulation" not in document:
        raise PydanticCustomError(
            "no_simulation", "a simulated device needs a simulation section (simulation: {} will do)."
        )
    return port


Text = Annotated[str, Field(min_length=1, max_length=200)]


Port = Annotated[Text, AfterValidator(_simulated_or_real)]


Serial = Annotated[
    str,
    Field(
        min_length=1,
        max_length=64,
        description="As the device says it, zeros included.",
        json_schema_extra={
            "type": ["string", "integer"]
        },  # an editor may take it for a number; the reader never
    ),
]


Positive = Annotated[float, Field(gt=0)]
