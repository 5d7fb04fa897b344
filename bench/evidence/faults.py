"""One fault of a sealed folder, as every check of evidence reports it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SealFault:
    """One fault of a sealed folder."""

    # ``unsealed``, ``signature``, ``key``, ``manifest``, ``added``, ``changed``, ``missing``, ``link``,
    # ``kind``, ``form``, ``journal``, ``plan``, ``results``, ``exports``, ``report``, ``views``, ``recording``,
    # ``wire``, ``instructions``, ``certificate``, ``ledger``, ``item``, ``authorisation`` or ``timestamp``.
    kind: str
    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"
