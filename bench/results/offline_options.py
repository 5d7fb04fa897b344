"""Options of an offline calibration, parsed from the command line."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self, get_args

from bench.base.errors import UsageError
from bench.results.passports import read_passport
from bench.results.point_files import Origin
from bench.stations.station import load_station
from calib.engine import CalibrationOptions
from calib.errors import CalibrationError
from calib.target import StarTarget
from sequences.schema import ImageKind


@dataclass(frozen=True)
class OfflineOptions:
    """Options of an offline calibration.

    Attributes
    ----------
    options
        Options of the engine.
    image_size
        Width and height for point files, px.
    view_numbers
        Numbers of the views to use, from 1; None for all.
    image
        Kind of event image for RAW captures.
    origin
        Pixel origin of point files.
    target
        The printed target.
    """

    options: CalibrationOptions = field(default_factory=CalibrationOptions)
    image_size: tuple[int, int] | None = None
    view_numbers: tuple[int, ...] | None = None
    image: str = "auto"
    origin: Origin = "corner"
    target: StarTarget = field(default_factory=StarTarget)

    @classmethod
    def from_command_line(
        cls,
        *,
        model: str,
        distortion: str,
        loss: str,
        image_size: str | None,
        views: str | None,
        image: str,
        origin: str,
        station: str | None,
        passport: Path | None = None,
        guard_band: float = 1.0,
    ) -> Self:
        """Parse the options of the command line.

        Parameters
        ----------
        model, distortion, loss
            Options of the engine, see `CalibrationOptions`.
        image_size
            Width and height for point files, as ``1280x720``.
        views
            Numbers of the views to use, as ``1,5,9``.
        image
            Kind of event image.
        origin
            ``corner`` or ``centre``.
        station
            Path or name of the station whose target was recorded; None for the standard target.
        passport
            Passport file of the collimator.
        guard_band
            Fraction of the visible disc's radius beyond which stars are left out, see `CalibrationOptions`.

        Returns
        -------
        OfflineOptions
            The parsed options.

        Raises
        ------
        UsageError
            When an option is invalid; the message names it.
        """
        try:
            options = CalibrationOptions(
                model,  # type: ignore[arg-type]
                distortion,
                loss,  # type: ignore[arg-type]
                passport=read_passport(passport) if passport else None,
                guard_band=guard_band,
            )
        except CalibrationError as error:
            raise UsageError(error.what, remedy=error.remedy) from error
        if image not in get_args(ImageKind):
            raise UsageError(
                f"Unknown event image {image!r}.", remedy=f"Known are {', '.join(get_args(ImageKind))}."
            )
        return cls(
            options,
            _parse_image_size(image_size),
            _parse_view_numbers(views),
            image,
            "centre" if origin == "centre" else "corner",
            load_station(station).value.target.pattern() if station else StarTarget(),
        )


def _parse_image_size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"([1-9]\d{0,5})[xX]([1-9]\d{0,5})", text.strip())
    if found is None:
        raise UsageError(
            f"{text!r} is not an image size.",
            where="--image-size",
            remedy="Write it as WIDTHxHEIGHT: 1280x720.",
        )
    return int(found[1]), int(found[2])


def _parse_view_numbers(text: str | None) -> tuple[int, ...] | None:
    if text is None:
        return None
    words = [word.strip() for word in text.split(",")]
    if not all(re.fullmatch(r"[1-9]\d{0,5}", word) for word in words) or len(set(words)) != len(words):
        raise UsageError(
            f"{text!r} is not a list of view numbers.",
            where="--views",
            remedy="Write different numbers from 1, for example 1,5,9.",
        )
    return tuple(int(word) for word in words)
