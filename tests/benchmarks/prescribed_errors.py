"""How large the errors of published collimators are, in the engine's terms: what the medians of its priors rest on.

Each design of `worlds.stranger_glass` is made several times with the tolerances of a workshop. From its rays follow, in
shares of the focal length: distortion (|h|^2 h and |h|^4 h), what makes distortion about a shifted axis (|h|^2 e of a
pupil on the axis), field curvature (|h|^2 s for a pupil aside by s), astigmatism over it ((h s) h), and coma (|s|^2 h).

    python tests/benchmarks/prescribed_errors.py [--seeds 4] [--write]
"""

import measured
import numpy as np
from numpy.typing import NDArray
from worlds.stranger_glass import DESIGNS, Collimator, Tolerances, collimator

Array = NDArray[np.float64]

FOCAL_MM = 250.0
#: How far a pupil is moved aside to see what changes, as a share of the focal length.
ASIDE = 0.02
TERMS = ("radial", "radial_4", "shifted", "curvature", "astigmatism", "coma")
_GRID = np.linspace(-1.0, 1.0, 21)
_SQUARE = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2)
_DISC = _SQUARE[(_SQUARE**2).sum(axis=1) <= 1.0]


def errors_of(glass: Collimator, widest: float) -> dict[str, float]:
    """Sizes of the errors of a collimator, dimensionless, over the tangents that its beam has."""
    h = widest * _DISC
    square = (h * h).sum(axis=1, keepdims=True)

    def seen(aside: tuple[float, float]) -> Array:
        places = np.broadcast_to(np.array(aside) * FOCAL_MM, h.shape)
        return np.asarray(glass.print_mm(places, h) / glass.efl_mm)

    middle = seen((0.0, 0.0))
    ones = np.ones_like(square)
    # a shift and a scale, distortion, and what is about a shifted axis along X and Y
    columns = [h, square * h, square**2 * h]
    for e in np.eye(2):
        columns += [ones * e, square * e, (h @ e)[:, None] * h, square**2 * e, square * (h @ e)[:, None] * h]
    sizes = _fitted(columns, middle)
    answer = {"radial": sizes[1], "radial_4": sizes[2], "shifted": float(np.hypot(sizes[4], sizes[9]))}
    curvature, astigmatism, coma = [], [], []
    for e in np.eye(2):
        more, less = seen(tuple(ASIDE * e)), seen(tuple(-ASIDE * e))
        along = (h @ e)[:, None]
        part = _fitted(
            [ones * e, square * e, along * h, square**2 * e, square * along * h], (more - less) / (2 * ASIDE)
        )
        curvature.append(part[1])
        astigmatism.append(part[2])
        both = _fitted([h, along * e, square * h, ones * e], (more + less - 2 * middle) / (2 * ASIDE**2))
        coma.append(both[0])
    return answer | {
        "curvature": float(np.mean(curvature)),
        "astigmatism": float(np.mean(astigmatism)),
        "coma": float(np.mean(coma)),
    }


def _fitted(columns: list[Array], values: Array) -> list[float]:
    rows = np.stack([column.ravel() for column in columns], axis=1)
    return [float(v) for v in np.linalg.lstsq(rows, values.ravel(), rcond=None)[0]]


def table(seeds: int) -> None:
    """Print the sizes of each design, and their medians and scatter over all designs."""
    sizes: dict[str, list[float]] = {term: [] for term in TERMS}
    print(f"{'design':18}" + "".join(f"{term:>13}" for term in TERMS))
    for name, (_, _, widest) in DESIGNS.items():
        drawn = []
        for seed in range(seeds):
            rng = np.random.default_rng((seed, 91))
            glass = collimator(name, FOCAL_MM, rng, Tolerances(), (0.0, np.zeros(2)))
            drawn.append(errors_of(glass, widest))
        rms = {term: float(np.sqrt(np.mean([sizes_of[term] ** 2 for sizes_of in drawn]))) for term in TERMS}
        print(f"{name:18}" + "".join(f"{rms[term]:13.3g}" for term in TERMS))
        for term in TERMS:
            sizes[term].append(rms[term])
    logs = {term: np.log(values) for term, values in sizes.items()}
    print(f"{'median':18}" + "".join(f"{np.exp(np.median(logs[term])):13.3g}" for term in TERMS))
    print(f"{'scatter of log':18}" + "".join(f"{np.std(logs[term]):13.3g}" for term in TERMS))


def main() -> None:
    """Print the table."""
    options = measured.options(__doc__)
    options.add_argument("--seeds", type=int, default=4, help="how often each design is made")
    table(options.parse_args().seeds)


if __name__ == "__main__":
    measured.run(main, "engine", "Errors of published collimators")
