"""Field types that the sections of a station file share: ports (real or simulated), serial numbers, texts, numbers."""

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
    """Accept a simulated port only if the station has a simulation section."""
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
            "no_simulation", "a simulated device needs a simulation section (simulation: {} is enough)."
        )
    return port


Text = Annotated[str, Field(min_length=1, max_length=200)]


Port = Annotated[Text, AfterValidator(_simulated_or_real)]


Serial = Annotated[
    str,
    Field(
        min_length=1,
        max_length=64,
        description="As the device reports it, with all zeros.",
        json_schema_extra={
            "type": ["string", "integer"]
        },  # an editor may read it as a number; Starbench reads it as text
    ),
]


Positive = Annotated[float, Field(gt=0)]
