"""Calibrate the published recordings of a real collimator: all views, and random triples of them.

    python tests/benchmarks/bench_recordings.py FOLDER [--triples 100]

FOLDER is ``collimator_real`` (tests/data/README.md says where it comes from). Nothing is known besides the views. Printed:
fx, rms and left-out rms of all 20 views; over the triples: scatter of each number (robust: half of the middle 68 %, with
its standard error: triples share views, so each view is left out in turn), stated uncertainty over it, and how many
triples are within U of the value by all views.
"""

from pathlib import Path

import measured
import numpy as np
from worlds.recordings import COUNT, read, robust, solved, triples


def standard_error(values: np.ndarray, chosen: np.ndarray) -> float:
    """Standard error of the robust scatter, by the jackknife: all triples with one view are left out, view by view."""
    without = np.array([robust(values[(chosen != view).all(axis=1)]) for view in range(COUNT)])
    return float(np.sqrt((COUNT - 1) / COUNT * ((without - without.mean()) ** 2).sum()))


def main() -> None:
    parser = measured.options(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--triples", type=int, default=100)
    given = parser.parse_args()
    views = read(given.folder)
    whole = solved(views, tuple(range(COUNT)))
    print(
        f"20 views: {whole['model']}, fx {whole['fx']:.2f} +- {whole['k'] * whole['u_fx']:.2f} px, "
        f"rms {whole['rms_px']:.4f} px, left out {whole['left_out_px'] or float('nan'):.4f} px"
    )
    drawn = triples(given.triples)
    lines = [solved(views, chosen) for chosen in drawn]
    kept = [line for line in lines if "refused" not in line]
    chosen = np.array([triple for triple, line in zip(drawn, lines, strict=True) if "refused" not in line])
    print(f"{len(lines)} triples, {len(lines) - len(kept)} refused")
    for name in ("fx", "fy", "cx", "cy"):
        values, u, k = (np.array([line[key] for line in kept]) for key in (name, f"u_{name}", "k"))
        over = np.abs(values - whole[name]) / (k * u)
        print(
            f"{name}: sd {values.std():.2f}, robust {robust(values):.2f} +- {standard_error(values, chosen):.2f} px; u median {np.median(u):.2f}, rms "
            f"{np.sqrt(np.mean(u**2)):.2f}, U median {np.median(k * u):.2f}; rms u over sd "
            f"{np.sqrt(np.mean(u**2)) / values.std():.2f}, median U/2 over robust "
            f"{np.median(k * u) / 2 / robust(values):.2f}; within U {np.mean(over <= 1):.0%}, largest {over.max():.2f} U"
        )


if __name__ == "__main__":
    main()
