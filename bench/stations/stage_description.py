"""The description of a stage's protocol: keys, checks, and its form for the driver. Opens nothing."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.description_fields import (
    ADDRESS,
    Command,
    Described,
    Line,
    StateQuery,
    Tolerance,
    make_exchange,
    reply_check,
    request_check,
)
from drivers.described import description as of
from sequences.strict_model import StrictModel


class _AxisQuery(StrictModel):
    """A query to an axis whose reply has the value ``counts``."""

    send: Annotated[Line, AfterValidator(request_check(ADDRESS))]
    reply: Annotated[Line, AfterValidator(reply_check(ADDRESS, "counts"))]

    def exchange(self) -> of.Exchange:
        """Return the exchange for the driver."""
        return make_exchange(self.send, self.reply, ADDRESS)


class _AxisCommand(StrictModel):
    """A command to an axis, with the reply that confirms it."""

    send: Annotated[Line, AfterValidator(request_check(ADDRESS))]
    reply: Annotated[Line, AfterValidator(reply_check(ADDRESS))]

    def exchange(self) -> of.Exchange:
        """Return the exchange for the driver."""
        return make_exchange(self.send, self.reply, ADDRESS)


class _Home(_AxisCommand):
    """The search of the reference of an axis."""

    reply_comes: Annotated[
        Literal["at_once", "at_end"],
        Field(description="Whether the device replies at once, or when the search has ended."),
    ] = "at_once"


class _Move(StrictModel):
    """A move to an absolute position, which stands as ``{target:...}`` in counts."""

    send: Annotated[Line, AfterValidator(request_check(ADDRESS, "target"))]
    reply: Annotated[Line, AfterValidator(reply_check(ADDRESS))]

    def exchange(self) -> of.Exchange:
        """Return the exchange for the driver."""
        return make_exchange(self.send, self.reply, ADDRESS, "target")


class _Scale(StrictModel):
    """A query of the scale of an axis."""

    send: Annotated[Line, AfterValidator(request_check(ADDRESS))]
    reply: Annotated[Line, AfterValidator(reply_check(ADDRESS, "scale"))]
    unit: Literal["counts_per_deg", "deg_per_count", "arcsec_per_count"]


class _SetAxis(StrictModel):
    """A command that sets a value of an axis."""

    send: Annotated[Line, AfterValidator(request_check(ADDRESS, "value"))]
    reply: Annotated[Line, AfterValidator(reply_check(ADDRESS))]


class _GetAxis(StrictModel):
    """A query of a value of an axis."""

    send: Annotated[Line, AfterValidator(request_check(ADDRESS))]
    reply: Annotated[Line, AfterValidator(reply_check(ADDRESS, "value"))]


class AxisSettingConfig(StrictModel):
    """A setting of an axis, in counts (``speed``: counts/s): written when the device is opened, and read back."""

    quantity: Literal["speed", "acceleration", "lowest", "highest", "constant"]
    set: _SetAxis
    query: _GetAxis
    value: Annotated[float | None, Field(description="Value of a constant.")] = None
    tolerance_percent: Tolerance = 0.0

    @model_validator(mode="after")
    def _constant_has_value(self) -> AxisSettingConfig:
        if (self.quantity == "constant") != (self.value is not None):
            raise PydanticCustomError("constant_value", "a constant needs value; no other setting has one.")
        return self

    def setting(self) -> of.AxisSetting:
        """Return the setting for the driver."""
        return of.AxisSetting(
            quantity=self.quantity,
            set=make_exchange(self.set.send, self.set.reply, ADDRESS, "value"),
            query=make_exchange(self.query.send, self.query.reply, ADDRESS),
            constant=self.value or 0.0,
            tolerance_percent=self.tolerance_percent,
        )


class AxisProtocol(StrictModel):
    """Requests to one axis; ``{address}`` is the axis's address in the station file."""

    position: _AxisQuery
    idle: StateQuery
    move: _Move
    home: _Home
    encoder: _AxisQuery | None = None
    reference: StateQuery | None = None
    faults: StateQuery | None = None
    scale: _Scale | None = None
    lowest: _AxisQuery | None = None
    highest: _AxisQuery | None = None
    settings: Annotated[tuple[AxisSettingConfig, ...], Field(max_length=20)] = ()
    setup: Annotated[tuple[_AxisCommand, ...], Field(max_length=20)] = ()


class StageProtocol(Described):
    """The description of a stage."""

    format: Literal["starbench/stage-protocol/1"]
    stop: Command
    axis: AxisProtocol

    @property
    def has_addresses(self) -> bool:
        """Whether moves name their axis, so that there may be several."""
        return "{address}" in self.axis.move.send

    def for_driver(self) -> of.StageDescription:
        """Return the description for the driver."""
        axis = self.axis
        return of.StageDescription(
            line=self.of_line(),
            move=axis.move.exchange(),
            stop=self.stop.exchange(),
            position=axis.position.exchange(),
            idle=axis.idle.switch(),
            home=axis.home.exchange(),
            home_replies_at_end=axis.home.reply_comes == "at_end",
            encoder=None if axis.encoder is None else axis.encoder.exchange(),
            reference=None if axis.reference is None else axis.reference.switch(),
            faults=None if axis.faults is None else axis.faults.switch(),
            scale=None if axis.scale is None else make_exchange(axis.scale.send, axis.scale.reply, ADDRESS),
            scale_unit=axis.scale.unit if axis.scale else "counts_per_deg",
            lowest=None if axis.lowest is None else axis.lowest.exchange(),
            highest=None if axis.highest is None else axis.highest.exchange(),
            settings=tuple(one.setting() for one in axis.settings),
            setup=tuple(one.exchange() for one in axis.setup),
        )
