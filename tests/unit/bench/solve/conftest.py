"""Point files of a calibration from files alone."""

import pytest
from expected_stars import THREE, expected_views, write_points


@pytest.fixture(scope="session")
def points(tmp_path_factory):
    """Point files of three views of the bench that the simulated station expects, with every third star."""
    return write_points(
        tmp_path_factory.mktemp("points"), expected_views(THREE, sigma_px=0.01, seed=5), every=3
    )
