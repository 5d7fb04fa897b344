"""Focus of the camera's lens: breathing, blur and brightness, by the thin lens.

The lens is thin and sits at the entrance pupil. It is focused by moving it along its axis. With the focal length f, the
aperture A = f / N and the focus distance d, the sensor stands at v, 1 / v = 1 / f - 1 / d, which is f (1 + m) with
m = f / (d - f). A point at the distance s is sharp at v_s, 1 / v_s = 1 / f - 1 / s. On the sensor, its light fills a
disc of the diameter A |v - v_s| / v_s = A v |1 / d - 1 / s|, evenly, around the point where its ray through the middle
of the aperture (the chief ray) arrives. That point is the one of the pinhole model with the image distance v.

The pattern behind the collimator is at infinity; if the collimator has the error ``defocus``, at r / defocus. A
``defocus`` above 0 is that of a near target, and the same number moves the pattern when the camera is shifted.

References
----------
- Hecht, Optics: section 5.2 (thin lenses), section 5.3 (stops, f-number, brightness of the image).
- Potmesil and Chakravarty (1981), A lens and aperture camera model for synthetic image generation, Computer Graphics 15
  (SIGGRAPH), 297: circle of confusion.
- Goodman, Introduction to Fourier Optics, chapter 2: Fourier transform of an even disc.

Not modelled: pupils apart from the lens, aberrations of the lens that change with focus or aperture, diffraction (all
are in ``optics.psf_px``), and the collimator's field curvature and astigmatism in the blur.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import j1

from simulators.world.truth import (
    BEYOND_M,
    CLOSEST_M,
    DELIVERED_F_NUMBER,
    LENS_LAW,
    RING_SPAN_DEG,
    CameraTruth,
    LensTruth,
    Truth,
)

SEAM_PX: Final = 24
"""Pixels, at least, over which the end of an image passes into its beginning."""

SHARP_PX: Final = 0.02
"""Diameter of a blur that is left out: it widens the point spread by less than 1e-4."""


class Focus(NamedTuple):
    """Lens and sensor as they stand."""

    focal_mm: float
    distance_m: float  # Focus distance d; infinite for parallel light, negative beyond infinity
    image_mm: float
    stretch: float


def focus_of(truth: Truth) -> Focus:
    """Return lens and sensor as they stand.

    Source: Gaussian lens formula, Hecht, Optics, section 5.2. As delivered, the image distance is that of section
    ``camera``, and the lens is focused on the pattern.
    """
    delivered_mm = truth.lens.pixel_um * 1e-3 * 0.5 * (truth.camera.fx + truth.camera.fy)
    vergence = pattern_vergence_per_m(truth)
    focal_mm = 1.0 / (1.0 / delivered_mm + vergence * 1e-3)
    distance_m = truth.lens.focus_distance_m
    if distance_m is None:
        return Focus(focal_mm, 1.0 / vergence if vergence else math.inf, delivered_mm, 1.0)
    image_mm = 1.0 / (1.0 / focal_mm - 1e-3 / distance_m)
    return Focus(focal_mm, distance_m, image_mm, image_mm / delivered_mm)


def pattern_vergence_per_m(truth: Truth) -> float:
    """Return the reciprocal of the pattern's distance behind the collimator, 1 / m; 0 at infinity.

    It is negative for converging light. Own derivation: a shift t of the camera moves the pattern by -defocus t on the
    target, which is the angle defocus t / r; a point at the distance s moves by t / s.
    """
    return truth.collimator.defocus / truth.collimator.r * 1e3


def camera_of(truth: Truth) -> CameraTruth:
    """Return the camera with the present focal lengths (Hecht, Optics, section 5.2): the lens breathes."""
    stretch = focus_of(truth).stretch
    return replace(truth.camera, fx=truth.camera.fx * stretch, fy=truth.camera.fy * stretch)


def blur_px(truth: Truth) -> float:
    """Return the diameter of the disc over which the light of a point is spread; see `signed_blur_px`."""
    return abs(signed_blur_px(truth))


def signed_blur_px(truth: Truth, vergence_per_m: float | None = None) -> float:
    """Return the diameter of the disc of light, px; positive if the lens is focused nearer than the point.

    Circle of confusion (Potmesil and Chakravarty, 1981), linear in the vergence; None is the pattern's.
    """
    if truth.lens.focus_distance_m is None:
        return 0.0
    focus = focus_of(truth)
    seen = pattern_vergence_per_m(truth) if vergence_per_m is None else vergence_per_m
    aperture_mm = focus.focal_mm / truth.lens.f_number
    blur_mm = aperture_mm * focus.image_mm * (1.0 / focus.distance_m - seen) * 1e-3
    return blur_mm * 1e3 / truth.lens.pixel_um


def brightness(truth: Truth) -> float:
    """Return the relative light on the sensor: squared aperture over image distance (Hecht, Optics, section 5.3)."""
    return (DELIVERED_F_NUMBER / truth.lens.f_number / focus_of(truth).stretch) ** 2


def reach_px(diameter_px: float) -> int:
    """Return how far outside the image, px, a scene must be known to blur it; 0 without a blur."""
    return math.ceil(0.5 * diameter_px) + 1 if diameter_px >= SHARP_PX else 0


def spread_over_disc(image: NDArray[np.float32], diameter_px: float) -> NDArray[np.float32]:
    """Return an image whose points are spread evenly over discs, without its border; at least 0.

    The transfer function of an even disc is 2 J1(pi b q) / (pi b q) at the spatial frequency q (Goodman, Introduction
    to Fourier Optics, chapter 2). So no disc is drawn into pixels, and the time does not depend on b. The image is
    (height + 2 n, width + 2 n) float32, n = `reach_px` of the diameter; it is returned as given without a blur.
    """
    margin = reach_px(diameter_px)
    return blurred(image, diameter_px, margin) if margin else image


def blurred(image: NDArray[np.float32], diameter_px: float, margin_px: int) -> NDArray[np.float32]:
    """Return an image blurred over a disc, cropped at each edge by a margin of half the diameter or more."""
    height, width = image.shape
    rows, columns = (int(fft.next_fast_len(n + SEAM_PX, real=True)) for n in image.shape)
    padded = np.empty((rows, columns), np.float32)
    padded[:height, :width] = image
    across = (np.arange(columns - width, dtype=np.float32) + 1.0) / (columns - width + 1)
    padded[:height, width:] = image[:, -1:] + across * (image[:, :1] - image[:, -1:])
    down = (np.arange(rows - height, dtype=np.float32)[:, None] + 1.0) / (rows - height + 1)
    padded[height:] = padded[height - 1] + down * (padded[0] - padded[height - 1])
    spectrum = np.asarray(fft.rfft2(padded), np.complex64) * _disc_transfer(
        rows, columns, round(diameter_px, 6)
    )
    inside = fft.irfft2(spectrum, s=(rows, columns))[
        margin_px : height - margin_px, margin_px : width - margin_px
    ]
    return np.maximum(inside, np.float32(0.0), dtype=np.float32)


@lru_cache(maxsize=8)
def _disc_transfer(rows: int, columns: int, diameter_px: float) -> NDArray[np.float32]:
    """Return the transfer function of an even disc, (rows, columns // 2 + 1)."""
    q = np.hypot(fft.fftfreq(rows)[:, None], fft.rfftfreq(columns)[None, :])
    x = math.pi * diameter_px * q
    # J1 is slow; it is a smooth function of one variable, so it is tabulated and interpolated (to 1e-5).
    table_x = np.arange(0.0, float(x.max()) + 0.02, 0.01)
    table = np.ones_like(table_x)
    table[1:] = 2.0 * j1(table_x[1:]) / table_x[1:]
    return np.interp(x, table_x, table).astype(np.float32)


def ring_deg(truth: Truth) -> float:
    """Return the focus ring's place, degrees from infinity, negative beyond; own model: proportional to v - f."""
    focus = focus_of(truth)
    return _ring_deg(focus.focal_mm, focus.distance_m)


def _ring_deg(focal_mm: float, distance_m: float) -> float:
    """Return the ring's angle for a focus distance."""
    return RING_SPAN_DEG * _magnification(focal_mm, distance_m) / _magnification(focal_mm, CLOSEST_M)


def _magnification(focal_mm: float, distance_m: float) -> float:
    """Return m = f / (d - f)."""
    return focal_mm / (distance_m * 1e3 - focal_mm)


def with_ring_at(truth: Truth, angle_deg: float) -> LensTruth:
    """Return the lens with its ring turned to an angle, or to the stop before it."""
    focal_mm = focus_of(truth).focal_mm
    angle_deg = min(max(angle_deg, _ring_deg(focal_mm, BEYOND_M)), RING_SPAN_DEG)
    m = angle_deg / RING_SPAN_DEG * _magnification(focal_mm, CLOSEST_M)
    distance_m = focal_mm * (1.0 + 1.0 / m) * 1e-3 if m else math.inf
    return replace(truth.lens, focus_distance_m=distance_m)


def truth_record(truth: Truth) -> dict[str, Any]:
    """Return all parameters as plain numbers, as ``Truth.to_dict``: the content of ``truth.json``.

    ``fx`` and ``fy`` of the camera are those of the present focus. Section ``lens`` holds focus, aperture, blur and the
    law.
    """
    record, focus = replace(truth, camera=camera_of(truth)).to_dict(), focus_of(truth)
    record["lens"] = {
        "focus": "on the pattern" if truth.lens.focus_distance_m is None else "turned",
        "focus_distance_m": focus.distance_m if math.isfinite(focus.distance_m) else None,
        "ring_deg": ring_deg(truth),
        "f_number": truth.lens.f_number,
        "pixel_um": truth.lens.pixel_um,
        "focal_mm": focus.focal_mm,
        "image_distance_mm": focus.image_mm,
        "breathing": focus.stretch,
        "blur_px": blur_px(truth),
        "brightness": brightness(truth),
        "law": dict(LENS_LAW),
    }
    return record
