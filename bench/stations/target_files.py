"""The reticle of a station: what it is good for with a lens and a collimator, and its drawing as a file.

The camera looks along an ideal collimator's axis at the middle of the tag, without roll. No result depends on these
numbers; limits of warnings were measured on simulated images (docs/target.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bench.base.errors import UsageError
from bench.stations.station import Station
from bench.stations.station_fields import TargetConfig
from calib.target import StarTarget

_CLEAR_SEGMENT_PX, _LEAST_SEGMENT_PX = 2.2, 1.6
"""Width of a segment at 0.4 pitches from the centre: all stars are found; below the second number hardly any."""
_LEAST_TAG_PX = 45.0
"""A tag with sides shorter than 0.03 of the image's longer side (38 px of 1280) is not looked for."""
_TAG_SHARE = 0.5
"""A tag larger than this share of the image's shorter side is often cut by the frame."""
_FEW_STARS, _GOOD_STARS = 40, 100
"""The default gate of a recording, and a number that leaves room for poses at the edge."""
_FAMILIES = ("36h11", "36h10")
_SEGMENTS = (12, 16, 24, 32)
"""Numbers of segments with which stars are found when the frame cuts the tag."""


@dataclass(frozen=True)
class Optics:
    """Lens, sensor and beam with which a target is used."""

    focal_px: float  # Focal length of the lens, px
    r_mm: float  # Focal length of the collimator, mm
    image_size: tuple[int, int]  # Width and height, px
    half_angle_deg: float | None  # Half angle of the beam; None if it is unknown


@dataclass(frozen=True)
class TargetUse:
    """What a target is good for."""

    stars: int
    pitch_px: float
    stars_in_view: int  # Whole stars that the camera sees when it looks at the tag
    segment_px: float  # Width of a star's segment at 0.4 pitches from its centre
    tag_px: float
    camera_deg: tuple[float, float]
    target_deg: tuple[float, float, float, float]
    beam_deg: float | None  # Full angle of the beam; None if it is unknown
    warnings: tuple[str, ...]


def optics_of(station: Station) -> Optics:
    """Return the optics as the station states them; `UsageError` if a value is not stated."""
    expected, collimator = station.expected, station.collimator
    certificate = collimator.certificate
    stated = certificate.r_mm if certificate is not None and not isinstance(certificate, str) else None
    if expected is None:
        raise UsageError(
            "The focal length of the lens is not known.",
            where="expected.focal_px",
            remedy="Add the section `expected` to the station file.",
        )
    known_r = stated or collimator.nominal_r_mm or expected.r_mm
    return Optics(expected.focal_px, known_r, expected.image_size, expected.half_angle_deg)


def use_of(target: TargetConfig, optics: Optics) -> TargetUse:
    """Return what a target, a section of a station, is good for with a lens and a collimator.

    X mm off the axis are seen in the direction X / r, f X / r px off the middle (Hartley and Zisserman, 2004, 6.1).
    """
    pattern = target.pattern()
    px_per_mm = optics.focal_px / optics.r_mm
    pitch_px, (width, height) = pattern.pitch_mm * px_per_mm, optics.image_size
    middle = np.array(pattern.tag_centre_mm)
    places = pattern.positions_mm(pattern.ids) - middle
    whole = (np.abs(places) * px_per_mm + 0.5 * pitch_px <= 0.5 * np.array([width, height])).all(axis=1)
    if optics.half_angle_deg is not None:
        beam_mm = optics.r_mm * math.tan(math.radians(optics.half_angle_deg))
        whole &= np.linalg.norm(places, axis=1) + pattern.pitch_mm * math.sqrt(0.5) <= beam_mm
    first, last = -0.5 * pattern.pitch_mm - middle, np.array([pattern.columns, pattern.rows]) - 0.5
    sides = [
        -first[0],
        last[0] * pattern.pitch_mm - middle[0],
        -first[1],
        last[1] * pattern.pitch_mm - middle[1],
    ]
    left, right, up, down = (math.degrees(math.atan(float(side) / optics.r_mm)) for side in sides)
    use = TargetUse(
        stars=len(pattern.ids),
        pitch_px=pitch_px,
        stars_in_view=int(np.count_nonzero(whole)),
        segment_px=2.0 * math.pi * 0.4 * pitch_px / pattern.segments,
        tag_px=pattern.tag_squares * pitch_px,
        camera_deg=(_full_deg(width, optics), _full_deg(height, optics)),
        target_deg=(left, right, up, down),
        beam_deg=None if optics.half_angle_deg is None else 2.0 * optics.half_angle_deg,
        warnings=(),
    )
    return replace(use, warnings=tuple(_warnings(use, pattern, optics)))


def _full_deg(pixels: int, optics: Optics) -> float:
    """Return the angle that a side of the image covers."""
    return 2.0 * math.degrees(math.atan(0.5 * pixels / optics.focal_px))


def _warnings(use: TargetUse, pattern: StarTarget, optics: Optics) -> list[str]:
    """Return what speaks against a target."""
    warnings = []
    if use.segment_px < _CLEAR_SEGMENT_PX:
        share = "hardly any star is" if use.segment_px < _LEAST_SEGMENT_PX else "some stars are not"
        wanted = math.ceil(100.0 * pattern.pitch_mm * _CLEAR_SEGMENT_PX / use.segment_px) / 100.0
        warnings.append(
            f"A segment of a star is {use.segment_px:.1f} px wide: {share} found. Use a pitch of at least"
            f" {wanted:g} mm, fewer segments, or a longer lens."
        )
    if use.stars_in_view < _GOOD_STARS:
        worse = (
            "fewer than a recording needs" if use.stars_in_view < _FEW_STARS else "few for poses at the edge"
        )
        warnings.append(
            f"{use.stars_in_view} stars in view are {worse}: use a smaller pitch, a shorter lens or a wider beam."
        )
    if use.tag_px < _LEAST_TAG_PX:
        warnings.append(
            f"The tag is {use.tag_px:.0f} px wide: too small to be read. Use more squares for it (tag_squares)."
        )
    if use.tag_px > _TAG_SHARE * min(optics.image_size):
        warnings.append(
            f"The tag is {use.tag_px:.0f} px wide, more than half of the image's height: the frame cuts it in many"
            " poses. Use fewer squares for it (tag_squares), or a smaller pitch."
        )
    if pattern.tag_family not in _FAMILIES:
        warnings.append(
            f"Tags of family {pattern.tag_family} have few bits: stars are misread for a tag more easily. Use 36h11."
        )
    if pattern.segments not in _SEGMENTS:
        warnings.append(
            f"With {pattern.segments} segments, stars may not be found while the frame cuts the tag. Use 16."
        )
    if optics.half_angle_deg is not None and min(use.target_deg) < optics.half_angle_deg:
        warnings.append(
            f"The target ends {min(use.target_deg):.1f} degrees from the tag, inside the beam of"
            f" {optics.half_angle_deg:g} degrees: poses at the edge of the beam see no stars there."
        )
    return warnings
