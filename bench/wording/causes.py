"""What a person did to a bench, in one sentence: with its number, and what to do."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from calib.model.cause import Cause, cause_sentence

if TYPE_CHECKING:
    from bench.record.events import CauseData

LENS, ASLEEP = "another lens", "computer stood still"
LIGHT, CAMERA = "light set otherwise", "camera set otherwise"
#: Unit of a setting that is on, 1, or off, 0.
SWITCH = "switch"
WEAK = FEWER, NOISIER, SLOWER, DIMMER, ROOM = (
    "fewer stars",
    "noisier stars",
    "later events",
    "weaker light",
    "brighter room",
)

_WEAK = (
    "A closed aperture, dust on lens or target, a dim lamp, a bright room and a lens out of focus look the same. Check "
    "them in this order."
)


def cause_sentences(causes: Iterable[CauseData]) -> list[str]:
    """Return the causes that results or a journal hold, in words and in their order."""
    return [sentence_of(Cause.from_dict(cause)) for cause in causes]


def sentence_of(cause: Cause) -> str:
    """Return a cause in words."""
    own = _SENTENCES.get(cause.kind)
    return own(cause) if own else cause_sentence(cause)


def _lens(cause: Cause) -> str:
    if cause.before:
        return (
            f"The focal length is {cause.value:.0f} px, and was {cause.stated:.0f} px in run {cause.before}: another "
            "lens is on the camera. If nobody meant to change it, compare the lens with the notes of that run."
        )
    return (
        f"The focal length is {cause.value:.0f} px, and the station expects {cause.stated:.0f} px: another lens is on "
        "the camera, or expected.focal_px is wrong. Compare the lens with the station file, and correct the file."
    )


def _asleep(cause: Cause) -> str:
    return (
        f"This computer stood still for {cause.value:.0f} s during the run: it slept, or the program was stopped. "
        "Switch its sleep mode off, and look at the recording of that time before you use the values."
    )


def _light(cause: Cause) -> str:
    return (
        f"The light's {cause.axis} was {cause.value:.4g} {cause.unit}, and {cause.stated:.4g} {cause.unit} in run "
        f"{cause.before}. If nobody meant to change it, compare the sequences and the settings of the light."
    )


def _camera(cause: Cause) -> str:
    own, other = (
        ("on" if v else "off") if cause.unit == SWITCH else f"{v:.4g}" for v in (cause.value, cause.stated)
    )
    return (
        f"The camera's {cause.axis} was {own}, and {other} in run {cause.before}. If nobody meant to change it, "
        "compare the camera's settings in both station files."
    )


def _fewer(cause: Cause) -> str:
    return f"The image is weak: {cause.value:.0f} stars a pose {_instead(cause, '.0f')}. {_WEAK}"


def _noisier(cause: Cause) -> str:
    return f"The image is weak: the stars scatter by {cause.value:.2g} px {_instead(cause, '.2g')}. {_WEAK}"


def _slower(cause: Cause) -> str:
    return (
        f"The light is weak: the first events come {cause.value:.0f} us after it turns on, {_instead(cause, '.0f')}. "
        "The level of the lamp, the aperture and dust look the same. Check them in this order."
    )


def _dimmer(cause: Cause) -> str:
    return (
        f"The light is weak: a falling edge makes {cause.value:.0f} events {_instead(cause, '.0f')}. The level of the "
        "lamp, the aperture, dust and a bright room look the same. Check them in this order."
    )


def _room(cause: Cause) -> str:
    return (
        f"Light that does not flicker reaches the sensor: a falling edge makes {cause.value:.0f} events "
        f"{_instead(cause, '.0f')}, and no event comes later. A bright room and a lamp that does not go dark look the "
        "same. Check them in this order."
    )


def _instead(cause: Cause, form: str) -> str:
    """Return the number that was there before, or that the station expects."""
    whose = f"as in run {cause.before}" if cause.before else "as the station expects"
    return f"instead of {cause.stated:{form}} {whose}"


_SENTENCES = {
    LENS: _lens,
    ASLEEP: _asleep,
    LIGHT: _light,
    CAMERA: _camera,
    FEWER: _fewer,
    NOISIER: _noisier,
    SLOWER: _slower,
    DIMMER: _dimmer,
    ROOM: _room,
}
