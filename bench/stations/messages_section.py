"""The messages section of a station file: on which occasions messages are sent, and by which service.

A station file has no secrets, because it is copied into every run folder. It names the environment variables that hold
passwords and secret addresses.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from bench.stations.station_fields import Text, Variable
from sequences.reader import Located
from sequences.strict_model import Form, StrictModel
from sequences.tree import Fault

Occasion = Literal["failure", "hold", "end"]
Address = Annotated[
    str,
    Field(max_length=254),
    Form(r"^[^\s@<>\"]+@[^\s@<>\"]+$", "one address such as lab@example.org, without a name"),
]
WEBHOOKS_LEFT = (
    "webhooks are served by apprise: put the address, with jsons:// in place of https:// (json:// of http://), into an "
    "environment variable, and write apprise: [{url_env: NAME}]"
)
"""What to write in place of ``webhooks``, which station files had once."""


class MailConfig(StrictModel):
    """Mail, sent by SMTP."""

    kind: ClassVar[str] = "mail"

    host: Text
    port: Annotated[int, Field(ge=1, le=65535)] = 587  # Submission of mail (RFC 6409)
    security: Literal["starttls", "tls", "none"] = "starttls"
    sender: Address
    to: Annotated[tuple[Address, ...], Field(min_length=1, max_length=50)]
    user: Text | None = None
    password_env: Variable | None = None

    @model_validator(mode="after")
    def _never_in_the_clear(self) -> MailConfig:
        if (self.user is None) != (self.password_env is None):
            raise ValueError("user and password_env must be given together.")
        if self.user is not None and self.security == "none":
            raise ValueError("a password is sent only with starttls or tls.")
        return self


class AppriseConfig(StrictModel):
    """A service that the library apprise supports (chat, telephone, webhook, ...). Its address is a secret."""

    kind: ClassVar[str] = "apprise"

    url_env: Variable


Channel = MailConfig | AppriseConfig


class MessagesConfig(StrictModel):
    """Occasions of messages, and their channels."""

    occasions: tuple[Occasion, ...] = ("failure", "hold", "end")
    mail: MailConfig | None = None
    apprise: Annotated[tuple[AppriseConfig, ...], Field(max_length=20)] = ()
    # In copies of runs that have begun; `find_webhooks` refuses it elsewhere
    webhooks: SkipJsonSchema[Any] = None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels."""
        return (*([self.mail] if self.mail is not None else []), *self.apprise)


def find_webhooks(station: Located[Any]) -> list[Fault]:
    """Refuse the section ``webhooks``, with what to write in its place."""
    if station.value.messages.webhooks is None:
        return []
    return [station.fault(("messages", "webhooks"), f"{WEBHOOKS_LEFT}.")]
