"""Names of the aberrations of collimators that a passport may hold, those of earlier versions included.

``radial`` and ``radial_4`` are |h|^2 h and |h|^4 h, with the field h in units of r. The others follow the camera's
place in the pupil; the joint adjustment has fields by the turn for these (docs/adjustment.md).
"""

from __future__ import annotations

ABERRATIONS = frozenset(
    {
        "pupil_shift",
        "radial",
        "radial_4",
        "field_curve",
        "tilt_x",
        "tilt_y",
        "coma",
        "coma_round",
        "astigmatism",
        "rim_4",
        "rim_10",
    }
)
