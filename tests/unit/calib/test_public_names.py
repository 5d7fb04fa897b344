"""What `calib` offers to a notebook."""

import calib


def test_dir_shows_the_public_names_and_nothing_else():
    assert set(dir(calib)) == set(calib.__all__)
    assert all(getattr(calib, name) for name in dir(calib))
