"""World 3: the optics of the product's own simulators, with every sign drawn.

The profiles of the simulators are those of one real collimator, so their errors have its signs. Here each error has a
random sign and size.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from simulators.world.truth import COLLIMATORS, CameraTruth, CollimatorTruth, MountTruth, ReticleTruth
from tests.support.drawn_benches import DrawnBench, draw_repeats, gimbal_truth

from .bench import Bench, Camera, Pose, Seen, Stated
from .polynomial import draw_camera

ERRORS = ("defocus", "coma", "astigmatism", "field_curvature", "distortion", "rim_roll_mm")
IRREGULAR = ("irregularity_mm", "rim_irregularity_mm")
FAMILIES = ("k1k2", "p1p2k3")


def draw(
    seed: int, poses: Sequence[Pose], times: int = 1, other_camera: int = 0, profile: str = "like-bench"
) -> Bench:
    """Draw a bench and what its station states.

    profile: ``like-bench``, or ``S1`` and ``S2``, whose mount is moved by hand.
    """
    rng = np.random.default_rng((seed, 31))
    size, by_hand = float(rng.uniform(0.2, 1.2)), profile in ("S1", "S2")
    off = float(rng.normal(0, 3))
    glass = draw_glass(rng, COLLIMATORS[profile], size)
    if not by_hand:
        glass = replace(glass, disc_walk=(-off, -off))
    sigma_r, sigma_defocus = float(rng.uniform(0.03, 0.1)), max(0.002, 0.01 * size)
    z = rng.normal(size=6)
    bow = float(np.exp(rng.uniform(np.log(0.005), np.log(0.02))))
    stated = Stated(
        float(glass.r + sigma_r * z[0]),
        sigma_r,
        (float(glass.defocus + sigma_defocus * z[1]), float(sigma_defocus)),
        (float(off + 0.5 * z[2]), 0.5),
        bounded=not by_hand,
        print_bow_mm=bow,
    )
    own = np.random.default_rng((seed, 32, other_camera))
    camera = draw_camera(own, FAMILIES[(seed + other_camera) % len(FAMILIES)])
    values = {name: float(value) for name, value in camera.values.items()}
    star = float(own.uniform(0.01, 0.02))
    drawn = draw_repeats(
        glass,
        [{"pan": pan, "tilt": tilt} for pan, tilt in poses],
        int(rng.integers(1, 2**30)) + other_camera,
        times,
        camera=CameraTruth(**values),
        gimbal=gimbal_truth(own),
        reticle=ReticleTruth(bow_mm=bow * rng.uniform(-1, 1)),
        mount=MountTruth(drift_arcsec_per_min=tuple(own.normal(0, 0.3, 2).tolist())),
        star_sigma_px=star,
        common_share=0.4,
    )
    facts = {"f": values["fx"], "size": size, "star_px": star, "r": glass.r, "times": times}
    facts["profile"] = profile
    return _bench(drawn, stated, Camera(values, camera.family), float(np.exp(0.1 * own.normal())), facts)


def draw_glass(rng: np.random.Generator, profile: CollimatorTruth, size: float) -> CollimatorTruth:
    signs, shares = rng.choice([-1.0, 1.0], len(ERRORS)), rng.uniform(0.5, 1.5, len(ERRORS))
    drawn = zip(ERRORS, signs, shares, strict=True)
    changed = {name: float(size * getattr(profile, name) * s * a) for name, s, a in drawn}
    changed |= {name: float(size * getattr(profile, name)) for name in IRREGULAR}
    return replace(profile, r=float(rng.uniform(250, 260)), **changed)


def _bench(drawn: DrawnBench, stated: Stated, camera: Camera, off: float, facts: dict[str, Any]) -> Bench:
    seen = ((v, off * np.sqrt(v.covariances_px2[:, 0, 0])) for v in drawn.views)
    views = [Seen(v.name, v.ids, v.points_px, v.target_mm, sigmas) for v, sigmas in seen]
    return Bench("product", views, drawn.readings_deg, stated, camera, facts)
