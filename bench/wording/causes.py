"""What a person did to a bench, in one sentence: with its number, and what to do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from calib.model.cause import Cause, Words, cause_sentence, in_words

if TYPE_CHECKING:
    from bench.record.events import CauseData, VerdictData

LENS, ASLEEP = "another lens", "computer stood still"
LIGHT, CAMERA = "light set otherwise", "camera set otherwise"
#: Unit of a setting that is on, 1, or off, 0.
SWITCH = "switch"
_SWITCHED = "camera switched off", "camera switched on"
WEAK = FEWER, NOISIER, SLOWER, DIMMER, ROOM = (
    "fewer stars",
    "noisier stars",
    "later events",
    "weaker light",
    "brighter room",
)

_COMPARE = "If nobody meant to change it, compare the sequences and the settings of the light."
_COMPARE_CAMERA = "If nobody meant to change it, compare the camera's settings in both station files."
#: What moves no star is judged where the image is: these signs do not tell which of them it is.
_WEAK = "A closed aperture, dust or fog, and a dim lamp look the same. Look at the picture of a pose, and at these."
_WORDS: Mapping[str, Words] = {
    LENS: Words(
        says="The focal length is {value:.0f} px instead of {stated:.0f} px {whose}: another lens is on the camera",
        remedy="Compare the lens with the station file and with the notes of earlier runs.",
    ),
    ASLEEP: Words(
        says="This computer stood still for {value:.0f} s during the run: it slept, or the program was stopped",
        remedy="Switch its sleep mode off, and look at the recording of that time before you use the values.",
    ),
    LIGHT: Words(
        says="The light's {axis} was {value:.4g} {unit}, and {stated:.4g} {unit} in run {before}",
        remedy=_COMPARE,
    ),
    CAMERA: Words(
        says="The camera's {axis} was {value:.4g}, and {stated:.4g} in run {before}", remedy=_COMPARE_CAMERA
    ),
    _SWITCHED[0]: Words(says="The camera's {axis} was off, and on in run {before}", remedy=_COMPARE_CAMERA),
    _SWITCHED[1]: Words(says="The camera's {axis} was on, and off in run {before}", remedy=_COMPARE_CAMERA),
    FEWER: Words(
        says="Few stars are seen: {value:.0f} stars a pose instead of {stated:.0f} {whose}", remedy=_WEAK
    ),
    NOISIER: Words(
        says="The image is weak or not sharp: the stars scatter by {value:.2g} px instead of {stated:.2g} {whose}",
        remedy=_WEAK,
    ),
    SLOWER: Words(
        says="The light is weak: the first events come {value:.0f} us after it turns on, instead of {stated:.0f} "
        "{whose}",
        remedy=_WEAK,
    ),
    DIMMER: Words(
        says="The light is weak: a falling edge makes {value:.0f} events instead of {stated:.0f} {whose}",
        remedy=_WEAK,
    ),
    ROOM: Words(
        says="Light that does not flicker reaches the sensor: a falling edge makes {value:.0f} events instead of "
        "{stated:.0f} {whose}, and no event comes later",
        remedy="A bright room and a lamp that does not go dark look the same. Check them in this order.",
    ),
}


def cause_sentences(causes: Iterable[CauseData]) -> list[str]:
    """Return the causes that results or a journal hold, in words and in their order."""
    return [sentence_of(Cause.from_dict(cause)) for cause in causes]


def listed_verdict(verdict: VerdictData | None, causes: Sequence[CauseData]) -> str:
    """Return the headline of a verdict with its first reservation, for a list; empty without a verdict."""
    return " ".join([verdict["headline"], *cause_sentences(causes[:1])]) if verdict else ""


def sentence_of(cause: Cause) -> str:
    """Return a cause in words."""
    if cause.unit == SWITCH:
        cause = replace(cause, kind=_SWITCHED[bool(cause.value)])
    return in_words(cause, _WORDS) if cause.kind in _WORDS else cause_sentence(cause)
