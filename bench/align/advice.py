"""What the operator should do next, from what a live picture shows: plain sentences, the most important first.

Nothing is said that the figures do not show; the limits are those by which a run judges its recordings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from bench.align.focus import FocusFigures
from bench.align.live_image import LiveImage, LiveSetting, SignalFigures
from bench.align.where_to_turn import TurnFigures
from bench.measure.gates import FILTERS_TO_DISABLE, FREQUENCY_TOLERANCE
from bench.measure.measure import MOST_SATURATED
from calib.stars.beam import Beam
from calib.stars.quick import QuickStars
from drivers.camera import RecordingFacts
from drivers.camera.frames import FrameFacts


@dataclass(frozen=True)
class Seen:
    """Everything that the advice is made from."""

    image: LiveImage
    facts: RecordingFacts | FrameFacts | None  # What the driver states about it; None if unknown
    beam: Beam  # The beam's disc
    stars: QuickStars | None  # Tag and stars; None if they were not searched
    other_tag: str  # What is wrong with the tags seen; empty if nothing is
    focus: FocusFigures  # With those of the course
    contrast: float | None  # Contrast inside the beam; None without light
    turn: TurnFigures  # Where to turn

    @property
    def count(self) -> int:
        """Number of stars."""
        return 0 if self.stars is None else len(self.stars.points_px)

    @property
    def tag_seen(self) -> bool:
        """Whether the tag, or enough of it to identify the stars, is in view."""
        return self.stars is not None and (self.stars.tag is not None or bool(self.stars.named_by))


SHARP_PX: Final = 1.0
"""Edge width below which the lens counts as focused; up to 1.3 px every star is found."""
BRIGHT_PERCENT: Final = 50.0
"""Level of the light from which the coarse detail has a slope while the lens is far out of focus."""
_FAR_PX: Final = 3.5
"""Edge width from which it is only a rough one, and the coarse detail shows the way, px."""
_WORSE: Final = 1.2
_FLAT_CONTRAST, _FLAT_DETAIL = 0.3, 0.22
_LOADED_LINK: Final = 0.9
_ON_SHARES: Final = (0.25, 0.75)
_MANY_HOT: Final = 2000
_LITTLE_LIGHT: Final = 0.6
_BLINDED: Final = 0.6
_FREQUENCY_SLACK: Final = 0.03
_ASIDE: Final = 0.04


def advice_for(seen: Seen, setting: LiveSetting) -> list[str]:
    """Return what to do next: sentences, the most important first; empty if nothing is to be improved."""
    advice = [*_camera(seen.facts)]
    dark = list(_light(seen, setting))
    if dark:
        return advice + dark
    advice += _signal(seen, setting)
    if seen.other_tag:
        return [*advice, seen.other_tag]
    if seen.image.signal is None and (seen.image.saturation or 0.0) > _BLINDED:
        return advice
    flat = _flat(seen, setting)
    if flat:
        return [*advice, flat, *_aim(seen, setting, square_told=True)]
    focus, aim = list(_focus(seen, setting)), list(_aim(seen, setting))
    # A picture far out of focus shows no tag, and a tag out of view shows no blur: what is seen decides what is first.
    aim_first = not seen.tag_seen and (bool(seen.count) or seen.beam.share < _LITTLE_LIGHT)
    advice += aim + focus if aim_first else focus + aim
    return [*advice, *_pattern(seen, setting)]


def dropped_share(facts: RecordingFacts | FrameFacts | None) -> float | None:
    """Return the share, 0 to 1, of events that the rate controller dropped; None if the camera does not count."""
    if (
        not isinstance(facts, RecordingFacts)
        or not facts.rate_controller_in
        or facts.rate_controller_out is None
    ):
        return None
    return max(0.0, 1.0 - facts.rate_controller_out / facts.rate_controller_in)


def _camera(facts: RecordingFacts | FrameFacts | None) -> Iterator[str]:
    """Yield what the driver reports against a recording."""
    if facts is None:
        return
    if not facts.complete:
        yield "The recording ended too early: check the camera's cable and its power."
    if isinstance(facts, RecordingFacts):
        if facts.gaps:
            yield f"Data was lost ({facts.gaps[0]}): close other programs, and use a faster USB port."
        active = [name.upper() for name in FILTERS_TO_DISABLE if facts.filters.get(name)]
        if active:
            yield f"The camera's filter {', '.join(active)} is on and removes events: switch it off."


def _light(seen: Seen, setting: LiveSetting) -> Iterator[str]:
    """Yield why no light is seen; nothing if there is light that flickers as it should."""
    signal = seen.image.signal
    if seen.beam.share > 0.0 and (signal is None or signal.flicker is not None):
        return
    if setting.light_on is False:
        yield "The light is off: switch it on."
    elif signal is None:
        yield (
            "The picture is dark: open the aperture, remove the lens cap, raise the light's level, and check that the "
            "camera points at the collimator."
        )
    elif signal.trigger_hz or signal.event_hz:
        source = "The sync signal comes" if signal.trigger_hz else "Some events flicker"
        yield (
            f"{source}, but the picture shows no lit area: remove the lens cap, open the "
            "aperture, turn the camera towards the collimator, or raise the light's level."
        )
    elif setting.light_on:
        yield (
            "No flicker is seen, although the light is on: remove the lens cap, open the aperture, turn the camera "
            "towards the collimator, or raise the light's level."
        )
    elif signal.events and seen.beam.share > 0.0:
        yield "Events come, but without a flicker: keep the camera still, and switch the light on."
    else:
        yield "No flicker: switch the light on."


def _signal(seen: Seen, setting: LiveSetting) -> Iterator[str]:
    """Yield what is wrong with frequency, sync edges, rates and pixels."""
    signal, image = seen.image.signal, seen.image
    if signal is None:
        if image.saturation is not None and image.saturation > MOST_SATURATED:
            yield (
                f"{100 * image.saturation:.1f} % of the pixels are saturated: lower the light's level or the exposure."
            )
        return
    yield from _sync(signal, setting)
    limit = setting.gates.max_event_rate_mev_s
    rate = (signal.events_per_s or 0.0) / 1e6
    if rate > limit:
        yield (
            f"The event rate is {rate:.0f} Mev/s, and a run accepts at most {limit:g}: lower the light's frequency or "
            "level, or raise bias_diff_on and bias_diff_off."
        )
    dropped, share = dropped_share(seen.facts), signal.link_share or 0.0
    if dropped is not None and 100 * dropped > setting.gates.limits.get(
        "max_rate_controller_loss_percent", 100
    ):
        yield (
            f"The camera has dropped {100 * dropped:.0f} % of the events: use a square flicker, or lower the light's "
            "frequency or level."
        )
    elif share > _LOADED_LINK:
        yield (
            f"The data fills {100 * share:.0f} % of the camera's link, so events come late or are lost: use a square "
            "flicker, or lower the light's frequency or level."
        )
    if signal.on_share is not None and not _ON_SHARES[0] <= signal.on_share <= _ON_SHARES[1]:
        few, bias = ("OFF", "bias_diff_off") if signal.on_share > 0.5 else ("ON", "bias_diff_on")
        yield f"Only few events are {few} events (ON share {100 * signal.on_share:.0f} %): lower {bias}."
    if image.hot_pixels is not None and image.hot_pixels > _MANY_HOT:
        yield (
            f"{image.hot_pixels} pixels fire far more often than their surroundings: let the camera cool, shield it "
            "from other light, or raise bias_diff_on and bias_diff_off."
        )


def _sync(signal: SignalFigures, setting: LiveSetting) -> Iterator[str]:
    """Yield what is wrong with the sync edges and the frequency."""
    if signal.sync_fault:
        yield f"{signal.sync_fault} Check the sync cable and the light's settings."
    elif not signal.sync_edges and setting.gates.require_triggers:
        yield "No sync triggers come: check the cable from the light's sync output to the camera's trigger input."
    elif signal.triggers_expected - signal.triggers > setting.gates.limits.get("max_triggers_missed", 1):
        yield (
            f"{signal.triggers} of {signal.triggers_expected} sync edges came: check the sync cable, its level, and "
            "the frequency of the light."
        )
    elif signal.jitter_us is not None and signal.jitter_us > setting.gates.limits.get(
        "max_trigger_jitter_us", float("inf")
    ):
        yield f"The sync edges jitter by {signal.jitter_us:.0f} us: check the sync cable and its level."
    wanted, source = setting.frequency_hz, "triggers" if signal.trigger_hz else "events"
    found = signal.trigger_hz or signal.event_hz
    # A live slice is too short for the tolerance of a run if only events give the frequency.
    digits = 2 if source == "triggers" else 1
    tolerance = FREQUENCY_TOLERANCE["triggers"] if source == "triggers" else _FREQUENCY_SLACK
    if wanted and found and not signal.sync_fault and abs(found / wanted - 1.0) > tolerance:
        yield (
            f"The flicker is {found:.{digits}f} Hz, but the light is set to {wanted:.2f} Hz: check that no other lamp "
            "lights the pattern, and that the light follows its settings."
        )


def _flat(seen: Seen, setting: LiveSetting) -> str:
    """Return what to do if bright light hides the pattern of a lens far out of focus; else an empty text."""
    if seen.count or seen.tag_seen or seen.contrast is None:
        return ""
    if seen.contrast > _FLAT_CONTRAST or (seen.focus.sharpness or 0.0) > _FLAT_DETAIL:
        return ""
    what = (
        f"{_square_text(seen)}, but no stars were found: the lens is probably out of focus."
        if seen.turn.square_borders is not None
        else "No stars were found, and almost no details. Either the lens is far out of focus, or the camera looks "
        "beside the target."
    )
    return f"{what} {_turn_on(seen, setting)}"


def _turn_on(seen: Seen, setting: LiveSetting) -> str:
    """Return what to do with lens and light far out of focus, a sentence."""
    if _is_dim(seen, setting):
        return (
            "Set the light's level to 100 %: far out of focus, a bright light shows best which way to turn the focus "
            "ring."
        )
    return f"Turn the focus ring{_sharpness_text(seen)}.{_way(seen)}"


def _way(seen: Seen) -> str:
    """Return whether the last turn of the ring went the right way, and how far to turn next; empty before the first."""
    if not seen.focus.trend or seen.focus.turn_on is None:
        return ""
    by = f"by about {abs(seen.focus.turn_on):.1f} times the last turn"
    if seen.focus.turn_on > 0.0:
        return f" This is the right way: turn on {by}."
    if seen.focus.trend == "better" or seen.focus.turn_on > -1.0:
        return f" You have passed the best place: turn back {by}."
    return f" This is the wrong way: turn back {by}."


def _is_dim(seen: Seen, setting: LiveSetting) -> bool:
    """Return whether more light would show the way out of focus; the exposure of a frame camera is its own matter."""
    level = setting.level_percent
    return seen.image.signal is not None and level is not None and level < BRIGHT_PERCENT


def _square_text(seen: Seen) -> str:
    """Return where a dark square is seen, without a full stop."""
    borders = seen.turn.square_borders
    where = f" at the {' and '.join(borders)} border" if borders else ""
    return f"A dark square that looks like the tag is in view{where}"


def _focus(seen: Seen, setting: LiveSetting) -> Iterator[str]:
    """Yield what to do with the focus ring."""
    width, best = seen.focus.edge_width_px, seen.focus.best_edge_width_px
    if width is None:
        if not seen.count:
            yield f"No stars can be recognised. {_turn_on(seen, setting)}"
        return
    if width > _FAR_PX and _is_dim(seen, setting):
        yield f"Edges are about {width:.0f} px wide. {_turn_on(seen, setting)}"
        return
    limit = min(setting.gates.limits.get("max_edge_width_px", SHARP_PX), SHARP_PX)
    if width <= limit:
        if seen.focus.better_before_px is not None and (seen.focus.turn_on or 0.0) < 0.0:
            yield (
                f"Turn the focus ring back to the best: edges are {width:.2f} px wide, and they were "
                f"{seen.focus.better_before_px:.2f} px wide before. A run accepts {limit:g} px.{_way(seen)}"
            )
        return
    known = f", the best seen is {best:.1f} px" if best is not None and width > _WORSE * best else ""
    goal = "" if known and best is not None and best <= limit else f"; {limit:g} px or less is needed"
    yield f"Turn the focus ring: edges are {width:.1f} px wide{known}{goal}.{_way(seen)}"


def _sharpness_text(seen: Seen) -> str:
    """Return which figure must grow while nothing can be recognised: the coarse detail has a slope farthest out."""
    now, best = seen.focus.coarse_detail, seen.focus.best_coarse_detail
    if now is None:
        return ""
    better = f" (the best seen is {best:.3f})" if best is not None and best > 1.05 * now else ""
    return f": the coarse detail, now {now:.3f}{better}, must grow"


def _aim(seen: Seen, setting: LiveSetting, *, square_told: bool = False) -> Iterator[str]:
    """Yield where to turn; a square that was told before is not told again."""
    turn = seen.turn
    if not seen.tag_seen:
        if seen.count:
            where = _turn_text(turn, setting) if turn.of and not turn.centred else ""
            yield (
                f"No whole tag was recognised, so nothing identifies the {seen.count} stars. "
                + (
                    f"{where} This brings the {turn.of} to the middle."
                    if where
                    else "Turn pan and tilt in steps of 2 degrees until the tag appears."
                )
            )
        elif turn.of and not turn.centred:
            what = f"{_square_text(seen)}. " if turn.of == "square" else "No whole tag was recognised. "
            what = "" if square_told and turn.of == "square" else what
            yield f"{what}{_turn_text(turn, setting)} This brings the {turn.of} to the middle."
        elif not turn.of and (side := _lit_side(seen.beam)):
            yield (
                f"No whole tag was recognised. The light is on the {side} of the picture: turn pan and tilt in steps "
                "of 2 degrees until it fills the picture."
            )
        return
    if not turn.centred:
        yield f"{_turn_text(turn, setting)} This brings the {turn.of} to the middle."
    elif seen.beam.share < _LITTLE_LIGHT and turn.beam_off is not None:
        yield (
            f"The beam covers {100 * seen.beam.share:.0f} % of the frame, although the tag is in the middle: shift the "
            "camera sideways until the beam fills the frame."
        )


def _lit_side(beam: Beam) -> str:
    """Return on which side the light is, if its rim is in view; else an empty text."""
    if not beam.rim_in_view:
        return ""
    height, width = beam.lit.shape
    rows, columns = beam.lit.nonzero()
    across, down = float(columns.mean()) / width - 0.5, float(rows.mean()) / height - 0.5
    words = [
        low if by < 0 else high
        for by, low, high in ((down, "upper", "lower"), (across, "left", "right"))
        if abs(by) >= _ASIDE
    ]
    return f"{' '.join(words)} side" if words else ""


def _turn_text(turn: TurnFigures, setting: LiveSetting) -> str:
    """Return the turns of pan and tilt as a sentence."""
    if turn.pan is None or turn.tilt is None:
        return ""
    about, digits = ("about ", 0) if turn.of == "beam" else ("", 1)
    if turn.unit != "°":
        sides = [
            f"{abs(by):.0f} px {side[by < 0]}"
            for by, side in ((turn.pan, ("right", "left")), (turn.tilt, ("up", "down")))
            if abs(by) >= 1.0
        ]
        return f"Turn the camera until the {turn.of} has moved {about}{' and '.join(sides)}."
    steps = [(axis, by) for axis, by in (("pan", turn.pan), ("tilt", turn.tilt)) if abs(by) >= 0.05]
    missing = [axis for axis, _ in steps if setting.limits_deg and axis not in setting.limits_deg]
    text = " and ".join(f"{axis} by {about}{by:+.{digits}f} degrees" for axis, by in steps)
    by_hand = (
        f" The stage has no {' and no '.join(missing)} axis: turn the camera in its mount." if missing else ""
    )
    beyond = "".join(
        f" {axis.capitalize()} would be at {about}{there:.{digits}f} degrees, beyond its limit: turn the camera in its "
        "mount."
        for axis, there in turn.beyond.items()
    )
    return f"Turn {text}.{by_hand}{beyond}"


def _pattern(seen: Seen, setting: LiveSetting) -> Iterator[str]:
    """Yield what remains: roll, number of stars, tilt of the focus."""
    turn = seen.turn
    if turn.roll_by_deg and turn.roll_deg is not None:
        by = turn.roll_by_deg
        if "roll" in setting.limits_deg:
            what = f"Turn roll by {by:+.0f} degrees"
        elif abs(turn.roll_deg) < 2.0:
            what = "Roll the camera in its mount by about 10 degrees, in either direction"
        else:
            way = "clockwise" if by > 0 else "counter-clockwise"
            what = (
                f"Roll the camera in its mount until the pattern in the picture has turned {way} "
                f"by {abs(by):.0f} degrees"
            )
        yield (
            f"{what}. The edges of the stars are only {abs(turn.roll_deg):.1f} degrees from the rows or diagonals "
            "of the pixels. At 10 degrees, stars are located 1.5 times more accurately."
        )
    if (
        seen.tag_seen
        and seen.count < setting.gates.min_stars
        and (seen.focus.edge_width_px or 99.0) <= SHARP_PX
    ):
        yield (
            f"{seen.count} stars are found, and a run needs {setting.gates.min_stars}: bring more of the pattern into "
            "the frame, and check the light's level."
        )
    width = seen.focus.edge_width_px
    if seen.focus.tilt and width is not None and width <= 1.5 * SHARP_PX:
        yield f"{seen.focus.tilt} Check that the lens is mounted straight."
