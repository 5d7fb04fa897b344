"""What a station file says about messages: when, and to whom, by mail, webhook or another service.

No secret stands in a station file, for it is copied into every run folder: passwords and secret addresses are named by
the environment variable that holds them.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.station_fields import Text
from sequences.schema import StrictModel

Occasion = Literal["failure", "hold", "end"]
Address = Annotated[str, Field(max_length=254, pattern=r"^[^\s@<>\"]+@[^\s@<>\"]+$")]
Variable = Annotated[str, Field(max_length=100, pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Url = Annotated[str, Field(max_length=2000, pattern=r"^https?://[^\s]+$")]


class MailConfig(StrictModel):
    """Mail by SMTP."""

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
            raise PydanticCustomError("half_login", "user and password_env belong together.")
        if self.user is not None and self.security == "none":
            raise PydanticCustomError("in_the_clear", "a password is not sent without starttls or tls.")
        return self


class WebhookConfig(StrictModel):
    """A JSON object posted to an address: ``id occasion subject text run folder utc``."""

    url: Url | None = None
    url_env: Variable | None = None

    @model_validator(mode="after")
    def _one_address(self) -> WebhookConfig:
        if (self.url is None) == (self.url_env is None):
            raise PydanticCustomError("one_address", "give either url or url_env.")
        return self


class AppriseConfig(StrictModel):
    """Any service that the library apprise knows (chat, telephone, ...), by its address, which is a secret."""

    url_env: Variable


class MessagesConfig(StrictModel):
    """Who hears what of a run."""

    occasions: tuple[Occasion, ...] = ("failure", "hold", "end")
    mail: MailConfig | None = None
    webhooks: Annotated[tuple[WebhookConfig, ...], Field(max_length=20)] = ()
    apprise: Annotated[tuple[AppriseConfig, ...], Field(max_length=20)] = ()
