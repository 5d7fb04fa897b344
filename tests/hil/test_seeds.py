"""Twenty simulated benches, each with its own camera, mounting and noise: do the stated uncertainties hold? Slow."""

import json
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from running import starbench

SEEDS = int(os.environ.get("STARBENCH_SEEDS", "20"))


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_every_parameter_lies_within_its_stated_uncertainty_of_the_truth(tmp_path):
    def errors(seed: int) -> list[float]:
        words = (
            "run",
            "three_pose",
            "-s",
            "simulated_ideal",
            "--seed",
            seed,
            "-o",
            tmp_path / str(seed),
            "--json",
        )
        run = starbench(*words, home=tmp_path / "home")
        assert run.returncode == 0, run.stderr
        return [row["error_sigmas"] for row in json.loads(run.stdout)["results"]["comparison"]]

    with ThreadPoolExecutor(2) as pool:
        z = np.array(list(pool.map(errors, range(1, SEEDS + 1))))
    print("\nrms of the errors in sigmas, by parameter:", np.round(np.sqrt((z**2).mean(axis=0)), 2))
    print("within 2 sigmas:", (abs(z) < 2).mean(), " largest:", abs(z).max())
    assert abs(z).max() < 4
    # Nine parameters of a run move together and tell as much as five: of 95.45 % in truth, twenty runs show 91 to 100.
    assert (abs(z) < 2).mean() >= 0.91
    rms = np.sqrt((z**2).mean(axis=0))
    assert rms.max() < 1.4, "sigmas too small"
    assert rms.min() > 0.6, "sigmas twice too large would hold, but say nothing"
