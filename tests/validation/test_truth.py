"""How right the numbers are: drawn benches of each world against their truth."""

import numpy as np
import pytest

from tests.benchmarks.worlds.catalogue import result
from tests.benchmarks.worlds.scores import ratios

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("world", ["ideal", "polynomial", "raytraced", "product"])
@pytest.mark.parametrize("known", ["cr", "0"])
def test_drawn_benches_of_each_world_are_within_their_uncertainty(world, known):
    lines = [result(world, 9, seed, known) for seed in range(3)]
    over = np.array([ratios(lines, what) for what in ("fx", "fy", "cx", "cy", "corner")])
    assert over.max() <= 1.6
    assert np.mean(over <= 1.0) >= 0.8
