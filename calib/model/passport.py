"""The passport of a collimator: its calibrated parameters, with which one to three views calibrate a camera.

A passport is a Gaussian over the collimator's parameters, with its origin. Focal length and radius are nearly one
parameter (correlation 0.998), so a known radius determines the focal length. The values of the passport are held: one
to three views cannot improve them. Their uncertainty is propagated to the camera. This module reads and writes plain
numbers; other modules read and write files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib.arrays import Array, ReadOnlyArrays
from calib.errors import InputMismatch
from calib.model.collimator import CENTRE, Collimator
from calib.model.target_focus import CertifiedLength

SCHEMA = "starbench/collimator-passport/1"


@dataclass(frozen=True)
class Passport(ReadOnlyArrays):
    """Calibrated parameters of a collimator.

    Parameters
    ----------
    names, values
        Names and (K,) float64 values of the known parameters: of x, y, r, mm, and of the aberrations. r is required.
    covariance
        (K, K) float64 joint covariance of the values.
    reference
        Centre (x, y, r), mm, about which the aberrations are expressed; None if there are none.
    birge_ratio
        How many times more than star noise explains the views differed from which the passport was made; 1 for a
        certificate.
    views
        Names of those views.
    conditions
        Further facts: serial number, temperature, date, certificate.
    length
        Which length r is, if a certificate states it. That of a passport from views is what the camera saw.

    Raises
    ------
    InputMismatch
        If shapes differ, a number is not finite, the covariance is not positive semidefinite, r is missing, or
        aberrations have no reference.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    reference: tuple[float, float, float] | None = None
    birge_ratio: float = 1.0
    views: tuple[str, ...] = ()
    conditions: Mapping[str, Any] = field(default_factory=dict)
    length: CertifiedLength = CertifiedLength.UNSAID

    def __post_init__(self) -> None:
        super().__post_init__()
        fault = self._fault()
        if fault:
            raise InputMismatch(fault, where="passport")

    def _fault(self) -> str:
        """Return why there is no such passport; empty if there is."""
        n, shapes = len(set(self.names)), (self.values.shape, self.covariance.shape)
        if shapes != ((n,), (n, n)):
            return f"{n} parameters, but values of shape {shapes[0]} and a covariance of shape {shapes[1]}."
        if not (np.isfinite(self.values).all() and np.isfinite(self.covariance).all()):
            return "It contains numbers that are not finite."
        eigenvalues = np.linalg.eigvalsh(self.covariance)
        if not np.allclose(self.covariance, self.covariance.T) or eigenvalues[0] < -1e-9 * eigenvalues[-1]:
            return "Its covariance is not symmetric and positive semidefinite."
        if "r" not in self.names:
            return "It does not contain the radius r."
        if not self.values[self.names.index("r")] > 0:
            return "Its radius r is not positive."
        return "Its aberrations have no reference." if self.terms and self.reference is None else ""

    @classmethod
    def of_radius(
        cls,
        r_mm: float,
        sigma_mm: float,
        conditions: Mapping[str, Any] | None = None,
        length: str = CertifiedLength.UNSAID,
    ) -> Passport:
        """Return the passport of a collimator of which only one length is certified.

        Parameters
        ----------
        r_mm
            The certified length, mm.
        sigma_mm
            Standard uncertainty of the length, mm.
        conditions
            Further facts, for example the number of the certificate.
        length
            Which length it is (`CertifiedLength`): ``focal_length``, as makers state it, or ``seen`` by a camera on
            this bench. They differ if the target is out of focus. Empty: both are weighed by what the views show.

        Returns
        -------
        Passport
            Passport of r alone.

        Raises
        ------
        InputMismatch
            If the length is not positive, its uncertainty negative, or its kind unknown.
        """
        if isinstance(r_mm, str) or isinstance(sigma_mm, str):
            raise InputMismatch(
                "Its radius or its sigma is a text.", where="passport", remedy="Give numbers."
            )
        if not sigma_mm >= 0:
            raise InputMismatch(f"Its sigma is {sigma_mm} mm; it must not be negative.", where="passport")
        if sigma_mm > abs(r_mm):
            raise InputMismatch(
                f"Its sigma, {sigma_mm} mm, is larger than its radius, {r_mm} mm.",
                where="passport",
                remedy="Give the radius first, then its standard uncertainty.",
            )
        if length not in list(CertifiedLength):
            raise InputMismatch(
                f"Unknown length {length!r}.",
                where="passport",
                remedy=f"Known: {', '.join(filter(None, CertifiedLength))}; empty if nothing says which.",
            )
        variance = np.array([[sigma_mm**2]])
        kind = CertifiedLength(length)
        return cls(("r",), np.array([r_mm]), variance, conditions=conditions or {}, length=kind)

    @property
    def is_certificate(self) -> bool:
        """Whether it states the radius alone, as a certificate does; no views of this collimator went into it."""
        return self.names == ("r",) and not self.views

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the known aberrations."""
        return tuple(name for name in self.names if name not in CENTRE)

    @property
    def values_by_name(self) -> Mapping[str, float]:
        """The known parameters by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))

    def collimator(self, fallback: Collimator) -> Collimator:
        """Return the collimator; x, y or r come from another one if the passport does not contain them.

        Parameters
        ----------
        fallback
            Collimator that gives the missing coordinates of the centre.

        Returns
        -------
        Collimator
            Collimator with the aberrations and the reference of the passport.
        """
        start = Collimator(fallback.x, fallback.y, fallback.r, dict.fromkeys(self.terms, 0.0), self.reference)
        return start.with_values(self.values_by_name)

    def subset(self, names: Sequence[str]) -> Passport:
        """Return the passport of some of its parameters.

        Parameters
        ----------
        names
            Names of the parameters to keep; names that the passport does not contain are ignored.

        Returns
        -------
        Passport
            Passport of these parameters.
        """
        kept = tuple(name for name in self.names if name in names)
        at = [self.names.index(name) for name in kept]
        return replace(self, names=kept, values=self.values[at], covariance=self.covariance[np.ix_(at, at)])

    def to_dict(self) -> dict[str, Any]:
        """Return the passport as plain numbers, lists and names, ready for JSON.

        Returns
        -------
        dict of str to Any
            Keys: schema, names, values, covariance, reference, disagreement (the Birge ratio), views, conditions;
            length if it is known which a certificate states.
        """
        length = {"length": str(self.length)} if self.length else {}
        return length | {
            "schema": SCHEMA,
            "names": list(self.names),
            "values": self.values.tolist(),
            "covariance": self.covariance.tolist(),
            "reference": list(self.reference) if self.reference else None,
            "disagreement": self.birge_ratio,
            "views": list(self.views),
            "conditions": dict(self.conditions),
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Passport:
        """Read the result of `to_dict`.

        Parameters
        ----------
        document
            Plain numbers, lists and names, as `to_dict` returns them.

        Returns
        -------
        Passport
            The passport.

        Raises
        ------
        InputMismatch
            If the document is not a passport, or its numbers contradict each other.
        """
        if document.get("schema") != SCHEMA:
            raise InputMismatch(
                f"Not a passport: its schema is {document.get('schema')!r}.", where="passport"
            )
        try:
            reference = document["reference"]
            if reference is not None:
                x, y, r = map(float, reference)
                reference = x, y, r
            return cls(
                tuple(str(name) for name in document["names"]),
                np.array(document["values"], float),
                np.array(document["covariance"], float),
                reference,
                float(document["disagreement"]),
                tuple(str(name) for name in document["views"]),
                dict(document["conditions"]),
                CertifiedLength(document.get("length", "")),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputMismatch(f"Not a passport: {error}.", where="passport") from error
