"""The parts of a certificate about who calibrated what, for whom and how: data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

PlaceKind = Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]


@dataclass(frozen=True)
class Address:
    """A postal address.

    Attributes
    ----------
    street, post_code, city
        Street with its number, post code, city; empty where there is none.
    country
        Code of the country, two letters (ISO 3166-1).
    """

    street: str
    post_code: str
    city: str
    country: str

    @property
    def lines(self) -> tuple[str, ...]:
        """The address as it is printed."""
        return tuple(filter(None, (self.street, f"{self.post_code} {self.city}".strip(), self.country)))


@dataclass(frozen=True)
class Contact:
    """How to reach somebody.

    Attributes
    ----------
    name, email, phone
        Person or office, mail address, telephone number; empty where there is none.
    """

    name: str
    email: str
    phone: str


@dataclass(frozen=True)
class Accreditation:
    """The accreditation of the laboratory.

    Attributes
    ----------
    body, number, scope
        Accreditation body, number of the accreditation, and the scope that covers this calibration.
    """

    body: str
    number: str
    scope: str


@dataclass(frozen=True)
class Laboratory:
    """The laboratory that calibrated (ISO/IEC 17025, 7.8.2.1 b and c).

    Attributes
    ----------
    name, address, contact
        Name, address and contact.
    accreditation
        Its accreditation; None if it has none for this calibration.
    place_kind, place
        Kind of the place where it calibrated (a word of the DCC), and the place in words.
    """

    name: str
    address: Address
    contact: Contact
    accreditation: Accreditation | None
    place_kind: PlaceKind
    place: str


@dataclass(frozen=True)
class Customer:
    """The customer (7.8.2.1 e).

    Attributes
    ----------
    name, contact, address
        Name, contact and address.
    """

    name: str
    contact: Contact
    address: Address


@dataclass(frozen=True)
class Camera:
    """The calibrated camera, as it identified itself in the run.

    Attributes
    ----------
    maker, model, sensor, serial, firmware
        What the camera reported; empty where it reports nothing.
    image_size
        Width and height, px.
    biases
        Biases and their values as text, sorted by name; empty for a frame camera.
    biases_sha256
        SHA-256 of the biases; empty for a frame camera.
    """

    maker: str
    model: str
    sensor: str
    serial: str
    firmware: str
    image_size: tuple[int, ...]
    biases: tuple[str, ...]
    biases_sha256: str


@dataclass(frozen=True)
class Lens:
    """The lens. Camera and lens are calibrated as one.

    Attributes
    ----------
    maker, model, serial
        Identification; empty where there is none.
    focus, aperture
        Setting of focus and aperture, in words.
    focus_locked, aperture_locked
        Whether each is locked.
    """

    maker: str
    model: str
    serial: str
    focus: str
    aperture: str
    focus_locked: bool
    aperture_locked: bool


@dataclass(frozen=True)
class Item:
    """The calibrated item (7.8.2.1 g).

    Attributes
    ----------
    camera, lens
        Camera and lens.
    customer_id
        The customer's own number of the item; empty if there is none.
    condition
        Condition of the item on receipt, in words.
    """

    camera: Camera
    lens: Lens
    customer_id: str
    condition: str


@dataclass(frozen=True)
class Method:
    """The method of calibration (7.8.2.1 f).

    Attributes
    ----------
    id, version, text
        Identification and version of the procedure, and what it does in words.
    """

    id: str
    version: str
    text: str


@dataclass(frozen=True)
class Deviation:
    """A deviation from the method, an addition or an exclusion (7.8.2.1 n).

    Attributes
    ----------
    text
        The deviation.
    source
        ``run`` if the sealed run states it, ``laboratory`` if the laboratory does.
    """

    text: str
    source: Literal["run", "laboratory"]


@dataclass(frozen=True)
class Condition:
    """A condition that influences the result (7.8.4.1 b).

    Attributes
    ----------
    name
        Name of the condition, such as ``room temperature``.
    value
        Its value; None if it is stated in words.
    unit
        Unit, ``1`` for none.
    U, k
        Expanded uncertainty and its coverage factor; None if not stated.
    text
        The condition in words; empty if it has a value.
    source
        ``run``, or the instrument with the number of its certificate.
    """

    name: str
    value: float | None
    unit: str
    U: float | None
    k: float | None
    text: str
    source: str


@dataclass(frozen=True)
class Traceability:
    """A reference to which the results are traceable (7.8.4.1 c).

    Attributes
    ----------
    what
        The reference, such as ``focal length of the collimator``.
    value, U, k, unit
        Its value, expanded uncertainty, coverage factor and unit; None where not stated.
    number, issuer, date, sha256
        Number, issuer and date of its certificate, and SHA-256 of the certificate's file; empty where not stated.
    statement
        To what the reference itself is traceable, in words.
    """

    what: str
    value: float | None
    U: float | None
    k: float | None
    unit: str
    number: str
    issuer: str
    date: str
    sha256: str
    statement: str


@dataclass(frozen=True)
class AuthorisedBy:
    """The person who is to authorise the certificate (7.8.2.1 o). The signature itself lies beside the seal.

    Attributes
    ----------
    name, role, key_fingerprint
        Name, role, and fingerprint of the person's key (``SHA256:...``).
    """

    name: str
    role: str
    key_fingerprint: str
