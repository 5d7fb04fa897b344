"""Wrong statements and wrong data, each with the words by which a note names it.

A result is right if every error is within 1.3 U. Otherwise a note, or the refusal, must name what was made wrong.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from .bench import GRID, NINE, THREE, Bench, Pose, Seen
from .geometry import COLUMNS, SIZE, printed_stars
from .judge import judged
from .polynomial import World, draw_world, record

RIGHT_WITHIN = 1.3
ChangeWorld = Callable[[World], World]
ChangeBench = Callable[[Bench], Bench]
ChangePose = Callable[[int, World], World]

CERTIFICATE = "certificate|passport|radius"
SCALE = "scale"
PARALLAX = "pupil|defocus|parallax"
PRINT = "print|target|reticle|pitch|anisotrop|unit"
READINGS = "reading|axis|axes|slip"
POSE = r"pose [#5]|view [#5]"
STARS = "star|neighbour|outlier|gross"
DRIFT = "drift|changed|temperature|focal length"


@dataclass(frozen=True)
class Attack:
    """One way to be wrong."""

    named_by: str  # pattern of a note that names it; empty if nothing is wrong
    known: str = "cr"
    world: ChangeWorld = lambda world: world
    bench: ChangeBench = lambda bench: bench
    each_pose: ChangePose = lambda _, world: world
    poses: Sequence[Pose] = NINE
    times: int = 1
    seen: bool = True  # False: nothing that the bench knows could show it


def statement(**changed: Any) -> ChangeBench:
    """Change statements; a callable gets the old value."""

    def change(bench: Bench) -> Bench:
        new = {name: to(getattr(bench.stated, name)) if callable(to) else to for name, to in changed.items()}
        return replace(bench, stated=replace(bench.stated, **new))

    return change


def views(change: Callable[[int, Seen], Seen]) -> ChangeBench:
    """Change each view, counted from 0."""
    return lambda bench: replace(bench, views=[change(i, view) for i, view in enumerate(bench.views)])


def one_view(change: Callable[[Seen], Seen]) -> ChangeBench:
    """Change the fifth view, or the second of three."""
    return lambda bench: views(lambda i, view: change(view) if i == min(4, len(bench.views) - 2) else view)(
        bench
    )


def readings(change: Callable[[int, dict[str, float]], dict[str, float]]) -> ChangeBench:
    """Change each reading, counted from 0."""
    return lambda bench: replace(
        bench, readings_deg=[change(i, dict(pose)) for i, pose in enumerate(bench.readings_deg)]
    )


def _certificate(share: float) -> ChangeBench:
    return statement(r_mm=lambda r: r * (1 + share))


def _gimbal_scale(pan: float, tilt: float) -> ChangeWorld:
    return lambda world: replace(
        world, gimbal=replace(world.gimbal, scales=world.gimbal.scales * (1 + np.array([pan, tilt])))
    )


def _glass(**changed: Any) -> ChangeWorld:
    return lambda world: replace(world, glass=replace(world.glass, **changed))


def _defocused(stated_mm: float, stated: float = 0.05, **mount: float) -> ChangeWorld:
    """A defocus of .05, and where the pupil is; stated are a defocus, and the pupil in front of the pivot to .5 mm."""
    return lambda world: replace(
        world,
        glass=replace(world.glass, terms={**world.glass.terms, "defocus": 0.05}),
        mount=replace(world.mount, **mount),
        stated=replace(world.stated, off_pivot_mm=(stated_mm, 0.5), defocus=(stated, 0.005)),
    )


_BY_HAND = _defocused(2.0, off_pivot_mm=44.0, wander_mm=8.5)


def _bow(world: World) -> World:
    return replace(world, glass=replace(world.glass, bow_mm=10 * world.stated.print_bow_mm))


def _print_scale(world: World) -> World:
    return replace(world, glass=replace(world.glass, print_scale=world.glass.print_scale + 1e-3))


def _focal_drift(share: float) -> ChangePose:
    def at(number: int, world: World) -> World:
        v = world.camera.values
        values = {**v, "fx": v["fx"] * (1 + share * number), "fy": v["fy"] * (1 + share * number)}
        return replace(world, camera=replace(world.camera, values=values))

    return at


def _radius_drift(number: int, world: World) -> World:
    terms = {**world.glass.terms, "defocus": world.glass.terms["defocus"] + 0.002 * number}
    return replace(world, glass=replace(world.glass, r=world.glass.r * (1 + 1e-4 * number), terms=terms))


def _moved(mm: float) -> ChangePose:
    return lambda number, world: (
        replace(world, glass=replace(world.glass, foot_mm=world.glass.foot_mm + np.array([mm, 0.0])))
        if number == 4
        else world
    )


def _outliers(px: float) -> ChangeBench:
    def spoil(i: int, view: Seen) -> Seen:
        rng = np.random.default_rng((77, i))
        bad = rng.random(len(view.ids)) < 0.1
        return replace(view, px=view.px + bad[:, None] * rng.uniform(-px, px, view.px.shape))

    return views(spoil)


def shifted(view: Seen) -> Seen:
    """Every star has the name of its neighbour to the right."""
    ids, mm = printed_stars()
    column = np.round(view.mm[:, 0] / mm[1, 0]).astype(int)
    right = {tuple(np.round(at, 3)): star for at, star in zip(mm, ids, strict=True)}
    moved = view.mm + np.array([mm[1, 0], 0.0])
    places = np.array([right.get(tuple(np.round(at, 3)), -1) for at in moved])
    kept = (places >= 0) & (column < COLUMNS - 1)
    return Seen(view.name, places[kept], view.px[kept], mm[places[kept]], view.sigma_px[kept])


def _duplicate(bench: Bench) -> Bench:
    copy = replace(bench.views[4], name="pose 10")
    return replace(
        bench, views=[*bench.views, copy], readings_deg=[*bench.readings_deg, bench.readings_deg[4]]
    )


def _sized(size: tuple[int, int]) -> ChangeBench:
    return lambda bench: replace(bench, facts={**bench.facts, "size_px": size})


def _shuffled(bench: Bench) -> Bench:
    order = np.random.default_rng(5).permutation(len(bench.readings_deg))
    return replace(bench, readings_deg=[bench.readings_deg[i] for i in order])


def _swapped(_: int, pose: dict[str, float]) -> dict[str, float]:
    return {"pan_deg": pose["tilt_deg"], "tilt_deg": pose["pan_deg"]}


def _signs(pan: float, tilt: float) -> ChangeBench:
    return readings(lambda _, pose: {"pan_deg": pan * pose["pan_deg"], "tilt_deg": tilt * pose["tilt_deg"]})


def _slip(deg: float) -> ChangeBench:
    return readings(lambda i, pose: {**pose, "pan_deg": pose["pan_deg"] + (deg if i > 4 else 0.0)})


def _one_reading(deg: float) -> ChangeBench:
    return readings(lambda i, pose: {**pose, "pan_deg": pose["pan_deg"] + (deg if i == 4 else 0.0)})


def _noisy_readings(i: int, pose: dict[str, float]) -> dict[str, float]:
    return {
        name: angle + 0.012 * float(np.random.default_rng((i, len(name))).normal())
        for name, angle in pose.items()
    }


_ATTACKS: dict[str, Attack] = {"nothing is wrong": Attack("")}
_ATTACKS |= {
    f"certificate {s:+.2%}": Attack(CERTIFICATE, bench=_certificate(s))
    for s in (0.0025, 0.005, -0.005, 0.01, -0.01)
}
_ATTACKS |= {
    "certificate +0.50%, three poses": Attack(CERTIFICATE, bench=_certificate(0.005), poses=THREE),
    "certificate +0.50%, no readings": Attack(CERTIFICATE, "c", bench=_certificate(0.005), seen=False),
    "gimbal scale .2 %": Attack(SCALE, world=_gimbal_scale(0.002, 0.002)),
    "gimbal scale -.2 %, three poses": Attack(SCALE, world=_gimbal_scale(-0.002, -0.002), poses=THREE),
    "gimbal scale 1 %": Attack(SCALE, world=_gimbal_scale(0.01, 0.01)),
    "gimbal scale of pan .5 %": Attack(SCALE, world=_gimbal_scale(0.005, 0.0)),
    "gimbal scale of pan .5 %, no certificate": Attack(SCALE, "r", world=_gimbal_scale(0.005, 0.0)),
    "gimbal scale 1 %, no certificate": Attack(SCALE, "r", world=_gimbal_scale(0.01, 0.01), seen=False),
    "pupil 12 mm, stated 2": Attack(PARALLAX, world=_defocused(2.0, off_pivot_mm=12.0)),
    "moved by hand, stated on a gimbal": Attack(PARALLAX, world=_BY_HAND),
    "moved by hand, stated on a gimbal, three poses": Attack(PARALLAX, world=_BY_HAND, poses=THREE),
    "defocus of the wrong sign": Attack(PARALLAX, world=_defocused(5.0, -0.05, off_pivot_mm=5.0)),
    "anisotropic print .3 %": Attack(PRINT, world=_glass(print_scale=np.array([0.003, 0.0]))),
    "anisotropic print .3 %, three poses": Attack(
        PRINT, world=_glass(print_scale=np.array([0.003, 0.0])), poses=THREE
    ),
    "pitch -.35 %": Attack(f"{PRINT}|{CERTIFICATE}", bench=views(lambda _, v: replace(v, mm=0.9965 * v.mm))),
    "pitch +5 %": Attack(f"{PRINT}|{CERTIFICATE}", bench=views(lambda _, v: replace(v, mm=1.05 * v.mm))),
    "target in inches": Attack(
        f"{PRINT}|{CERTIFICATE}", bench=views(lambda _, v: replace(v, mm=v.mm / 25.4))
    ),
    "print scale 1e-3": Attack(f"{PRINT}|{CERTIFICATE}", world=_print_scale),
    "print bow 10 times": Attack(f"{PRINT}|bow", world=_bow),
    "axes swapped": Attack(READINGS, bench=readings(_swapped)),
    "sign of pan wrong": Attack(READINGS, bench=_signs(-1, 1)),
    "both signs wrong": Attack(READINGS, bench=_signs(-1, -1)),
    "readings of other poses": Attack(READINGS, bench=_shuffled),
    "readings of other poses, no certificate": Attack(READINGS, "r", bench=_shuffled),
    "slip .01 deg": Attack(READINGS, bench=_slip(0.01)),
    "slip .05 deg": Attack(READINGS, bench=_slip(0.05)),
    "slip .5 deg": Attack(READINGS, bench=_slip(0.5)),
    "slip .05 deg, no certificate": Attack(READINGS, "r", bench=_slip(0.05)),
    "one reading .1 deg off": Attack(f"{READINGS}|{POSE}", bench=_one_reading(0.1)),
    "readings 5 times noisier": Attack(READINGS, bench=readings(_noisy_readings)),
    "focal length drifts 1e-4 a pose": Attack(DRIFT, each_pose=_focal_drift(1e-4)),
    "focal length drifts 5e-4 a pose": Attack(DRIFT, each_pose=_focal_drift(5e-4)),
    "radius and defocus drift": Attack(DRIFT, each_pose=_radius_drift),
    "target moved .1 mm in a pose": Attack(f"{POSE}|{DRIFT}", each_pose=_moved(0.1)),
    "target moved .5 mm in a pose": Attack(f"{POSE}|{DRIFT}", each_pose=_moved(0.5)),
    "target moved 2 mm in a pose": Attack(f"{POSE}|{DRIFT}", each_pose=_moved(2.0)),
    "outliers 1 px": Attack(STARS, bench=_outliers(1.0)),
    "outliers 30 px": Attack(STARS, bench=_outliers(30.0)),
    "outliers 300 px": Attack(STARS, bench=_outliers(300.0)),
    "ids of a view shifted": Attack("shift|" + STARS, bench=one_view(shifted)),
    "a view twice": Attack("twice|same|duplicate|identical", bench=_duplicate),
    "half a pixel in all views": Attack(
        "origin|half", bench=views(lambda _, v: replace(v, px=v.px + 0.5)), seen=False
    ),
    "half a pixel in a view": Attack(
        f"{POSE}|origin|half", bench=one_view(lambda v: replace(v, px=v.px + 0.5))
    ),
    "star sigmas 5 times too small": Attack(
        "sigma|noise|scatter", bench=views(lambda _, v: replace(v, sigma_px=v.sigma_px / 5))
    ),
    "mirrored images": Attack(
        "mirror", bench=views(lambda _, v: replace(v, px=[SIZE[0] - 1, 0] + v.px * [-1, 1]))
    ),
    "image size 1920 x 1080": Attack("image size|principal", bench=_sized((1920, 1080))),
    "image size 640 x 480": Attack("image size|outside", bench=_sized((640, 480))),
    "poses on a line": Attack("", poses=tuple((p, 0.4 * p) for p in np.linspace(-6, 6, 9))),
    "poses within 1 degree": Attack("", poses=tuple((p / 6, t / 5) for p, t in NINE)),
    "three poses three times": Attack("", poses=THREE, times=3),
    "nothing is wrong, 25 poses": Attack("", poses=GRID),
}
ATTACKS: Mapping[str, Attack] = _ATTACKS


def attacked(name: str, seed: int) -> dict[str, Any]:
    """Calibrate a bench with an attack, and tell whether it is right, named or silent.

    What the engine says about the same bench without the attack names nothing.
    """
    attack = ATTACKS[name]
    world = attack.world(draw_world(seed))
    bench = attack.bench(record(world, seed, attack.poses, attack.times, changed=attack.each_pose))
    line = {"attack": name, "seed": seed, "seen": attack.seen, **judged(bench, attack.known, "right")}
    sentences = _sentences(line) - _told_without(seed, attack.known, tuple(attack.poses), attack.times)
    line["named"] = bool(attack.named_by and re.search(attack.named_by, " ".join(sentences), re.IGNORECASE))
    if "refused" not in line:
        line["worst"] = max(abs(line["error"][what]) / u for what, u in line["U"].items())
        line["right"] = line["worst"] <= RIGHT_WITHIN
    return line


def _sentences(line: Mapping[str, Any]) -> frozenset[str]:
    """What the engine says, without numbers and without what it says that the data do not show."""
    texts = [*line.get("notes", ()), line.get("refused", "")]
    sentences = {
        re.sub(r"\d+(\.\d+)?", "#", sentence) for text in texts for sentence in re.split(r"(?<=\.) ", text)
    }
    return frozenset(sentence for sentence in sentences if not sentence.startswith("They do not show"))


@lru_cache
def _told_without(seed: int, known: str, poses: tuple[Pose, ...], times: int) -> frozenset[str]:
    """What the engine says about a bench without an attack."""
    return _sentences(judged(record(draw_world(seed), seed, poses, times), known, "right"))
