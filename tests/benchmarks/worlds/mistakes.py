"""What people do to a bench, at the level of views and readings, with the cause that must be named first.

The benches are those of the product's own optics with drawn signs (`product`), with certificate and bounded readings.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.errors import CalibrationError
from calib.model import cause as kinds
from calib.model.rotation import exp_map

from . import product
from .attacks import readings, shifted, statement, views
from .bench import NINE, Bench
from .geometry import SIZE
from .knowledge import Array, options_for, solve

Change = Callable[[Bench, np.random.Generator], Bench]


@dataclass(frozen=True)
class Mistake:
    """Something that a person does: it changes a bench; the first cause has one of the kinds, or a refusal the word."""

    change: Change
    named: tuple[str, ...] = ()
    refused: str = ""


def _after(rng: np.random.Generator) -> int:
    """Number of the first pose after the mistake: two poses or more lie before and after it."""
    return int(rng.integers(2, len(NINE) - 2))


def _turned(turns_deg: Callable[[np.random.Generator], Array], by_room: bool = False) -> Change:
    """Turn the camera at each pose by (9, 3) rotation vectors in its frame, or what it sees by those in the room's."""

    def change(bench: Bench, rng: np.random.Generator) -> Bench:
        turns = np.radians(turns_deg(rng))
        if by_room:
            angles = np.radians(NINE)
            heads = [exp_map(np.array([tilt, 0, 0])) @ exp_map(np.array([0, pan, 0])) for pan, tilt in angles]
            turns = np.einsum("nij,nj->ni", heads, turns)
        matrices = exp_map(turns)

        def turned(i: int, view: Any) -> Any:
            px = bench.camera.project(bench.camera.rays(view.px) @ matrices[i].T)
            seen = ((px > 0) & (px < np.array(SIZE) - 1)).all(axis=1)
            return replace(
                view, ids=view.ids[seen], px=px[seen], mm=view.mm[seen], sigma_px=view.sigma_px[seen]
            )

        return views(turned)(bench)

    return change


_POSES = np.arange(len(NINE))
#: When the poses are recorded if a person goes for a coffee, min.
_PAUSED = np.array([0, 1, 2, 3, 4, 5, 21, 22, 23])


def _knocked(deg: float, axis: Array | None = None, by_room: bool = False) -> Change:
    def turns(rng: np.random.Generator) -> Array:
        first, drawn = _after(rng), rng.normal(size=3)
        unit = drawn if axis is None else axis
        return np.outer(first <= _POSES, deg * unit / np.linalg.norm(unit))

    return _turned(turns, by_room)


def _creep(deg: float, by_room: bool = False, course: Array = _POSES) -> Change:
    return _turned(lambda _: np.outer(course, deg * np.array([0.45, 0.89, 0.0])), by_room)


def _paused(change: Change) -> Change:
    timed = views(lambda i, view: replace(view, recorded_s=60.0 * _PAUSED[i]))
    return lambda bench, rng: change(timed(bench), rng)


def _focus(log_f: Callable[[np.random.Generator], Array]) -> Change:
    """Change the focal length of each pose by (9,) shares."""

    def change(bench: Bench, rng: np.random.Generator) -> Bench:
        v, shares = bench.camera.values, log_f(rng)
        centre = np.array([v["cx"], v["cy"]])
        return views(lambda i, view: replace(view, px=centre + (1.0 + shares[i]) * (view.px - centre)))(bench)

    return change


def _ring(share: float) -> Change:
    return _focus(lambda rng: share * (_after(rng) <= _POSES))


def _pitch(factor: float) -> Change:
    return lambda bench, _: views(lambda _i, view: replace(view, mm=factor * view.mm))(bench)


def _slip(axis: str, deg: float) -> Change:
    def change(bench: Bench, rng: np.random.Generator) -> Bench:
        first = _after(rng)
        return readings(lambda i, pose: {**pose, axis: pose[axis] + deg * (i >= first)})(bench)

    return change


def _scale(axis: str, factor: float) -> Change:
    return lambda bench, _: readings(lambda _i, pose: {**pose, axis: factor * pose[axis]})(bench)


def _one_reading(deg: float) -> Change:
    def change(bench: Bench, rng: np.random.Generator) -> Bench:
        at = _after(rng)
        return readings(lambda i, pose: {**pose, "pan_deg": pose["pan_deg"] + deg * (i == at)})(bench)

    return change


def _readings_of(change: Callable[[Array], Array]) -> Change:
    """Change the (9, 2) readings of pan and tilt."""

    def changed(bench: Bench, _: np.random.Generator) -> Bench:
        angles = change(np.array([[pose["pan_deg"], pose["tilt_deg"]] for pose in bench.readings_deg]))
        return readings(lambda i, _: dict(zip(("pan_deg", "tilt_deg"), angles[i].tolist(), strict=True)))(
            bench
        )

    return changed


def _mirrored(bench: Bench, _: np.random.Generator) -> Bench:
    return views(lambda _i, view: replace(view, px=[SIZE[0] - 1, 0] + view.px * [-1, 1]))(bench)


def _rolled(bench: Bench, _: np.random.Generator) -> Bench:
    return views(lambda _i, view: replace(view, px=np.array(SIZE) - 1 - view.px))(bench)


def _shifted(bench: Bench, rng: np.random.Generator) -> Bench:
    at = _after(rng)
    return views(lambda i, view: shifted(view) if i == at else view)(bench)


MISTAKES: Mapping[str, Mistake] = {
    "camera knocked by 0.3 degrees": Mistake(_knocked(0.3), (kinds.TURNED,)),
    "camera knocked by 0.05 degrees": Mistake(_knocked(0.05), (kinds.TURNED,)),
    "focus ring turned by 3 degrees": Mistake(_ring(1.4e-3), (kinds.FOCUSED,)),
    "focus ring touched": Mistake(_ring(-5e-4), (kinds.FOCUSED,)),
    "pitch 4.2 instead of 4.0139 mm": Mistake(_pitch(4.2 / 4.0139), (kinds.SCALED,)),
    "pitch 4 instead of 4.0139 mm": Mistake(_pitch(4.0 / 4.0139), (kinds.SCALED,)),
    "another target, pitch 8 % smaller": Mistake(_pitch(1.0 / 0.92), (kinds.SCALED,)),
    "another target, pitch 25 % larger": Mistake(_pitch(0.8), (kinds.SCALED,), "pitch"),
    "certificate of another collimator": Mistake(
        lambda bench, _: statement(r_mm=lambda r: 1.01 * r)(bench), (kinds.SCALED,)
    ),
    "pan slips by 0.3 degrees": Mistake(_slip("pan_deg", 0.3), (kinds.SLIPPED,)),
    "tilt slips by 0.05 degrees": Mistake(_slip("tilt_deg", 0.05), (kinds.SLIPPED,)),
    "sign of pan": Mistake(_scale("pan_deg", -1.0), (kinds.REVERSED,)),
    "sign of tilt": Mistake(_scale("tilt_deg", -1.0), (kinds.REVERSED,)),
    "scale of pan 5 % off": Mistake(_scale("pan_deg", 1.05), (kinds.AXIS_SCALE,)),
    "scale of tilt halved": Mistake(_scale("tilt_deg", 0.5), (kinds.AXIS_SCALE,)),
    "one reading 0.2 degrees off": Mistake(_one_reading(0.2), (kinds.ONE_POSE,)),
    "images mirrored": Mistake(_mirrored, (), "mirror"),
    "camera upside down": Mistake(_rolled),  # which is right
    "ids of a view shifted": Mistake(_shifted, (kinds.IDS,)),
    "collimator knocked by 0.1 degrees": Mistake(_knocked(0.1, by_room=True), (kinds.MOVED,)),
    "collimator knocked by 0.5 degrees": Mistake(_knocked(0.5, by_room=True), (kinds.MOVED,)),
    "target turned in its holder": Mistake(_knocked(0.3, np.array([0.0, 0.0, 1.0]), True), (kinds.HELD,)),
    "camera creeps by 0.02 degrees a pose": Mistake(_creep(0.02), (kinds.CREEPS,)),
    "collimator creeps by 0.02 degrees a pose": Mistake(_creep(0.02, by_room=True), (kinds.SHIFTS,)),
    "camera creeps by 0.01 degrees a minute, one pause": Mistake(
        _paused(_creep(0.01, course=_PAUSED)), (kinds.CREEPS,)
    ),
    "collimator creeps by 0.01 degrees a minute, one pause": Mistake(
        _paused(_creep(0.01, by_room=True, course=_PAUSED)), (kinds.SHIFTS,)
    ),
    "camera loose by 0.05 degrees": Mistake(_turned(lambda rng: rng.normal(0, 0.05, (9, 3))), (kinds.LOOSE,)),
    "camera loose by 0.005 degrees": Mistake(
        _turned(lambda rng: rng.normal(0, 0.005, (9, 3))), (kinds.LOOSE,)
    ),
    "camera sags by 1 % of the tilt": Mistake(
        _turned(lambda _: np.array([[0.01 * tilt, 0.0, 0.0] for _, tilt in NINE])), (kinds.SAGS,)
    ),
    "focus ring creeps by 1e-3 a pose": Mistake(_focus(lambda _: 1e-3 * _POSES), (kinds.FOCUS_CREEPS,)),
    "focus ring creeps by 3e-4 a pose": Mistake(_focus(lambda _: 3e-4 * _POSES), (kinds.FOCUS_CREEPS,)),
    "focus ring creeps by 1e-4 a pose": Mistake(_focus(lambda _: 1e-4 * _POSES), (kinds.FOCUS_CREEPS,)),
    "focus ring creeps by 1e-4 a minute, one pause": Mistake(
        _paused(_focus(lambda _: 1e-4 * _PAUSED)), (kinds.FOCUS_CREEPS,)
    ),
    "focus plays by 1e-3": Mistake(_focus(lambda _: 1e-3 * (_POSES % 2)), (kinds.FOCUS_PLAYS,)),
    "pan and tilt exchanged": Mistake(_readings_of(lambda angles: angles[:, ::-1]), (kinds.EXCHANGED,)),
    "readings in gon": Mistake(_readings_of(lambda angles: angles / 0.9), (kinds.UNITS,)),
    "readings one pose late": Mistake(_readings_of(lambda angles: np.roll(angles, 1, axis=0)), (kinds.LATE,)),
    "readings of other poses": Mistake(
        _readings_of(lambda angles: angles[[4, 7, 1, 0, 8, 3, 6, 2, 5]]), (kinds.NONE_FITS,)
    ),
}


def mistaken(name: str, seed: int) -> dict[str, Any]:
    """Calibrate a bench with a mistake; ``healthy`` for none. ``right``: its cause is first, or none is named."""
    bench = product.draw(seed, NINE)
    mistake = MISTAKES.get(name, Mistake(lambda bench, _: bench))
    changed = mistake.change(bench, np.random.default_rng((seed, 93)))
    line: dict[str, Any] = {"mistake": name, "seed": seed}
    try:
        answer = solve(changed, options_for(changed, "cr", "right"))
    except CalibrationError as error:
        is_right = bool(mistake.refused and mistake.refused in str(error))
        return {**line, "causes": [], "told": [str(error)], "right": is_right, "wrong": not is_right}
    causes = [cause.kind for cause in answer.raw.causes]
    # A cause that the data cannot tell from another is told with the other.
    first = {causes[0], *answer.raw.causes[0].beside} if causes else set()
    right = bool(first & set(mistake.named)) if mistake.named else not causes
    true = bench.camera.values
    errors = {q: (answer.values[q] - true[q]) / answer.raw.U[q] for q in ("fx", "fy", "cx", "cy")}
    line["worst"] = round(max(map(abs, errors.values())), 2)
    return {
        **line,
        "causes": causes,
        "first": sorted(first),
        "told": list(answer.notes),
        "right": right,
        "wrong": bool(causes) and not right,
    }
