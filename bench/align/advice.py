"""What the operator should do next, from what a live picture shows: plain sentences, the most important first.

Nothing is said that the figures do not show; the limits are those by which a run judges its recordings.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

from bench.align.focus_advice import RingTurn, flat_advice, focus_advice
from bench.align.live_image import LiveSetting, SignalFigures
from bench.align.seen import SHARP_PX, Seen
from bench.align.where_to_turn import TurnFigures
from bench.measure.gates import FILTERS_TO_DISABLE, FREQUENCY_TOLERANCE
from bench.measure.measure_frames import MOST_SATURATED
from calib.stars.beam import Beam
from drivers.camera import RecordingFacts
from drivers.camera.frames import FrameFacts

HOME: Final = (
    "Press Home: the stage is not homed, so its angles are not known. Each axis then turns a long way."
)
"""The first advice on a bench that is not homed."""
_LOADED_LINK: Final = 0.9  # Share of the link's rate; above it a small rise already loses events
# A flickering pattern gives as many ON as OFF events; outside, one bias is far off.
_ON_SHARES: Final = (0.25, 0.75)
_MANY_HOT: Final = 2000  # Two in a thousand of an IMX636's pixels
_LITTLE_LIGHT: Final = 0.6  # Share of the image in the beam, below which aiming comes before focus
_BLINDED: Final = 0.6  # Share of saturated pixels from which nothing else can be read off a picture
_FREQUENCY_SLACK: Final = 0.03  # Relative; a live slice is too short for the tolerance of a run
_ASIDE: Final = 0.04  # Share of the image; less is not seen by eye


class Advice(NamedTuple):
    """What the operator should do next."""

    sentences: tuple[str, ...] = ()  # The most important first; empty if nothing is to be improved
    ring: RingTurn | None = None  # The turn of the focus ring among them; None if there is none
    of_flicker: tuple[str, ...] = ()  # Those that only a slice of several flicker periods can give


def advice_for(seen: Seen, setting: LiveSetting) -> Advice:
    """Return what to do next, on a bench whose stage stands."""
    advice = [*first_advice(setting), *_camera(seen.facts)]
    dark = list(_light(seen, setting))
    if dark:
        return Advice((*advice, *dark))
    of_flicker = tuple(_sync(seen.image.signal, setting))
    advice += [*of_flicker, *_signal(seen, setting)]
    if seen.other_tag:
        return Advice((*advice, seen.other_tag), None, of_flicker)
    if seen.image.signal is None and (seen.image.saturation or 0.0) > _BLINDED:
        return Advice(tuple(advice), None, of_flicker)
    focus = flat_advice(seen, setting)
    is_flat = focus is not None
    focus = focus or focus_advice(seen, setting)
    sharpen = [focus.text] if focus else []
    aim = [] if setting.homed is False else list(_aim(seen, setting, square_told=is_flat))
    # A picture far out of focus shows no tag, and a tag out of view shows no blur: what is seen decides what is first.
    aim_first = not is_flat and not seen.tag_seen and (bool(seen.count) or seen.beam.share < _LITTLE_LIGHT)
    advice += aim + sharpen if aim_first else sharpen + aim
    rest = [] if is_flat else _pattern(seen, setting)
    return Advice((*advice, *rest), focus.ring if focus else None, of_flicker)


def first_advice(setting: LiveSetting) -> list[str]:
    """Return what comes before anything that a picture shows."""
    return [HOME] if setting.homed is False else []


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
    """Yield what is wrong with rates and pixels."""
    signal, image = seen.image.signal, seen.image
    if signal is None:
        if image.saturation is not None and image.saturation > MOST_SATURATED:
            yield (
                f"{100 * image.saturation:.1f} % of the pixels are saturated: lower the light's level or the exposure."
            )
        return
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


def _sync(signal: SignalFigures | None, setting: LiveSetting) -> Iterator[str]:
    """Yield what is wrong with the sync edges and the frequency; nothing for a frame camera."""
    if signal is None:
        return
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
    measured_hz = signal.trigger_hz or signal.event_hz
    # A live slice is too short for the tolerance of a run if only events give the frequency.
    digits = 2 if source == "triggers" else 1
    tolerance = FREQUENCY_TOLERANCE["triggers"] if source == "triggers" else _FREQUENCY_SLACK
    if wanted and measured_hz and not signal.sync_fault and abs(measured_hz / wanted - 1.0) > tolerance:
        yield (
            f"The flicker is {measured_hz:.{digits}f} Hz, but the light is set to {wanted:.2f} Hz: check that no other "
            "lamp lights the pattern, and that the light follows its settings."
        )


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
            what = f"{seen.square_text}. " if turn.of == "square" else "No whole tag was recognised. "
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
