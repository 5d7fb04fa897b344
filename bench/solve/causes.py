"""What a person did to the bench, as far as a run shows it: causes of the engine, and those that expectations show.

An expectation is what the station expects, and what the last run of this sequence with this camera on this bench had.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

from bench.measure.expected_grid import engine_angles_deg
from bench.plan.job import Job
from bench.record.events import LightSettingsData, RecordedData, StateEntered
from bench.record.history import History
from bench.record.measured_facts import ImageFacts
from bench.record.results import CameraConditions, Results
from bench.solve.forecasts import forecast_bench
from bench.wording import causes as kinds
from calib.calibration import Calibration
from calib.errors import CalibrationError
from calib.model.cause import LARGEST_EVIDENCE, Cause
from calib.model.likelihood_ratio import DECISIVE
from calib.studies.predicted_views import predicted_view

#: A lens has the focal length that its station expects to this share (1 sigma): makers state it to 5 %, and a station
#: may round it.
_FOCAL_SHARE = 0.05
#: From run to run of one bench, the number of stars and the residuals vary by these shares (1 sigma), and the events of
#: a falling edge by the third. Pixels are slow in weak light, so that such an edge ends before they have sent all: in
#: simulations, half the light leaves 0.9 of the events, a quarter 0.69, a tenth 0.35; mountings change them by 3 %.
#: The fourth is that of the delay of the first ON events: half the light makes it 1.5 times as long, a quarter 2.5
#: times. It is stated in whole us, and is about 10 us.
_STARS_SHARE, _RESIDUAL_SHARE, _EVENTS_SHARE, _DELAY_SHARE = 0.05, 0.15, 0.1, 0.1
#: What a station expects is known less well than what a run had: the share of stars, and of their noise (1 sigma).
_EXPECTED_STARS, _EXPECTED_NOISE = 0.12, 0.4
#: Settings of a light are others if they differ by more than this share; a duty is measured to parts in a thousand.
_SAME_SETTING = 0.02
#: A computer that is this late at once, s, has slept or was stopped: load alone makes a tenth of it. A clock that is
#: set by a time server moves by less than a second.
_STOOD_STILL_S = 10.0


@dataclass(frozen=True)
class _Seen:
    """What the accepted recordings of a run showed, by name of the pose."""

    stars: Mapping[str, int]  # None where silent lines cost stars: a note of the run tells these
    off_events: Mapping[str, float]  # Of a falling edge of the light, by the pixels that follow it
    on_delay_us: Mapping[str, float]  # Of the first ON events after a square light rises
    duty: Mapping[str, float]  # By the edges of the sync signal, as a share of the period
    rms_px: float
    light: LightSettingsData
    camera: Mapping[str, int | bool]  # Biases and filters, as read back

    def of_poses(self, number: Mapping[str, float], other: Mapping[str, float]) -> tuple[float, float] | None:
        """Return the medians of a number and of another one over the poses that both have; None without any."""
        same = [name for name in number if name in other and other[name] > 0]
        if not same:
            return None
        return tuple(statistics.median(course[name] for name in same) for course in (number, other))  # type: ignore[return-value]


def causes_of_run(job: Job, history: History, calibration: Calibration) -> list[Cause]:
    """Return what a run and its station show that a person did, the most probable first."""
    causes = [*calibration.causes, *_other_lens(job, calibration, None), *_stood_still(history)]
    return _ranked([*causes, *_against_station(job, calibration, _seen_in(history, calibration))])


def beside_last_run(job: Job, history: History, calibration: Calibration, last: Results) -> list[Cause]:
    """Return these causes, and those that only the last run shows: their ``before`` names it, and results omit them."""
    alone = causes_of_run(job, history, calibration)
    more = [*_other_lens(job, calibration, last), *_against_last(_seen_in(history, calibration), last)]
    known = {cause.kind for cause in alone}
    if known & {kinds.LENS, *kinds.WEAK}:
        known |= {*kinds.WEAK}
    return _ranked([*alone, *(cause for cause in more if cause.kind not in known)])


def _ranked(causes: list[Cause]) -> list[Cause]:
    """Return causes, the most probable first, without signs of a weak image that others of the same origin explain.

    Another lens shows another number of stars; other light or other biases make an image weaker or stronger.
    """
    whole = {cause.before for cause in causes if cause.kind in {kinds.LENS, kinds.LIGHT, kinds.CAMERA}}
    kept = [cause for cause in causes if not (cause.before in whole and cause.kind in kinds.WEAK)]
    return sorted(kept, key=lambda cause: -cause.evidence)


def _seen_in(history: History, calibration: Calibration) -> _Seen:
    accepted = history.accepted().values()
    stored = next((attempt.stored for attempt in reversed(list(accepted))), None)
    images = {attempt.pose_name: attempt.measured.get("image") for attempt in accepted}
    return _Seen(
        {}
        if any(map(_has_silent_lines, images.values()))
        else {view.name: view.n for view in calibration.views},
        _off_events(images),
        _on_delays_us(images),
        _known({attempt.pose_name: attempt.measured.get("flicker_duty") for attempt in accepted}),
        calibration.rms_px,
        stored["light"] if stored else LightSettingsData(),
        _read_back(stored["facts"]) if stored else {},
    )


def _seen_before(results: Results) -> _Seen:
    poses = [pose for pose in results.get("poses", ()) if pose["stars"]]
    conditions = results.get("conditions")
    images = {pose["name"]: pose["image"] for pose in poses}
    return _Seen(
        {pose["name"]: pose["stars"] for pose in poses},
        _off_events(images),
        _on_delays_us(images),
        _known({pose["name"]: pose.get("flicker_duty") for pose in poses}),
        float(results["calibration"]["rms_px"]),
        conditions["light"] if conditions else LightSettingsData(),
        _read_back(conditions["camera"]) if conditions else {},
    )


def _has_silent_lines(image: ImageFacts | None) -> bool:
    return bool(image and (image.get("silent_rows") or image.get("silent_columns")))


def _off_events(images: Mapping[str, ImageFacts | None]) -> dict[str, float]:
    """Return how many events a falling edge makes by pose, as far as they were counted."""
    return _known(
        {
            name: image.get("lit_pixels", 0) * (image.get("events_per_edge_off") or 0.0) if image else None
            for name, image in images.items()
        }
    )


def _on_delays_us(images: Mapping[str, ImageFacts | None]) -> dict[str, float]:
    """Return the delay of the first ON events by pose, us, as far as it was measured."""
    return _known({name: image.get("first_on_delay_us") if image else None for name, image in images.items()})


def _read_back(facts: RecordedData | CameraConditions) -> dict[str, int | bool]:
    return {**(facts.get("biases") or {}), **(facts.get("filters") or {})}


def _known(numbers: Mapping[str, float | None]) -> dict[str, float]:
    return {name: float(number) for name, number in numbers.items() if number}


def _evidence(ratio: float, share: float) -> float:
    """Return 2 log of the likelihood ratio of a changed number against one that varies by a share (1 sigma)."""
    return min((math.log(max(ratio, 1e-6)) / share) ** 2, LARGEST_EVIDENCE)


def _other_lens(job: Job, calibration: Calibration, last: Results | None) -> Iterator[Cause]:
    """Yield that the focal length is not the expected one; a station that expects none has that of the last run."""
    expected, run = job.station.expected, ""
    if expected is not None:
        focal_px = expected.focal_px
    elif last is not None:
        camera, run = last["calibration"]["camera"], str(last["run"]["id"])
        focal_px = math.sqrt(camera["fx"] * camera["fy"])
    else:
        return
    focal_now_px = math.sqrt(calibration.camera.fx * calibration.camera.fy)
    evidence = _evidence(focal_now_px / focal_px, _FOCAL_SHARE)
    if evidence > DECISIVE:
        u = max(calibration.U.get("fx", 0.0), calibration.U.get("fy", 0.0))
        yield Cause(kinds.LENS, evidence, focal_now_px, u, "px", focal_px, before=run)


def _stood_still(history: History) -> Iterator[Cause]:
    """Yield that the computer stood still: it was late, or its time of day went on without its clock."""
    longest_s = max(history.lateness.get("longest_s", 0.0), *map(_slept_s, pairwise(history.states)), 0.0)
    if longest_s >= _STOOD_STILL_S:
        yield Cause(kinds.ASLEEP, LARGEST_EVIDENCE, longest_s, unit="s")


def _slept_s(states: tuple[StateEntered, StateEntered]) -> float:
    """Return how much longer the time between two states was by the time of day than by the clock, s.

    The clock of a computer that sleeps stands still. A resumed run has another clock.
    """
    before, after = states
    passed_s = after["mono_s"] - before["mono_s"]
    if after["state"] == "recovering" or passed_s < 0.0:
        return 0.0
    begun, ended = (datetime.fromisoformat(state["utc"]) for state in states)
    return (ended - begun).total_seconds() - passed_s


def _against_last(seen: _Seen, results: Results) -> Iterator[Cause]:
    """Yield what differs from the last run: settings, and the sign of a weak image that is known best."""
    last, run = _seen_before(results), str(results["run"]["id"])
    yield from _other_setting(kinds.LIGHT, _light_settings(seen, last), _SAME_SETTING, run)
    yield from _other_setting(kinds.CAMERA, _camera_settings(seen, last), 0.0, run)
    weak = [
        *_weak_light(seen, last, run),
        *_weak(kinds.FEWER, seen.of_poses(seen.stars, last.stars), _STARS_SHARE, "stars", run),
        *_weak(kinds.NOISIER, (seen.rms_px, last.rms_px), _RESIDUAL_SHARE, "px", run),
    ]
    yield from weak[:1]


def _weak_light(seen: _Seen, last: _Seen, run: str) -> Iterator[Cause]:
    """Yield that the pixels react later than in the last run, as in weaker light, or less, as in a brighter room too.

    Only an edge has a delay: a sine begins before its sync signal. Light that does not flicker makes no pixel slower.
    """
    delays_us = None
    if seen.light.get("waveform") == last.light.get("waveform") == "square":
        delays_us = seen.of_poses(seen.on_delay_us, last.on_delay_us)
    slower = list(_weak(kinds.SLOWER, delays_us, _DELAY_SHARE, "us", run))
    no_later = delays_us is not None and delays_us[0] < delays_us[1] * math.exp(_DELAY_SHARE)
    fewer = kinds.ROOM if no_later else kinds.DIMMER
    yield from slower
    yield from _weak(fewer, seen.of_poses(seen.off_events, last.off_events), _EVENTS_SHARE, "events", run)


def _weak(
    kind: str, both: tuple[float, float] | None, share: float, unit: str, run: str = ""
) -> Iterator[Cause]:
    """Yield that a number is worse than the one expected of it, as a sign of a weak image."""
    now, then = both or (0.0, 0.0)
    worse = now > then if kind in {kinds.NOISIER, kinds.SLOWER} else now < then
    if then > 0.0 and worse and (evidence := _evidence(now / then, share)) > DECISIVE:
        yield Cause(kind, evidence, now, unit=unit, stated=then, before=run)


#: By name of a setting: what it is, what it was, and its unit.
_Settings = Mapping[str, tuple[float | None, float | None, str]]


def _other_setting(kind: str, settings: _Settings, share: float, run: str) -> Iterator[Cause]:
    """Yield the first setting that differs from that of the last run by more than a share."""
    for name, (now, then, unit) in settings.items():
        if now is not None and then is not None and abs(now - then) > share * abs(then):
            yield Cause(
                kind, 2.0 * DECISIVE, float(now), unit=unit, stated=float(then), axis=name, before=run
            )
            return


def _light_settings(seen: _Seen, last: _Seen) -> _Settings:
    """Return the settings of the light; the duty as the sync signal shows it, too."""
    now, then = seen.light, last.light
    levels = [(light.get("low_v"), light.get("high_v")) for light in (now, then)]
    height = [None if low is None or high is None else high - low for low, high in levels]
    duty = seen.of_poses(seen.duty, last.duty)
    shown = (100.0 * duty[0], 100.0 * duty[1]) if duty else (None, None)
    return {
        "frequency": (now.get("frequency_hz"), then.get("frequency_hz"), "Hz"),
        "duty": (now.get("duty_percent"), then.get("duty_percent"), "%"),
        "duty by the sync signal": (*shown, "%"),
        "level": (height[0], height[1], "V"),
    }


def _camera_settings(seen: _Seen, last: _Seen) -> _Settings:
    """Return the biases and filters of the camera."""
    return {
        name: (own, last.camera.get(name, own), kinds.SWITCH if isinstance(own, bool) else "")
        for name, own in seen.camera.items()
    }


def _against_station(job: Job, calibration: Calibration, seen: _Seen) -> Iterator[Cause]:
    """Yield that the stars are fewer, or noisier, than a station expects on whose bench no run was before."""
    expected = job.station.expected
    if expected is None:
        return
    stars = expected_stars(job, calibration)
    counted = (statistics.median(seen.stars.values()), stars) if stars and seen.stars else None
    noise = calibration.rms_px / math.sqrt(2.0), max(expected.star_sigma_px, expected.collimator.rms_px)
    weak = [
        *_weak(kinds.FEWER, counted, _EXPECTED_STARS, "stars"),
        *_weak(kinds.NOISIER, noise, _EXPECTED_NOISE, "px"),
    ]
    yield from weak[:1]


def expected_stars(job: Job, calibration: Calibration) -> float | None:
    """Return the median number of stars that the station expects of a pose of the plan."""
    poses = {str(pose.name): engine_angles_deg(pose.angles_deg) for pose in job.plan.poses}
    try:
        bench = forecast_bench(job.plan)
        stars = [
            len(predicted_view(bench, poses[view.name], view.name)[0])
            for view in calibration.views
            if view.name in poses
        ]
    except CalibrationError:
        return None
    return statistics.median(stars) if stars else None
