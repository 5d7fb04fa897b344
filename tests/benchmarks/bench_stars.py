"""How accurately and how fast stars are found in simulated recordings of 33 ms, compared with the simulated truth.

The table has a row for each waveform of the light, level of noise and kind of image: the automatically chosen one, and
the last polarity of the published method. The columns are, over some random poses (roll 0 to 360 degrees): the rms error
of the centres per axis; the z-score of the centres by their covariances; complete stars that were missed; stars that are
wrong by more than half a pixel; CPU seconds of one core for detection (median view, and 95th percentile).

    python tests/benchmarks/bench_stars.py [--poses 10] [--r 280] [--half-angle 16] [--pictures FOLDER]
    python tests/benchmarks/bench_stars.py --old CHECKOUT [--poses 2] [--recordings FILE ...]

With a collimator of 280 mm, stars are 48 px apart, and 318 or more of them are complete in each view if the disc is wide
enough. ``--pictures`` draws, for the first pose of each row, the event image with its stars and, next to it, their
errors, enlarged 500 times (red: more than 0.04 px).

``--old`` compares with an older checkout instead: CPU seconds from the events in memory to stars with names and
covariances, as `calibrate` finds them, and how far the results differ. Each view is timed in a process for each
checkout in turn, so that both meet the same load; the best of some repetitions counts. ``--recordings`` adds RAW files.
"""

from __future__ import annotations

import argparse
import inspect
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import measured
import numpy as np
from short_recordings import WINDOW_US, images_of, record
from star_scores import star_scores, whole_stars

from calib.errors import CalibrationError
from calib.events.event_image import EventImages
from calib.events.grey_image import to_uint8
from calib.stars.detect import detect_view
from calib.view import View
from simulators.optics.picture import TARGET, pose_rotation
from simulators.world.truth import NOISE_LEVELS, CollimatorTruth, Truth

REPETITIONS = 4
IMAGES = ("best", "last-polarity")
SCALE, FAR_PX = 500, 0.04
"""Enlargement of drawn errors, and error from which they are red, px."""


def measure(
    truth: Truth, images: EventImages, kind: str, rotation: Any
) -> tuple[View, Any, dict[str, float]]:
    """Return view, errors and figures of one pose for one kind of image."""
    image = images.best().image if kind == "best" else images.named(kind)
    begin = time.process_time()
    view = detect_view(image, TARGET)
    cpu_s = time.process_time() - begin
    errors, scores = star_scores(view, truth, rotation, whole_stars(truth, rotation))
    return view, errors, scores | {"cpu_s": cpu_s}


def draw(path: Path, image: Any, view: View, errors: Any) -> None:
    """Draw the event image with the stars found and, next to it, their enlarged errors with a scale."""
    seen = cv2.cvtColor(to_uint8(image), cv2.COLOR_GRAY2BGR)
    shown = np.full_like(seen, 255)
    for (x, y), error in zip(view.points_px, errors, strict=True):
        at = (round(x * 16), round(y * 16))
        cv2.circle(seen, at, 6 * 16, (0, 160, 0), 2, cv2.LINE_AA, 4)
        to = (at[0] + round(error[0] * SCALE * 16), at[1] + round(error[1] * SCALE * 16))
        far = float(np.linalg.norm(error)) > FAR_PX
        cv2.circle(shown, at, 2 * 16, (150, 150, 150), -1, cv2.LINE_AA, 4)
        cv2.line(shown, at, to, (0, 0, 220) if far else (90, 90, 90), 2, cv2.LINE_AA, 4)
    height, length = shown.shape[0], round(FAR_PX * SCALE)
    cv2.rectangle(shown, (10, height - 36), (length + 150, height - 8), (255, 255, 255), -1)
    cv2.line(shown, (20, height - 20), (20 + length, height - 20), (0, 0, 0), 3)
    cv2.putText(
        shown, f"{FAR_PX:.2f} px", (30 + length, height - 14), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 1
    )
    cv2.imwrite(str(path), np.hstack([seen, shown]))


def solve(recording: Path, target: Path) -> None:
    """Find the stars of a recording some times; write the CPU seconds and the view. Runs in a process of its own."""
    from bench.measure.measure import EventData, find_stars, read_events, whole_image
    from calib.stars.rim import downweight_vignetted
    from drivers.camera.event_arrays import Events, Triggers

    def known(function: Any, **wanted: Any) -> dict[str, Any]:
        """Return the options that this checkout has."""
        return {
            name: value for name, value in wanted.items() if name in inspect.signature(function).parameters
        }

    cv2.setNumThreads(1)
    hz = None
    if recording.suffix == ".npz":
        with np.load(recording) as kept:
            events = Events(*(kept[name] for name in "txyp"))
            edges = kept["edges"]
            triggers = Triggers(
                edges, (np.arange(len(edges)) % 2 == 0).astype(np.uint8), np.zeros(len(edges), np.uint8)
            )
            data, hz = EventData(events, triggers, tuple(kept["size"].tolist()), 0), float(kept["hz"])
    else:
        data = read_events(recording)
    seconds = []
    for _ in range(REPETITIONS):
        begin = time.process_time()
        facts: dict[str, Any] = {}
        whole = whole_image(data, "auto", None, hz, facts, **known(whole_image, compare_flicker=False))
        middle = time.process_time()
        view = find_stars(whole.image, TARGET, "view", None, facts, **known(find_stars, edge_width=False))
        view = downweight_vignetted(view, TARGET)
        seconds.append((middle - begin, time.process_time() - middle))
    np.savez(
        target,
        seconds=min(seconds, key=sum),
        ids=view.ids,
        points=view.points_px,
        covariances=view.covariances_px2,
    )


def compare(old: Path, recordings: list[tuple[str, Path]], folder: Path) -> list[tuple[float, float]]:
    """Print a row for each recording; return the CPU seconds of both checkouts, the old one first."""
    rows = []
    for name, recording in recordings:
        solved = []
        for side, checkout in enumerate((old, measured.ROOT)):
            measured.in_checkout(checkout, "--solve", str(recording), str(folder / f"{side}.npz"))
            with np.load(folder / f"{side}.npz") as kept:
                solved.append(dict(kept))
        (before, after), ids = solved, np.intersect1d(solved[0]["ids"], solved[1]["ids"])
        a, b = (np.searchsorted(side["ids"], ids) for side in solved)
        apart_px = np.linalg.norm(before["points"][a] - after["points"][b], axis=1).max()
        traces = [
            np.trace(side["covariances"][at], axis1=1, axis2=2)
            for side, at in zip(solved, (a, b), strict=True)
        ]
        times = [side["seconds"] for side in solved]
        rows.append((times[0].sum(), times[1].sum()))
        print(
            f"{name:24s} {len(ids):5d} {len(before['ids']) + len(after['ids']) - 2 * len(ids):6d} {apart_px:9.1e} "
            f"{abs(traces[1] / traces[0] - 1.0).max():9.1e}   {times[0][0]:.3f} + {times[0][1]:.3f}   "
            f"{times[1][0]:.3f} + {times[1][1]:.3f}   {rows[-1][0] / rows[-1][1]:4.2f}",
            flush=True,
        )
    return rows


def compare_checkouts(old: Path, truth: Truth, poses: list[Any], given: list[Path]) -> None:
    """Print the table of ``--old``."""
    print(
        "recording                stars  names     px off  cov. off   old image+stars   new image+stars   ratio"
    )
    with TemporaryDirectory() as folder:
        rows = compare(old, [(path.stem[:24], path) for path in given], Path(folder))
        for number, (waveform, noise) in enumerate((w, n) for w in ("square", "sine") for n in NOISE_LEVELS):
            for pose, rotation in enumerate(poses):
                seed = 1 + number * len(poses) + pose
                events, flicker = record(truth, rotation, waveform, seed, NOISE_LEVELS[noise])
                edges = np.arange(flicker.phase_us, WINDOW_US, flicker.period_us / 2.0).astype(np.int64)
                size = (truth.camera.width, truth.camera.height)
                np.savez(
                    Path(folder) / "r.npz",
                    **events._asdict(),
                    edges=edges,
                    size=size,
                    hz=flicker.frequency_hz,
                )
                rows += compare(old, [(f"{waveform} {noise} {pose}", Path(folder) / "r.npz")], Path(folder))
    before, after = np.mean(rows, axis=0)
    print(f"mean of {len(rows)}: old {before:.3f} s, new {after:.3f} s, ratio {before / after:.2f}")


def main() -> None:
    """Print the table."""
    parser = measured.options(__doc__)
    parser.add_argument("--poses", type=int, help="default: 10, with --old 2")
    parser.add_argument("--r", type=float, default=280.0, help="mm, as r of the collimator")
    parser.add_argument("--half-angle", type=float, default=16.0, help="degrees, of the disc")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--old", type=Path, help="an older checkout to compare with")
    parser.add_argument("--recordings", type=Path, nargs="*", default=[], help="RAW files, with --old")
    parser.add_argument("--solve", type=Path, nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.solve:
        solve(*options.solve)
        return
    truth = Truth(collimator=CollimatorTruth(r=options.r, half_angle_deg=options.half_angle))
    rng = np.random.default_rng(2)
    poses = [
        pose_rotation(
            {"pan": rng.uniform(-6, 6), "tilt": rng.uniform(-3, 3), "roll": rng.uniform(0, 360)}, truth.optics
        )
        for _ in range(options.poses or (2 if options.old else 10))
    ]
    if options.old:
        given = [path.resolve() for path in options.recordings]
        compare_checkouts(options.old.resolve(), truth, poses, given)
        return
    wholly = [len(whole_stars(truth, rotation)) for rotation in poses]
    print(f"stars wholly in view: {min(wholly)} to {max(wholly)}")
    print("drive   noise    image           rms px    z  missed/whole  wrong  stars  detection CPU s, 95 %")
    for waveform in ("square", "sine"):
        for noise in ("clean", "typical", "heavy"):
            figures: dict[str, list[dict[str, float]]] = {kind: [] for kind in IMAGES}
            for number, rotation in enumerate(poses):
                images = images_of(truth, *record(truth, rotation, waveform, number + 1, NOISE_LEVELS[noise]))
                for kind in IMAGES:
                    try:
                        view, errors, sums = measure(truth, images, kind, rotation)
                    except CalibrationError as error:
                        print(f"        pose {number}: {kind}: {error}")
                        continue
                    figures[kind].append(sums)
                    if options.pictures and number == 0:
                        options.pictures.mkdir(parents=True, exist_ok=True)
                        image = images.best().image if kind == "best" else images.named(kind)
                        draw(options.pictures / f"{waveform}-{noise}-{kind}.png", image, view, errors)
            for kind, of_poses in figures.items():
                total = {key: sum(sums[key] for sums in of_poses) for key in of_poses[0]}
                rms = (total["square"] / total["stars"] / 2.0) ** 0.5
                z = (total["z_square"] / total["stars"]) ** 0.5
                took = measured.spread(sums["cpu_s"] for sums in of_poses)
                print(
                    f"{waveform:7s} {noise:8s} {kind:14s} {rms:7.4f} {z:5.2f} {total['missed']:6.0f}/"
                    f"{total['whole']:<6.0f} {total['wrong']:5.0f} {total['stars']:6.0f} {took.median_s:8.2f} {took.p95_s:6.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    measured.run(main, "stars", "Accuracy of star centres")
