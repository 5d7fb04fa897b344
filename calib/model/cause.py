"""What a person did to a bench: a cause as data, and the sentence that names it with its number and its remedy.

Each cause is a hypothesis that was tested against the data. The module loads no array library, so that a status of a
run is shown quickly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

#: Kinds that the views show (`calib.joint.causes`).
TURNED, FOCUSED, SCALED = "camera turned in its mount", "focal length changed", "target of another scale"
SLIPPED, ONE_POSE = "axis slipped", "one pose does not fit"
REVERSED, EXCHANGED, AXIS_SCALE = "sign of an axis", "axes exchanged", "scale of an axis"
#: What readings cannot tell from a wrong sign of one of two axes: with a camera that is mounted a quarter turn further.
AXES_EXCHANGED: Final = " Two axes whose cables or addresses are exchanged look the same."
#: The statement of the station that parallax contradicts (`calib.joint.knowledge`).
PARALLAX: Final = "pupil and defocus"
#: No odds are stated that are larger than these, 2 log: beyond them, no model of the errors is that good.
LARGEST_EVIDENCE: Final = 100.0


@dataclass(frozen=True)
class Cause:
    """A cause that explains the data far better than a bench on which nobody did anything."""

    kind: str
    evidence: float  # 2 log of the odds for it
    value: float | None = None  # In ``unit``
    expanded: float | None = None  # Expanded uncertainty of the value, k = 2; None if none is known
    unit: str = ""
    stated: float | None = None  # What was stated or expected of the value
    axis: str = ""  # Name of an axis, or of the axes of which it is one
    before: str = ""  # Name of the last pose without it
    pose: str = ""  # Name of the first pose with it, or of the only one
    beside: tuple[str, ...] = ()  # Kinds that the data cannot tell from this one
    explains: tuple[str, ...] = ()  # Statements that seem to be wrong, and are not

    def to_dict(self) -> dict[str, Any]:
        """Return the cause as JSON holds it."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Cause:
        """Read what `to_dict` wrote."""
        return cls(**{**data, **{name: tuple(data.get(name, ())) for name in ("beside", "explains")}})

    @property
    def size(self) -> str:
        """The value without its sign, with its uncertainty and its unit."""
        assert self.value is not None
        value, unit = abs(self.value), f" {self.unit}" if self.unit else ""
        if self.expanded is None:
            return f"{value:.3g}{unit}"
        text, expanded = rounded(value, self.expanded)
        return f"{text} ± {expanded}{unit} (k = 2)"


def rounded(value: float, expanded: float) -> tuple[str, str]:
    """Return a value and its uncertainty as text, with two significant digits of the latter.

    >>> rounded(0.29944, 0.0052)
    ('0.2994', '0.0052')
    >>> rounded(268.4, 12.0)
    ('268', '12')
    """
    places = max(0, 1 - int(f"{max(expanded, 1e-9):e}".split("e")[1]))
    return f"{value:.{places}f}", f"{expanded:.{places}f}"


def _between(cause: Cause) -> str:
    return f"between the poses '{cause.before}' and '{cause.pose}'"


def _turned(cause: Cause) -> str:
    also = _or(cause, {SLIPPED: "an axis slipped there", ONE_POSE: "only one pose is wrong"})
    return (
        f"The camera turned in its mount {_between(cause)}, by {cause.size}{also}. Fasten the camera, and record all "
        "poses again."
    )


def _focused(cause: Cause) -> str:
    assert cause.value is not None
    more = "longer" if cause.value > 0 else "shorter"
    return (
        f"The focal length is {cause.size} {more} after the pose '{cause.before}': the focus ring was probably touched "
        "there. Lock the ring, and record all poses again."
    )


def _scaled(cause: Cause) -> str:
    assert cause.value is not None
    assert cause.stated is not None
    also = ", and so may a pupil elsewhere than stated" if PARALLAX in cause.beside else ""
    return (
        f"The radius that the stars show is {cause.size} times the certified one, {cause.stated:.6g} mm: the pitch of "
        f"the target is probably {1.0 / cause.value:.5g} times the stated one, or another target is in the collimator. "
        f"A certificate of another collimator looks the same{also}. Check pitch and target, then the certificate."
    )


def _slipped(cause: Cause) -> str:
    assert cause.value is not None
    more = "more" if cause.value < 0 else "less"
    also = _or(cause, {TURNED: "the camera turned in its mount there", ONE_POSE: "only one pose is wrong"})
    return (
        f"The {cause.axis} axis slipped {_between(cause)}: after that, the readings show {cause.size} {more} than the "
        f"axis turned{also}. Check its clutch and its load, and record all poses again."
    )


def _one_pose(cause: Cause) -> str:
    also = _or(
        cause, {SLIPPED: "an axis slipped beside it", TURNED: "the camera turned in its mount beside it"}
    )
    return (
        f"The pose '{cause.pose}' does not fit: its reading and its stars differ by {cause.size}{also}. Leave the pose "
        "out, or record it again."
    )


def one_of(axes: Sequence[str]) -> str:
    """Return names of axes after "the sign of"."""
    return " or of ".join(axes)


def _reversed(cause: Cause) -> str:
    return (
        f"The sign of {cause.axis} is wrong in the station file: with these readings, the camera would look backwards. "
        f"Correct the sign, and run again.{AXES_EXCHANGED if EXCHANGED in cause.beside else ''}"
    )


def _axis_scale(cause: Cause) -> str:
    return (
        f"The {cause.axis} axis turns {cause.size} times as far as its readings say. Correct its steps or counts per "
        "degree in the station file, and run again."
    )


def _or(cause: Cause, words: Mapping[str, str]) -> str:
    """Return what the data cannot tell from a cause, as the end of a clause; empty if there is nothing."""
    return "".join(f"; or {words[kind]}, which looks the same" for kind in cause.beside if kind in words)


_SENTENCES = {
    TURNED: _turned,
    FOCUSED: _focused,
    SCALED: _scaled,
    SLIPPED: _slipped,
    ONE_POSE: _one_pose,
    REVERSED: _reversed,
    AXIS_SCALE: _axis_scale,
}


def cause_sentence(cause: Cause) -> str:
    """Return what a cause of a calibration is, with its number, and what to do."""
    return _SENTENCES[cause.kind](cause)
