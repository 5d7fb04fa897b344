"""Field types that the sections of a station file share: ports (real or simulated), serial numbers, texts, numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field, ValidationInfo
from pydantic_core import PydanticCustomError

from drivers.port_address import PORT_REMEDY, SOURCE_REMEDY, refused_port, refused_source
from sequences.plain_number import Within

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

Variable = Annotated[str, Field(max_length=100, pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
"""Name of an environment variable, which holds a secret in place of the station file."""


def _not_another_url(port: str) -> str:
    """Accept the kinds of URL that reach a device; others write files or search for a device."""
    if not port.startswith(SIMULATED_PREFIX) and (refused := refused_port(port)) is not None:
        raise PydanticCustomError("kind_of_url", "{refused}", {"refused": f"{refused} {PORT_REMEDY}"})
    return port


def _not_another_protocol(source: str) -> str:
    """Accept the kinds of video source that reach a camera or a video file."""
    if not source.startswith(SIMULATED_PREFIX) and (refused := refused_source(source)) is not None:
        raise PydanticCustomError("kind_of_url", "{refused}", {"refused": f"{refused} {SOURCE_REMEDY}"})
    return source


Port = Annotated[Text, AfterValidator(_simulated_or_real), AfterValidator(_not_another_url)]


VideoSource = Annotated[Text, AfterValidator(_simulated_or_real), AfterValidator(_not_another_protocol)]


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


Positive = Annotated[float, Within(1e-6, 1e9)]


FocalLength = Annotated[float, Within(1, 100_000, "mm")]
