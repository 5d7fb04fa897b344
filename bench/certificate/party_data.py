"""The parts of a certificate about who calibrated what, for whom and how: data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

PlaceKind = Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]


@dataclass(frozen=True)
class Address:
    """A postal address."""

    # street, post_code, city: Street with its number, post code, city; empty where there is none.
    street: str
    post_code: str
    city: str
    country: str  # Code of the country, two letters (ISO 3166-1)

    @property
    def lines(self) -> tuple[str, ...]:
        """The address as it is printed."""
        return tuple(filter(None, (self.street, f"{self.post_code} {self.city}".strip(), self.country)))


@dataclass(frozen=True)
class Contact:
    """How to reach somebody."""

    # name, email, phone: Person or office, mail address, telephone number; empty where there is none.
    name: str
    email: str
    phone: str


@dataclass(frozen=True)
class Accreditation:
    """The accreditation of the laboratory."""

    body: str
    number: str
    scope: str


@dataclass(frozen=True)
class Laboratory:
    """The laboratory that calibrated (ISO/IEC 17025, 7.8.2.1 b and c)."""

    name: str
    address: Address
    contact: Contact
    accreditation: Accreditation | None  # Its accreditation; None if it has none for this calibration
    # place_kind, place: Kind of the place where it calibrated (a word of the DCC), and the place in words.
    place_kind: PlaceKind
    place: str


@dataclass(frozen=True)
class Customer:
    """The customer (7.8.2.1 e)."""

    name: str
    contact: Contact
    address: Address


@dataclass(frozen=True)
class Camera:
    """The calibrated camera, as it identified itself in the run."""

    # maker, model, sensor, serial, firmware: What the camera reported; empty where it reports nothing.
    maker: str
    model: str
    sensor: str
    serial: str
    firmware: str
    image_size: tuple[int, ...]  # Width and height, px
    biases: tuple[str, ...]  # Biases and their values as text, sorted by name; empty for a frame camera
    biases_sha256: str  # SHA-256 of the biases; empty for a frame camera


@dataclass(frozen=True)
class Lens:
    """The lens. Camera and lens are calibrated as one."""

    # maker, model, serial: Identification; empty where there is none.
    maker: str
    model: str
    serial: str
    focus: str
    aperture: str
    # focus_locked, aperture_locked: Whether each is locked.
    focus_locked: bool
    aperture_locked: bool


@dataclass(frozen=True)
class Item:
    """The calibrated item (7.8.2.1 g)."""

    camera: Camera
    lens: Lens
    customer_id: str  # The customer's own number of the item; empty if there is none
    condition: str


@dataclass(frozen=True)
class Method:
    """The method of calibration (7.8.2.1 f)."""

    id: str
    version: str
    text: str


@dataclass(frozen=True)
class Deviation:
    """A deviation from the method, an addition or an exclusion (7.8.2.1 n)."""

    text: str
    # ``run`` if the sealed run states it, ``laboratory`` if the laboratory does.
    source: Literal["run", "laboratory"]


@dataclass(frozen=True)
class Condition:
    """A condition that influences the result (7.8.4.1 b)."""

    name: str  # Name of the condition, such as ``room temperature``
    value: float | None  # Its value; None if it is stated in words
    unit: str  # Unit, ``1`` for none
    # U, k: Expanded uncertainty and its coverage factor; None if not stated.
    U: float | None
    k: float | None
    text: str  # The condition in words; empty if it has a value
    source: str  # ``run``, or the instrument with the number of its certificate


@dataclass(frozen=True)
class Traceability:
    """A reference to which the results are traceable (7.8.4.1 c)."""

    what: str  # The reference, such as ``focal length of the collimator``
    # value, U, k, unit: Its value, expanded uncertainty, coverage factor and unit; None where not stated.
    value: float | None
    U: float | None
    k: float | None
    unit: str
    # number, issuer, date, sha256: Number, issuer and date of its certificate, and SHA-256 of the
    # certificate's file; empty where not stated.
    number: str
    issuer: str
    date: str
    sha256: str
    statement: str


@dataclass(frozen=True)
class AuthorisedBy:
    """The person who is to authorise the certificate (7.8.2.1 o). The signature itself lies beside the seal."""

    # name, role, key_fingerprint: Name, role, and fingerprint of the person's key (``SHA256:...``).
    name: str
    role: str
    key_fingerprint: str
