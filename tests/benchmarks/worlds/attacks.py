"""Wrong data of a bench: changes of statements, views, readings and poses, and two benches that are attacked by them."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from .bench import NINE, Bench, Seen
from .geometry import COLUMNS, printed_stars
from .judge import judged
from .polynomial import World, draw_world, record

RIGHT_WITHIN = 1.3
"""A result is right if every error is within so many U."""
ChangeBench = Callable[[Bench], Bench]


def statement(**changed: Any) -> ChangeBench:
    """Change statements; a callable gets the old value."""

    def change(bench: Bench) -> Bench:
        new = {name: to(getattr(bench.stated, name)) if callable(to) else to for name, to in changed.items()}
        return replace(bench, stated=replace(bench.stated, **new))

    return change


def views(change: Callable[[int, Seen], Seen]) -> ChangeBench:
    """Change each view, counted from 0."""
    return lambda bench: replace(bench, views=[change(i, view) for i, view in enumerate(bench.views)])


def readings(change: Callable[[int, dict[str, float]], dict[str, float]]) -> ChangeBench:
    """Change each reading, counted from 0."""
    return lambda bench: replace(
        bench, readings_deg=[change(i, dict(pose)) for i, pose in enumerate(bench.readings_deg)]
    )


def shifted(view: Seen) -> Seen:
    """Every star has the name of its neighbour to the right."""
    ids, mm = printed_stars()
    column = np.round(view.mm[:, 0] / mm[1, 0]).astype(int)
    right = {tuple(np.round(at, 3)): star for at, star in zip(mm, ids, strict=True)}
    moved = view.mm + np.array([mm[1, 0], 0.0])
    places = np.array([right.get(tuple(np.round(at, 3)), -1) for at in moved])
    kept = (places >= 0) & (column < COLUMNS - 1)
    return Seen(view.name, places[kept], view.px[kept], mm[places[kept]], view.sigma_px[kept])


def _radius_drift(number: int, world: World) -> World:
    terms = {**world.glass.terms, "defocus": world.glass.terms["defocus"] + 0.002 * number}
    return replace(world, glass=replace(world.glass, r=world.glass.r * (1 + 1e-4 * number), terms=terms))


def radius_drifts(seed: int) -> dict[str, Any]:
    """Calibrate a bench whose collimator's radius and defocus grow from pose to pose."""
    return _told(record(draw_world(seed), seed, NINE, changed=_radius_drift))


def ids_shifted(seed: int) -> dict[str, Any]:
    """Calibrate a bench with the ids of the fifth view shifted by one."""
    shift = views(lambda i, view: shifted(view) if i == 4 else view)
    return _told(shift(record(draw_world(seed), seed, NINE)))


def _told(bench: Bench) -> dict[str, Any]:
    line = judged(bench, "cr", lens="right")
    line["right"] = all(abs(line["error"][what]) <= RIGHT_WITHIN * u for what, u in line["U"].items())
    return line
