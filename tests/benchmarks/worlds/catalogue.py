"""The worlds by name, and one result of the table."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from . import polynomial, product, ray_traced, stranger
from .bench import POSES, Bench
from .judge import judged

#: A world draws a bench from a seed, a number of poses, how often each is recorded, and which camera stands before the glass.
Draw = Callable[[int, int, int, int], Bench]


def _polynomial(kind: str, seed: int, poses: int, times: int = 1, camera: int = 0) -> Bench:
    return polynomial.record(polynomial.draw_world(seed, kind, camera), seed, POSES[poses], times, camera)


def _ray_traced(kind: str, seed: int, poses: int, times: int = 1, camera: int = 0) -> Bench:
    return ray_traced.record(ray_traced.draw_world(seed, camera, kind), seed, POSES[poses], times, camera)


def _product(profile: str, seed: int, poses: int, times: int = 1, camera: int = 0) -> Bench:
    return product.draw(seed, POSES[poses], times, camera, profile)


WORLDS: Mapping[str, Draw] = {
    "polynomial": partial(_polynomial, "real"),
    "raytraced": partial(_ray_traced, "real"),
    "product": partial(_product, "like-bench"),
    "stranger": stranger.draw,
    "ideal": partial(_polynomial, "ideal"),
    "polynomial-far": partial(_polynomial, "far"),
    "raytraced-far": partial(_ray_traced, "far"),
    "S1": partial(_polynomial, "S1"),
    "S2": partial(_polynomial, "S2"),
    "product-S1": partial(_product, "S1"),
    "product-S2": partial(_product, "S2"),
}


def result(world: str, poses: int, seed: int, known: str) -> dict[str, Any]:
    """Calibrate one bench of a world, and compare it with its truth.

    known: One of `knowledge.KNOWN`; ``passport`` is nine poses with a certificate, then another camera before the same
      glass; a number behind ``x`` records each pose so often, and one behind ``@`` makes the certificate that of a
      collimator so many times as long.
    """
    draw, what = WORLDS[world], known
    line = {"world": world, "poses_asked": poses, "seed": seed}
    if known == "passport":
        before = draw(seed, 9, 1, 0), "cr"
        return {**line, **judged(draw(seed, poses, 1, 1), known, before)}
    rest, _, longer = known.partition("@")
    what, _, times = rest.partition("x")
    bench = draw(seed, poses, int(times or 1), 0)
    bench = replace(bench, stated=replace(bench.stated, r_mm=float(longer or 1.0) * bench.stated.r_mm))
    if "r" in what and bench.facts.get("by_hand"):
        raise ArithmeticError("A hand moves this camera: there are no readings.")
    return {**line, **judged(bench, what), "known": known}
