"""The messages section of a station file: on which occasions messages are sent, and by which service.

A station file has no secrets, because it is copied into every run folder. It names the environment variables that hold
passwords and secret addresses.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.station_fields import Text, Variable
from sequences.strict_model import Form, StrictModel

Occasion = Literal["failure", "hold", "end"]
Address = Annotated[
    str,
    Field(max_length=254),
    Form(r"^[^\s@<>\"]+@[^\s@<>\"]+$", "one address such as lab@example.org, without a name"),
]
Url = Annotated[
    str, Field(max_length=2000), Form(r"^https?://[^\s]+$", "an address that begins with http:// or https://")
]


class MailConfig(StrictModel):
    """Mail, sent by SMTP."""

    host: Text
    port: Annotated[int, Field(ge=1, le=65535)] = 587
    security: Literal["starttls", "tls", "none"] = "starttls"
    sender: Address
    to: Annotated[tuple[Address, ...], Field(min_length=1, max_length=50)]
    user: Text | None = None
    password_env: Variable | None = None

    @model_validator(mode="after")
    def _never_in_the_clear(self) -> MailConfig:
        if (self.user is None) != (self.password_env is None):
            raise PydanticCustomError("half_login", "user and password_env must be given together.")
        if self.user is not None and self.security == "none":
            raise PydanticCustomError("in_the_clear", "a password is sent only with starttls or tls.")
        return self


class WebhookConfig(StrictModel):
    """A JSON object, sent to an address by POST: ``id occasion subject text run folder utc``."""

    url: Url | None = None
    url_env: Variable | None = None

    @model_validator(mode="after")
    def _one_address(self) -> WebhookConfig:
        if (self.url is None) == (self.url_env is None):
            raise PydanticCustomError("one_address", "give either url or url_env.")
        return self


class AppriseConfig(StrictModel):
    """A service that the library apprise supports (chat, telephone, ...). Its address is a secret."""

    url_env: Variable


class MessagesConfig(StrictModel):
    """Occasions of messages, and their channels."""

    occasions: tuple[Occasion, ...] = ("failure", "hold", "end")
    mail: MailConfig | None = None
    webhooks: Annotated[tuple[WebhookConfig, ...], Field(max_length=20)] = ()
    apprise: Annotated[tuple[AppriseConfig, ...], Field(max_length=20)] = ()
