"""What a person did to a bench: a cause as data, and the sentence that names it, what stands beside it, and what to do.

A cause is a suspect that was weighed against all others by the same data. Something is to be changed only if nothing
stands beside it; otherwise the sentence says what would tell them apart. The module loads no array library, so that a
status of a run is shown quickly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

#: Kinds that rotations and readings show (`calib.diagnosis.suspects`).
TURNED, MOVED, HELD = (
    "camera turned in its mount",
    "collimator or target moved",
    "target turned in its holder",
)
CREEPS, SHIFTS = "camera creeps in its mount", "collimator or target creeps"
LOOSE, SCATTERED, BIASED = "camera loose at each pose", "readings scatter", "views biased"
SLIPPED, ONE_POSE, NOT_SQUARE = "axis slipped", "one pose does not fit", "axes not at right angles"
REVERSED, EXCHANGED, LATE = "sign of an axis", "axes exchanged", "readings of a neighbouring pose"
AXIS_SCALE, UNITS, SAGS = "scale of an axis", "readings in another unit", "camera sags with tilt"
NONE_FITS = "none of these fits"
#: Kinds that the views show (`calib.joint.causes`).
FOCUSED, FOCUS_CREEPS, FOCUS_PLAYS = (
    "focal length changed",
    "focal length drifts",
    "focal length of each pose",
)
UNCHANGED = "focal length that does not change"
IDS, ORIGIN = "star ids of views shifted", "views with another origin"
SCALED = "target of another scale"
#: Statements of the station (`calib.joint.knowledge`) that stand beside a target of another scale.
CERTIFICATE, PARALLAX = "certificate of the collimator", "pupil and defocus"
#: No odds are stated that are larger than these, 2 log: beyond them, no model of the errors is that good.
LARGEST_EVIDENCE: Final = 100.0
#: So many stand beside a cause at most: a longer list helps nobody.
MOST_BESIDE: Final = 2


@dataclass(frozen=True)
class Cause:
    """A cause that explains the data far better than a bench on which nobody did anything."""

    kind: str
    evidence: float  # 2 log of the odds for it
    value: float | None = None  # In ``unit``
    expanded: float | None = None  # Expanded uncertainty of the value, k = 2; None if none is known
    unit: str = ""
    stated: float | None = None  # What was stated or expected of the value
    axis: str = ""  # Name of an axis, or of the axes of which it is one; which way views are shifted
    before: str = ""  # Name of the last pose without it
    pose: str = ""  # Name of the first pose with it, or of the only ones
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


def probability(share: float) -> str:
    """Return a probability in words; nothing is certain.

    >>> probability(0.423), probability(0.9999)
    ('42 %', 'more than 99 %')
    """
    return "more than 99 %" if share > 0.99 else f"{share:.0%}".replace("%", " %")


@dataclass(frozen=True)
class Words:
    """How a kind is told, with places for what `in_words` fills in."""

    also: str = ""  # Its name beside another kind
    check: str = ""  # What would decide
    says: str = ""  # With its number, without the full stop; empty if it is only named beside others
    remedy: str = ""  # What to do if nothing stands beside it


_ALL = "record all poses again."
_SPANNED = "U spans what was seen"
_NO_SINGLE = "No single focal length holds: lock the focus ring"
_FIRST_AGAIN = "repeat the first pose at the end"
_SAME_POSE = "come to one pose several times and compare the stars"
_WORDS: Mapping[str, Words] = {
    TURNED: Words(
        "the camera turned in its mount",
        "look past the collimator at something far away: if it moved in the image, the camera turned",
        "The camera turned in its mount {between}, by {size}",
        f"Fasten the camera, and {_ALL}",
    ),
    MOVED: Words(
        "the collimator or its target moved",
        "look at the collimator's mount and at the target's holder",
        "The collimator or its target moved {between}, by {size}",
        f"Fasten the collimator and the target in it, and {_ALL}",
    ),
    HELD: Words(
        "the target turned in its holder",
        "mark the target's edge on its holder",
        "The target turned in its holder {between}, by {size}",
        f"Clamp the target, and {_ALL}",
    ),
    CREEPS: Words(
        "the camera creeps in its mount",
        "leave the stage alone for some minutes and see whether the stars move",
        "The camera creeps in its mount. It turned by {size} from the first pose to the last",
        f"Fasten the camera, let it warm up, and {_ALL}",
    ),
    SHIFTS: Words(
        "the collimator creeps",
        "leave the stage alone for some minutes and see whether the stars move",
        "The collimator, or its target, creeps. It turned by {size} from the first pose to the last",
        f"Fasten the collimator, and {_ALL}",
    ),
    LOOSE: Words(
        "the camera is loose in its mount",
        "push the camera gently and see whether the stars come back",
        "The camera, or what carries it, stands otherwise at each pose, by some {size} about each axis",
        "Look for a loose screw of camera, lens and stage, and repeat one pose several times.",
    ),
    BIASED: Words("errors of the collimator or of the lens bias the views", _SAME_POSE),
    SCATTERED: Words(
        "the readings of the axes scatter",
        _SAME_POSE,
        "The readings of the axes scatter by some {size} against the stars",
        "Come to one pose several times, from the same side, and compare the stars.",
    ),
    SLIPPED: Words(
        "an axis slipped",
        "turn the axis home and back: if it slipped, the stars of the first pose are elsewhere",
        "The {axis} axis slipped {between}: after that, the readings show {size} {less} than the axis turned",
        f"Check its clutch and its load, and {_ALL}",
    ),
    ONE_POSE: Words(
        "only one pose is wrong",
        "record that pose again",
        "The pose '{pose}' does not fit: its reading and its stars differ by {size}",
        "Leave the pose out, or record it again.",
    ),
    NOT_SQUARE: Words(
        "the axes are not at right angles",
        "repeat the poses in another order: an error of the axes stays with the angles",
        "The axes of pan and tilt are not at right angles: they differ from it by {size}",
    ),
    SAGS: Words("the camera sags as it tilts", "hold the camera's free end while it tilts"),
    REVERSED: Words(
        "the sign of an axis is wrong",
        "turn each axis alone and see which way the picture goes",
        "The sign of {axis} is wrong in the station file: with these readings, the camera would look backwards",
        "Turn each axis alone, see which way the picture goes, and correct the sign.",
    ),
    EXCHANGED: Words(
        "pan and tilt are exchanged",
        "turn pan alone and see whether the picture goes sideways",
        "Pan and tilt are exchanged: each has the readings of the other",
        "Exchange their addresses or cables, and run again.",
    ),
    LATE: Words(
        "the readings are those of a neighbouring pose",
        "compare the times of readings and recordings",
        "The reading of each pose is that of the pose {neighbour} it: with the order put right, they fit",
        f"Check when the stage is read, and {_ALL}",
    ),
    AXIS_SCALE: Words(
        "an axis turns farther than it reads, or less",
        "turn that axis by a whole turn and look at its mark",
        "The {axis} axis turns {size} times as far as its readings say",
        "Correct its steps or counts per degree in the station file, and run again.",
    ),
    UNITS: Words("all axes read in another unit, as gon", "read what unit the stage states"),
    FOCUSED: Words(
        "the focus ring was touched between two poses",
        _FIRST_AGAIN,
        "The focal length is {size} {longer} after the pose '{before}': the focus ring was probably touched there. "
        f"{_SPANNED}",
        f"{_NO_SINGLE}, and {_ALL}",
    ),
    FOCUS_CREEPS: Words(
        "the focal length drifts",
        _FIRST_AGAIN,
        f"The focal length drifts: it becomes {{size}} {{longer}} from the first to the last pose. {_SPANNED}",
        f"{_NO_SINGLE}, let the lens warm up, and {_ALL}",
    ),
    FOCUS_PLAYS: Words(
        "the lens has play",
        "repeat one pose after turning away",
        f"Each pose has its own focal length: they span {{size}}. {_SPANNED}",
        f"{_NO_SINGLE}, look for play of the lens, and {_ALL}",
    ),
    UNCHANGED: Words("nothing changed", _FIRST_AGAIN),
    SCALED: Words(
        "the target has another scale",
        "check pitch and target",
        "The radius that the stars show is {size} times the certified one, {stated:.6g} mm: the pitch of the target is "
        "probably {inverse:.5g} times the stated one, or another target is in the collimator",
        "Check pitch and target.",
    ),
    IDS: Words(
        says="The star ids are wrong: shift the ids of {axis}. Then the stars fit far better",
        remedy="Check the tag or the id file of these views.",
    ),
    ORIGIN: Words(
        says="The points of {pose} lie {size} {axis} of those of the other views: their origin seems to differ",
        remedy="Check --origin, and give all views the same.",
    ),
    CERTIFICATE: Words(
        "the certificate is that of another collimator", "compare its serial with the collimator's"
    ),
    PARALLAX: Words("the pupil is elsewhere than stated", "measure the place of the pupil"),
    NONE_FITS: Words(
        "something else happened",
        "repeat two of the poses",
        "Stars and readings of single poses differ by some {size}, and nothing that Starbench knows explains it",
        "Compare the list of readings with the poses, repeat two of them, and look at what differs.",
    ),
}


def cause_sentence(cause: Cause) -> str:
    """Return what a cause of a calibration is, with its number; and what to do, or what would tell it from others."""
    return in_words(cause, _WORDS)


def in_words(cause: Cause, table: Mapping[str, Words]) -> str:
    """Return a cause by a table of words for its kind and for those beside it."""
    words, value, up = table[cause.kind], cause.value or 0.0, (cause.value or 0.0) > 0.0
    says = words.says.format(
        **asdict(cause) | {"value": value, "stated": cause.stated or 0.0},
        size=cause.size if cause.value is not None else "",
        inverse=1.0 / (value or 1.0),
        whose=f"as in run {cause.before}" if cause.before else "as the station expects",
        between=f"between the poses '{cause.before}' and '{cause.pose}'",
        longer="longer" if up else "shorter",
        less="less" if up else "more",
        neighbour="before" if up else "after",
    )
    beside = [table[kind] for kind in cause.beside if kind in table]
    if not beside:
        return f"{says}. {words.remedy}".rstrip()
    also = ", or ".join(other.also for other in beside)
    checks = dict.fromkeys(each.check for each in (words, *beside))
    return f"{says}; or {also}: one of these. To tell them apart: {'; '.join(checks)}."
