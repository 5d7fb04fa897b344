"""The one list of what may be otherwise than stated or supposed, each with odds beforehand below their reason.

The views weigh them all by one evidence (`calib.joint.evidence`), and one mixture (`calib.joint.posterior`) gives
value, u and U. Doubts of statements are linear, so one adjustment weighs them together (`calib.joint.doubts`); the
others are adjusted, each by itself, where a bound does not show that they are improbable (`calib.joint.explanations`,
`calib.joint.wrong_views`, `calib.joint.causes`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from calib.model import result_parts as rows


class Hypothesis(NamedTuple):
    """What may be instead of what is stated or supposed."""

    name: str
    odds: float  # Beforehand, against what is stated or supposed
    row: str = ""  # Of the budget: what the difference belongs to, if it is an adjustment of its own


#: The tails of published measurements: 1 in 100 is beyond five times its uncertainty (Bailey, 2017).
LARGER_ERRORS = Hypothesis("errors of a statement are 3.2 times larger than stated, or more", 0.03 / 0.97)
#: However precise it is, a label may be of another sheet, an axis of another gimbal.
ANOTHER_THING = Hypothesis("a statement is about another thing", 1e-3)
#: Nobody measured it: lithography makes pixels square to 1e-5, so it takes another lens, or images made larger.
NOT_SQUARE = Hypothesis("an image is stretched, so that its pixels are not square", 1e-3)
#: Makers state the one, benches measure the other; neither is a fault.
OTHER_LENGTH = Hypothesis("a certificate states the focal length, but does not say so", 1.0, rows.PASSPORT)
#: Nobody measured it, and halls drift by 3 K a night.
UNSTEADY = Hypothesis("the focal length changes more than by 1 K", 0.1 / 0.9)
#: One setting scales them all.
WHOLE_GIMBAL = Hypothesis("all scales of a gimbal are wrong together, against one", 1.0)
#: Another collimator has another axis and another radius; most changes are of one part.
WHOLE_PASSPORT = Hypothesis("all of a passport has changed, against one part", 0.1)
#: 1 to 150: only strong evidence changes a model that was chosen (Kass and Raftery, 1995).
OTHER_LENS = Hypothesis("the lens is of the other family", math.exp(-5.0), rows.LENS)
#: Nobody stated how it is moved.
OTHER_WAY = Hypothesis("a hand moves the camera, and no gimbal; or the reverse", 1.0, rows.PUPILS)
#: Who states the bound has measured it, and may have taken the camera off since.
NO_BOUND = Hypothesis("a hand moves the camera, although a bound is stated", 0.02, rows.PUPILS)
#: The same statements: only the views decide.
OTHER_OPTIMUM = Hypothesis("the camera is at another optimum", 1.0, rows.AMPLITUDES)
#: They come from a tag, whose code is checked.
SHIFTED_IDS = Hypothesis("the ids of a view are shifted", 1e-4)
#: Nobody stated what program made each view.
OTHER_ORIGIN = Hypothesis("the points of a view have another origin", 1.0)
#: Once in a hundred calibrations.
FOCUS_CHANGE = Hypothesis("the focus ring was touched between two poses, or the lens has play", 1e-2)
