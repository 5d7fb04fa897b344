"""`views.h5`: what is written is read again, and a damaged file is refused in one message."""

import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_views import made_rim, made_view

from bench.base.errors import RunFolderError, StorageError
from bench.measure.views_file import StoredView, read_picture, read_views, views_file

DOCUMENT = Path(__file__).parents[4] / "docs" / "run-folder.md"
RNG, SIZE = np.random.default_rng(5), (64, 48)
RIMS = (None, made_rim(3, 2), made_rim(0, 2), made_rim(0, 0))


def stored_of(view):
    width, height = view.image_size
    picture = RNG.integers(0, 256, (height, width), np.uint8)
    return StoredView(view, RNG.normal(size=(len(view), 2)), lambda: picture)


@settings(max_examples=25)
@given(
    st.lists(st.tuples(st.integers(4, 20), st.sampled_from(RIMS)), max_size=12),
    st.text(min_size=1).filter(lambda text: "\0" not in text),
)
def test_views_rims_residuals_and_images_are_read_back_bit_for_bit(tmp_path_factory, drawn, name):
    name = name.encode("utf-8", "replace").decode()
    views = [
        replace(
            made_view(f"{name} {number}", count, size=SIZE, seed=number, rim=rim), recorded_s=number or None
        )
        for number, (count, rim) in enumerate(drawn)
    ]
    written = [stored_of(view) for view in views]
    path = tmp_path_factory.mktemp("views") / "views.h5"
    path.write_bytes(views_file(written))

    stored = read_views(path)
    assert [s.view.name for s in stored] == [v.name for v in views]
    for number, (kept, view, had) in enumerate(zip(stored, views, written, strict=True), 1):
        assert (kept.view.image_size, kept.view.recorded_s) == (view.image_size, view.recorded_s)
        pairs = [(kept.view, view, ("ids", "points_px", "target_mm", "covariances_px2"))]
        if view.rim:
            assert kept.view.rim.level_sigma_mm == view.rim.level_sigma_mm
            pairs.append((kept.view.rim, view.rim, ("points_mm", "sigmas_mm", "lit_mm")))
        for got, given_, fields in pairs:
            for field in fields:
                was, due = getattr(got, field), getattr(given_, field)
                assert (was.dtype, was.shape, was.tobytes()) == (due.dtype, due.shape, due.tobytes())
        assert (kept.view.rim is None) == (view.rim is None)
        assert np.array_equal(kept.residuals_px, had.residuals_px)
        assert np.array_equal(read_picture(path, number), had.picture())
        assert np.array_equal(kept.picture(), had.picture())


@pytest.mark.slow
def test_a_thousand_poses_keep_their_order(tmp_path):
    views = [made_view(str(number), 4, size=(2, 2)) for number in range(1, 1002)]
    path = tmp_path / "views.h5"
    path.write_bytes(views_file([stored_of(view) for view in views]))
    assert [stored.view.name for stored in read_views(path)] == [view.name for view in views]


@pytest.fixture
def path(tmp_path):
    view = made_view("one", 5, size=SIZE, rim=made_rim(3, 2))
    path = tmp_path / "views.h5"
    path.write_bytes(views_file([stored_of(view)]))
    return path


def documented_layout():
    """Shapes and types by name, as the table of docs/run-folder.md has them."""
    section = DOCUMENT.read_text(encoding="utf-8").partition("## views.h5")[2].partition("\n## ")[0]
    assert "`starbench/views/1`" in section
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| \(([^)]*)\) (\w+) \|", section, re.MULTILINE)
    sizes = {"N": 5, "H": 48, "W": 64, "K": 3, "L": 2}
    return {
        name: (tuple(sizes.get(n) or int(n) for n in re.findall(r"\w+", shape)), dtype)
        for name, kind, shape, dtype in rows
        if kind.startswith("dataset")
    }


def test_the_file_has_the_documented_layout(path):
    with h5py.File(path) as file:
        assert dict(file.attrs) == {"format": "starbench/views/1"}
        (group,) = file.values()
        assert group.name == "/pose-001"
        assert set(group.attrs) == {"name", "image_size", "rim_level_sigma_mm"}
        assert group.attrs["image_size"].dtype == np.int64
        assert {name: (data.shape, str(data.dtype)) for name, data in group.items()} == documented_layout()


def with_fewer_residuals(file):
    del file["pose-001/residuals_px"]
    file["pose-001/residuals_px"] = np.zeros((4, 2))


DAMAGES = {
    "another format": lambda file: file.attrs.update(format="starbench/views/2"),
    "no points": lambda file: file.pop("pose-001/points_px"),
    "fewer residuals": with_fewer_residuals,
    "no size": lambda file: file["pose-001"].attrs.pop("image_size"),
    "a star twice": lambda file: file["pose-001/ids"].write_direct(np.zeros(5, np.int64)),
    "another number": lambda file: file.move("pose-001", "pose-007"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_changed_file_is_refused_with_its_path_and_a_remedy(path, damage):
    with h5py.File(path, "r+") as file:
        DAMAGES[damage](file)
    with pytest.raises(RunFolderError) as refused:
        read_views(path)
    assert refused.value.where == str(path)
    assert "Copy the folder" in refused.value.remedy


@pytest.mark.parametrize("content", [b"", b"no HDF5", None])
def test_a_file_that_is_not_hdf5_or_not_there_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "views.h5").write_bytes(content)
    error = StorageError if content is None else RunFolderError
    with pytest.raises(error, match=r"views\.h5: .* cannot be"):
        read_views(tmp_path / "views.h5")


def test_a_pose_that_the_file_does_not_have_is_refused(path):
    with pytest.raises(RunFolderError, match="pose-002 is missing"):
        read_picture(path, 2)
