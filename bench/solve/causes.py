"""What a person did to the bench, as far as a run shows it: causes of the engine, and those that expectations show.

An expectation is what the station expects, and what the last run of this sequence with this camera on this bench had.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from bench.measure.expected_grid import engine_angles_deg
from bench.plan.job import Job
from bench.record.events import LightSettingsData, RecordedData
from bench.record.history import History
from bench.record.measured_facts import ImageFacts, MeasuredFacts
from bench.record.results import CameraConditions, Conditions, PoseData, Results
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
#: A computer that is this late at once, s, has slept or was stopped: load alone makes a tenth of it.
_STOOD_STILL_S = 10.0


class _Pose(NamedTuple):
    """What the accepted recording of a pose showed; None if it is not known."""

    stars: int | None  # None where silent lines cost stars: a note of the run tells these
    off_events: float | None  # Events at one falling edge of the light, of the pixels that follow the light
    on_delay_us: float | None  # Of the first ON events after a square light rises
    duty: float | None  # By the edges of the sync signal, as a share of the period

    @classmethod
    def of(cls, stars: int | None, facts: MeasuredFacts | PoseData) -> _Pose:
        """Return what is known of a recording whose view has so many stars."""
        image = facts.get("image") or ImageFacts()
        silent = image.get("silent_rows") or image.get("silent_columns")
        off_events = image.get("lit_pixels", 0) * (image.get("events_per_edge_off") or 0.0)
        delay_us = image.get("first_on_delay_us")
        return cls(None if silent else stars, off_events, delay_us, facts.get("flicker_duty"))


class _Seen(NamedTuple):
    """What the accepted recordings of a run showed."""

    poses: Mapping[str, _Pose]
    rms_px: float
    light: LightSettingsData
    camera: Mapping[str, int | bool]  # Biases and filters, as read back

    def beside(self, last: _Seen, number: str) -> tuple[float, float] | None:
        """Return the medians of a number here and in the last run, over the poses that know it in both, if any."""
        both = [
            (getattr(self.poses[name], number), getattr(last.poses[name], number))
            for name in self.poses
            if name in last.poses
        ]
        known = [(now, then) for now, then in both if now and then]
        if not known:
            return None
        now, then = zip(*known, strict=True)
        return statistics.median(now), statistics.median(then)


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
    accepted, stars = list(history.accepted().values()), {view.name: view.n for view in calibration.views}
    poses = {each.pose_name: _Pose.of(stars.get(each.pose_name), each.measured) for each in accepted}
    stored = accepted[-1].stored if accepted else None
    light, facts = (stored["light"], stored["facts"]) if stored else (LightSettingsData(), RecordedData())
    return _Seen(poses, calibration.rms_px, light, _read_back(facts))


def _seen_before(results: Results) -> _Seen:
    poses = {
        pose["name"]: _Pose.of(pose["stars"], pose) for pose in results.get("poses", ()) if pose["stars"]
    }
    conditions = results.get("conditions") or Conditions(light=LightSettingsData(), camera=CameraConditions())
    return _Seen(
        poses, float(results["calibration"]["rms_px"]), conditions["light"], _read_back(conditions["camera"])
    )


def _read_back(facts: RecordedData | CameraConditions) -> dict[str, int | bool]:
    return {**(facts.get("biases") or {}), **(facts.get("filters") or {})}


def _evidence(ratio: float, share: float) -> float:
    """Return 2 log of the likelihood ratio of a changed number against one that varies by a share (1 sigma).

    (log(ratio) / share)^2, for a normal distribution of the logarithm.
    """
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
    """Yield that the computer stood still. The time of day says nothing: somebody, or a time server, sets it."""
    longest_s = history.lateness.get("longest_s", 0.0)
    if longest_s >= _STOOD_STILL_S:
        yield Cause(kinds.ASLEEP, LARGEST_EVIDENCE, longest_s, unit="s")


def _against_last(seen: _Seen, results: Results) -> Iterator[Cause]:
    """Yield what differs from the last run: settings, and the sign of a weak image that is known best."""
    last, run = _seen_before(results), str(results["run"]["id"])
    yield from _other_settings(seen, last, run)
    weak = [
        *_weak_light(seen, last, run),
        *_weak(kinds.FEWER, seen.beside(last, "stars"), _STARS_SHARE, "stars", run),
        *_weak(kinds.NOISIER, (seen.rms_px, last.rms_px), _RESIDUAL_SHARE, "px", run),
    ]
    yield from weak[:1]


def _weak_light(seen: _Seen, last: _Seen, run: str) -> Iterator[Cause]:
    """Yield that the pixels react later than in the last run, as in weaker light, or less, as in a brighter room too.

    Only an edge has a delay: a sine begins before its sync signal. Light that does not flicker makes no pixel slower.
    """
    delays_us = None
    if seen.light.get("waveform") == last.light.get("waveform") == "square":
        delays_us = seen.beside(last, "on_delay_us")
    slower = list(_weak(kinds.SLOWER, delays_us, _DELAY_SHARE, "us", run))
    no_later = delays_us is not None and delays_us[0] < delays_us[1] * math.exp(_DELAY_SHARE)
    fewer = kinds.ROOM if no_later else kinds.DIMMER
    yield from slower
    yield from _weak(fewer, seen.beside(last, "off_events"), _EVENTS_SHARE, "events", run)


def _weak(
    kind: str, both: tuple[float, float] | None, share: float, unit: str, run: str = ""
) -> Iterator[Cause]:
    """Yield that a number is worse than the one expected of it, as a sign of a weak image."""
    now, then = both or (0.0, 0.0)
    worse = now > then if kind in {kinds.NOISIER, kinds.SLOWER} else now < then
    if then > 0.0 and worse and (evidence := _evidence(now / then, share)) > DECISIVE:
        yield Cause(kind, evidence, now, unit=unit, stated=then, before=run)


def _other_settings(seen: _Seen, last: _Seen, run: str) -> Iterator[Cause]:
    """Yield the first setting of the light that differs from that of the last run, and the first of the camera.

    The sync signal shows the duty of the light, too.
    """
    (now, then), duty = (seen.light, last.light), seen.beside(last, "duty") or (None, None)
    levels = [(light.get("low_v"), light.get("high_v")) for light in (now, then)]
    heights = [None if low is None or high is None else high - low for low, high in levels]
    of_light: list[tuple[str, float | None, float | None, str]] = [
        ("frequency", now.get("frequency_hz"), then.get("frequency_hz"), "Hz"),
        ("duty", now.get("duty_percent"), then.get("duty_percent"), "%"),
        ("duty by the sync signal", duty[0] and 100.0 * duty[0], duty[1] and 100.0 * duty[1], "%"),
        ("level", heights[0], heights[1], "V"),
    ]
    of_camera: list[tuple[str, float | None, float | None, str]] = [
        (name, own, last.camera.get(name), kinds.SWITCH if isinstance(own, bool) else "")
        for name, own in seen.camera.items()
    ]
    for kind, settings, share in ((kinds.LIGHT, of_light, _SAME_SETTING), (kinds.CAMERA, of_camera, 0.0)):
        for name, value, before, unit in settings:
            if value is not None and before is not None and abs(value - before) > share * abs(before):
                stated = float(before)
                yield Cause(
                    kind, 2.0 * DECISIVE, float(value), unit=unit, stated=stated, axis=name, before=run
                )
                break


def _against_station(job: Job, calibration: Calibration, seen: _Seen) -> Iterator[Cause]:
    """Yield that the stars are fewer, or noisier, than a station expects on whose bench no run was before."""
    expected = job.station.expected
    if expected is None:
        return
    wanted = expected_stars(job, calibration)
    counts = [pose.stars for pose in seen.poses.values() if pose.stars]
    stars = (statistics.median(counts), wanted) if counts and wanted else None
    noise = calibration.rms_px / math.sqrt(2.0), max(expected.star_sigma_px, expected.collimator.rms_px)
    weak = [
        *_weak(kinds.FEWER, stars, _EXPECTED_STARS, "stars"),
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
