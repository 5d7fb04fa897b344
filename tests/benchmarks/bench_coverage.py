"""Measure how often the stated uncertainty covers the error, over benches that are drawn at random.

    python tests/benchmarks/bench_coverage.py [--benches 200] [--seed 1] [-o FILE] [--part 1/2] [--only INDEX]

Each bench has its own camera, collimator, gimbal errors, mount, print, poses, repeats, certificate and readings. The
model is ``auto``. The table has the share of benches whose error of fx, and of the worst point of the sensor, is within
k standard uncertainties; the root mean square of twice the error of fx over U, which is 1 if U is right; and how many
benches are beyond 3 U, with and without a note that names the trouble. With ``-o``, each
bench is appended to a file as a line of JSON; a later run with the same file goes on where the first one was stopped.
``--part 1/2`` calibrates every second bench, so that two processes can share the work. ``--only`` prints all about one
bench.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

# Before numpy is loaded: on small matrices, threads of the linear algebra cost more than they gain.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

sys.path.append(str(Path(__file__).parents[2]))
from calib.engine import Calibration, CalibrationOptions, calibrate
from calib.errors import CalibrationError
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport
from simulators.world.gimbal import GimbalTruth
from simulators.world.truth import COLLIMATORS, CameraTruth, CollimatorTruth, MountTruth, ReticleTruth
from tests.support.camera_errors import worst_corner
from tests.support.drawn_benches import DrawnBench, draw_bench, draw_repeats, grid

#: Errors of a collimator that `draw_case` scales together.
ABERRATIONS = (
    *("defocus", "coma", "astigmatism", "field_curvature", "distortion"),
    *("rim_roll_mm", "irregularity_mm", "rim_irregularity_mm"),
)
POSES = (1, 2, 3, 5, 9, 16, 25)
MAX_VIEWS = 36
#: Notes that name a trouble; a note on the choice of the model alone does not.
TROUBLE = re.compile(
    r"Views differ|is biased|Weak geometry|readings (contradict|scatter)|lens model|twice|shifted|origin|image size"
    r"|gross",
    re.IGNORECASE,
)
LENS = re.compile(r"lens model", re.IGNORECASE)


@dataclass(frozen=True)
class Case:
    """A drawn bench, and what its station states."""

    bench: DrawnBench
    options: CalibrationOptions
    facts: Mapping[str, Any]


def draw_case(seed: int, index: int) -> Case:
    """Draw a bench and what its station states."""
    rng = np.random.default_rng((seed, index))
    profile = str(rng.choice(["ideal", "S1", "S2", "S3", "like-bench"]))
    scale = float(rng.uniform(0.1, 1.0))
    bow_um = float(rng.uniform(-20.0, 20.0)) if rng.random() < 0.6 else 0.0
    certified = bool(rng.random() < 0.5)
    count = int(rng.choice(POSES if certified else POSES[2:]))
    poses = _poses(rng, count)
    times = int(rng.integers(2, 5)) if rng.random() < 0.25 and count * 4 <= MAX_VIEWS else 1
    tangential = bool(rng.random() < 0.1)
    collimator = replace(COLLIMATORS[profile], r=float(rng.uniform(230.0, 280.0)))
    if profile != "ideal":
        collimator = replace(collimator, **{name: scale * getattr(collimator, name) for name in ABERRATIONS})
    star = float(rng.uniform(0.01, 0.03))
    drawn = {
        "camera": _camera(rng, tangential=tangential),
        "gimbal": _gimbal(rng),
        "reticle": ReticleTruth(bow_mm=1e-3 * bow_um),
        "mount": MountTruth(drift_arcsec_per_min=tuple(rng.normal(0.0, 0.3, 2).tolist())),
        "star_sigma_px": star,
        "common_share": 0.4,
    }
    own = int(rng.integers(1, 2**30))
    passport, origin = None, ""
    sigma_r = float(rng.uniform(0.02, 0.1))
    stated_r = float(collimator.r + sigma_r * rng.normal())
    if certified:
        passport, origin = Passport.of_radius(stated_r, sigma_r), "certificate"
    bound = _bound(rng, profile, collimator, scale)
    kind = str(rng.choice(["none", "witness", "bounded"]))
    if kind == "bounded" and bound is None:
        kind = "witness"
    if count == 1 and passport is not None:
        # One pose needs x and y too: nine views of the same collimator gave them, with the same certificate.
        made = draw_bench(collimator, grid((-6, 0, 6), (-2.5, 0, 2.5)), own, **{**drawn, "camera": None})
        passport = calibrate(made.views, CalibrationOptions(model="auto", passport=passport)).passport()
        origin = "passport"
    bench = draw_repeats(collimator, poses, own, times, **drawn)
    gimbal = None
    if kind != "none":
        gimbal = GimbalReadings(
            tuple(bench.readings_deg), 0.0025, 2e-4, 0.001, bound if kind == "bounded" else None, "drawn"
        )
    facts = {
        "profile": profile,
        "scale": round(scale, 3),
        "bow_um": round(bow_um, 2),
        "poses": count,
        "times": times,
        "known": origin or "nothing",
        "sigma_r": round(sigma_r, 4) if certified else None,
        "readings": kind,
        "lens": "p1p2" if tangential else "k1k2",
        "f": round(bench.truth.camera.fx, 1),
        "star": round(star, 4),
        "bench_seed": own,
    }
    return Case(bench, CalibrationOptions(model="auto", passport=passport, gimbal=gimbal), facts)


def _poses(rng: np.random.Generator, count: int) -> list[dict[str, float]]:
    """Draw poses: half of the benches have a grid where there is one, the others have random poses; some roll."""
    grids = {9: ((-6, 0, 6), (-2.5, 0, 2.5)), 25: ((-6, -3, 0, 3, 6), (-2.5, -1.25, 0, 1.25, 2.5))}
    drawn, roll = rng.random() < 0.5, rng.random() < 0.3
    if count in grids and not drawn:
        return grid(*grids[count])
    # Random poses that fill the range: no two within half a degree.
    poses: list[dict[str, float]] = []
    while len(poses) < count:
        pose = {"pan": float(rng.uniform(-6, 6)), "tilt": float(rng.uniform(-3, 3))}
        if roll:
            pose["roll"] = float(rng.uniform(-45, 45))
        near = any(abs(p["pan"] - pose["pan"]) + abs(p["tilt"] - pose["tilt"]) < 0.5 for p in poses)
        if not near:
            poses.append({axis: round(angle, 3) for axis, angle in pose.items()})
    return poses


def _camera(rng: np.random.Generator, *, tangential: bool) -> CameraTruth:
    """Draw a camera."""
    f = float(rng.uniform(2000.0, 5000.0))
    cx, cy = rng.normal((640.0, 360.0), 8.0).tolist()
    wide = f / 3345.0  # the same distortion at the corner, in px, for all focal lengths
    p1, p2 = rng.choice([-1.0, 1.0], 2) * rng.uniform(0.0005, 0.002, 2) if tangential else (0.0, 0.0)
    return CameraTruth(
        fx=f,
        fy=float(f * (1.0 + 1e-4 * rng.normal())),
        cx=cx,
        cy=cy,
        k1=float(0.08 * wide**2 * rng.normal()),
        k2=float(0.6 * wide**4 * rng.normal()),
        p1=float(p1),
        p2=float(p2),
    )


def _gimbal(rng: np.random.Generator) -> GimbalTruth:
    """Draw the gimbal's errors, of the sizes that the station states."""
    return GimbalTruth(
        wobble_deg=0.001,
        eccentricity_deg=0.001,
        scale=tuple((2e-4 * rng.normal(size=3)).tolist()),
        backlash_deg=(0.001, 0.001, 0.001),
        nonorthogonality_deg=float(0.02 * rng.normal()),
        reading_sigma_deg=0.002,
        seed=int(rng.integers(1, 2**30)),
    )


def _bound(
    rng: np.random.Generator, profile: str, collimator: CollimatorTruth, scale: float
) -> ParallaxBound | None:
    """Draw an honest bound of the parallax; none where the disc moves by more than the pupil's offset explains."""
    if profile in ("S1", "S2"):
        return None
    off = -collimator.disc_walk[0]
    sigma_defocus = 0.002 if profile == "ideal" else 0.01 * scale
    defocus = collimator.defocus + sigma_defocus * rng.normal()
    return ParallaxBound(float(defocus), sigma_defocus, float(off + 0.5 * rng.normal()), 0.5)


def measure(seed: int, index: int) -> dict[str, Any]:
    """Calibrate a drawn bench and compare with its truth.

    seed, index: As for `draw_case`.
    """
    begun = time.process_time()
    line: dict[str, Any] = {"seed": seed, "index": index}
    try:
        case = draw_case(seed, index)
        line |= case.facts
        found = calibrate(case.bench.views, case.options)
    except CalibrationError as error:
        return {**line, "refused": str(error), "seconds": round(time.process_time() - begun, 2)}
    truth = case.bench.truth.camera
    corner = worst_corner(found, truth)
    return {
        **line,
        "model": found.model,
        "fx_error": found.camera.fx - truth.fx,
        "fx_sigma": found.sigma["fx"],
        "corner_error": corner.error_px,
        "corner_sigma": corner.sigma_px,
        "k": found.coverage_factor,
        "birge": found.birge_ratio,
        "entered": None if found.gimbal is None else found.gimbal.entered,
        "budget_fx": {row.name: round(row.contribution.get("fx", 0.0), 4) for row in found.budget_rows},
        "notes": list(found.notes),
        "seconds": round(time.process_time() - begun, 2),
    }


def explain(seed: int, index: int) -> None:
    """Print all about one bench: what was drawn, what was found, and what other models give.

    seed, index: As for `draw_case`.
    """
    case = draw_case(seed, index)
    for name, value in measure(seed, index).items():
        print(f"{name}: {json.dumps(value, ensure_ascii=False)}")
    truth = case.bench.truth.camera
    print(f"lens: {truth.k1:.4f} {truth.k2:.4f} {truth.p1:.5f} {truth.p2:.5f}")
    for model in ("spherical", "radial", "field", "coma", "drift"):
        try:
            found = calibrate(case.bench.views, replace(case.options, model=model))
        except CalibrationError as error:
            print(f"{model}: {error.what}")
            continue
        print(f"{model}: {_text(found, truth)}")


def _text(found: Calibration, truth: CameraTruth) -> str:
    """Return a calibration as text: error of fx, its expanded uncertainty, k and the Birge ratio."""
    expanded = found.coverage_factor * found.sigma["fx"]
    return (
        f"fx off by {found.camera.fx - truth.fx:+.2f} px, U {expanded:.2f} px, k {found.coverage_factor:.2f}, "
        f"Birge ratio {found.birge_ratio:.2f}, rms {found.rms_px:.4f} px"
    )


def over(line: Mapping[str, Any], what: str) -> float:
    """Return an error over its expanded uncertainty.

    what: ``fx`` or ``corner``.
    Returns: Its size; 1 is the limit.
    """
    return float(abs(line[f"{what}_error"]) / (line["k"] * line[f"{what}_sigma"]))


def named(line: Mapping[str, Any]) -> bool:
    """Return whether a note names the trouble of a bench; that of a lens with p1 and p2 must name the lens.

    Returns: True if a note does.
    """
    pattern = LENS if line["lens"] == "p1p2" else TROUBLE
    return any(pattern.search(note) for note in line["notes"])


def _sizes(line: Mapping[str, Any]) -> str:
    """Return the group of a bench by the size of its collimator's errors."""
    if line["profile"] == "ideal":
        return "none"
    return "below 0.4" if line["scale"] < 0.4 else "0.4 to 0.7" if line["scale"] < 0.7 else "above 0.7"


GROUPS: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
    "profile": lambda line: line["profile"],
    "size of its errors": _sizes,
    "known": lambda line: line["known"],
    "readings": lambda line: line["readings"],
    "poses": lambda line: line["poses"],
    "repeats": lambda line: line["times"] > 1,
    "bow": lambda line: line["bow_um"] != 0,
    "lens": lambda line: line["lens"],
    "f": lambda line: "below 2700" if line["f"] < 2700 else "2700 to 3700" if line["f"] < 3700 else "above",
    "model chosen": lambda line: line["model"],
}


def report(lines: Sequence[Mapping[str, Any]]) -> None:
    """Print coverage over all benches and by group, and every bench beyond twice its expanded uncertainty."""
    solved = [line for line in lines if "refused" not in line]
    refused = [line for line in lines if "refused" in line]
    print(f"{len(lines)} benches, {len(refused)} refused; CPU {sum(x['seconds'] for x in lines):.0f} s")
    head = f"{'group':34s} {'n':>4s} {'fx':>6s} {'corner':>7s} {'rms':>5s} {'> 1.5 U':>8s} {'> 3 U':>6s} {'unnamed':>8s}"
    print(f"{head} U med")
    _row("all, but lenses with p1 and p2", [line for line in solved if line["lens"] == "k1k2"])
    for name, of in GROUPS.items():
        for value in sorted({of(line) for line in solved}, key=str):
            own = [x for x in solved if of(x) == value and (x["lens"] == "k1k2" or name == "lens")]
            _row(f"{name} {value}", own)
    bent = [line for line in solved if line["lens"] == "p1p2"]
    print(f"a note names the lens: {sum(named(line) for line in bent)} of {len(bent)} lenses with p1 and p2")
    for line in refused:
        print(f"refused {line['index']}: {line['refused'][:150]}")
    for line in sorted(solved, key=lambda x: -max(over(x, "fx"), over(x, "corner"))):
        if max(over(line, "fx"), over(line, "corner")) <= 1.0:
            break
        print(_case(line))


def _row(name: str, lines: Sequence[Mapping[str, Any]]) -> None:
    """Print the coverage of a group."""
    if not lines:
        return
    worst = [max(over(line, "fx"), over(line, "corner")) for line in lines]
    far = [line for line, size in zip(lines, worst, strict=True) if size > 3.0]
    shares = [np.mean([over(line, what) <= 1.0 for line in lines]) for what in ("fx", "corner")]
    middle = np.median([line["k"] * line["fx_sigma"] for line in lines])
    rms = 2.0 * float(np.sqrt(np.mean([over(line, "fx") ** 2 for line in lines])))
    print(
        f"{name:34s} {len(lines):4d} {shares[0]:6.1%} {shares[1]:7.1%} {rms:5.2f} {np.mean(np.array(worst) > 1.5):8.1%} "
        f"{len(far):6d} {sum(not named(line) for line in far):8d} {middle:6.2f}"
    )


def _case(line: Mapping[str, Any]) -> str:
    """Return one bench as text."""
    return (
        f"{line['index']:4d} fx {over(line, 'fx'):5.2f} U corner {over(line, 'corner'):5.2f} U | error "
        f"{line['fx_error']:+.2f} px U {line['k'] * line['fx_sigma']:.2f} k {line['k']:.2f} birge {line['birge']:.2f} "
        f"{line['model']} | {line['profile']} x {line['scale']} bow {line['bow_um']} poses {line['poses']} x "
        f"{line['times']} {line['known']} {line['readings']} {line['lens']} f {line['f']:.0f} | "
        f"{'named' if named(line) else 'NOT named'}"
    )


def main() -> None:
    """Calibrate the benches that the file does not have yet, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--benches", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--part", default="1/1", help="K/N: every Nth bench, from the Kth")
    parser.add_argument("--only", type=int, metavar="INDEX")
    given = parser.parse_args()
    if given.only is not None:
        explain(given.seed, given.only)
        return
    done: dict[int, dict[str, Any]] = {}
    if given.output and given.output.exists():
        for text in given.output.read_text().splitlines():
            line = json.loads(text)
            if line["seed"] == given.seed:
                done[line["index"]] = line
    part, parts = (int(number) for number in given.part.split("/"))
    for index in range(part - 1, given.benches, parts):
        if index in done:
            continue
        done[index] = measure(given.seed, index)
        if given.output:
            with given.output.open("a") as file:
                file.write(json.dumps(done[index], ensure_ascii=False) + "\n")
    report([done[index] for index in sorted(done) if index < given.benches])


if __name__ == "__main__":
    sys.exit(main())
