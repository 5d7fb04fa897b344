"""Kept views: found once, equal to the last bit, never trusted when broken, bounded, private, safe with two processes."""

import os
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import Mock

import grimp
import numpy as np
import pytest
from made_views import made_rim, made_view
from refusals import full

from bench.measure import kept_views
from bench.measure.kept_views import DETECTOR_SOURCES, KeptViews, pack_view, view_key

OPTIONS = {"kind": "recording", "name": "left", "image": "auto"}


def same(first, other):
    """Whether two views are equal to the last bit."""

    def parts(view):
        fields = {**vars(view), **(vars(view.rim) if view.rim else {})}
        arrays = {n: (a.dtype, a.shape, a.tobytes()) for n, a in fields.items() if isinstance(a, np.ndarray)}
        return arrays, view.name, view.image_size, fields.get("level_sigma_mm")

    return parts(first) == parts(other)


@pytest.fixture
def kept(tmp_path):
    return KeptViews(tmp_path / "home" / "kept-views")


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "left.raw"
    path.write_bytes(b"events")
    return path


@pytest.mark.parametrize("rim", [made_rim(), None], ids=["rim", "no rim"])
def test_stars_are_found_once_and_are_equal_to_the_last_bit(kept, recording, rim):
    find = Mock(return_value=made_view(rim=rim))
    assert same(kept.view(recording, OPTIONS, find), find.return_value)
    again = KeptViews(kept.folder)
    assert same(again.view(recording, OPTIONS, find), find.return_value)
    assert (find.call_count, kept.found, again.used, again.remarks) == (1, 1, 1, [])


def test_other_bytes_other_options_and_another_detector_are_found_again(kept, recording, monkeypatch):
    find = Mock(return_value=made_view(rim=made_rim()))
    kept.view(recording, OPTIONS, find)
    kept.view(recording, {**OPTIONS, "image": "accumulated"}, find)
    assert find.call_count == 2
    recording.write_bytes(b"Events")
    kept.view(recording, OPTIONS, find)
    assert find.call_count == 3
    monkeypatch.setattr(kept_views, "detector_version", lambda: "another")
    kept.view(recording, OPTIONS, find)
    assert find.call_count == 4


@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "of another", "larger than any"])
def test_a_broken_entry_is_found_again_and_told(kept, recording, damage):
    find = Mock(return_value=made_view(rim=made_rim()))
    kept.view(recording, OPTIONS, find)
    (entry,) = kept.folder.glob("*/*.view")
    data = bytearray(entry.read_bytes())
    data[len(data) // 2] ^= 1
    broken = {"flip": bytes(data), "cut": bytes(data[:-10]), "empty": b""}
    broken["of another"] = pack_view(made_view(seed=2), "0" * 64)
    entry.write_bytes(broken.get(damage, b""))
    if damage == "larger than any":
        os.truncate(entry, 10 << 30)
    assert same(kept.view(recording, OPTIONS, find), find.return_value)
    assert find.call_count == 2
    assert len(kept.remarks) == 1
    assert "are found again" in kept.remarks[0]
    assert str(entry) in kept.remarks[0]
    kept.view(recording, OPTIONS, find)
    assert find.call_count == 2, "the broken entry was replaced"


def test_a_recording_that_is_replaced_meanwhile_is_not_kept(kept, recording):
    def find():
        recording.write_bytes(b"other events")
        return made_view(rim=made_rim())

    kept.view(recording, OPTIONS, find)
    assert not list(kept.folder.glob("*/*.view"))


def test_the_size_is_bounded_and_what_was_used_last_stays(tmp_path):
    size = len(pack_view(made_view(rim=made_rim()), "0" * 64))
    kept = KeptViews(tmp_path / "views", most_bytes=256 * (3 * size + 10))
    keys = [f"ab{number:062x}" for number in range(5)]
    for age, key in enumerate(keys[:3]):
        kept.write(key, made_view(rim=made_rim()))
        os.utime(kept.folder / "ab" / f"{key}.view", (1000 + age, 1000 + age))
    assert kept.read(keys[0]) is not None
    stale = kept.folder / "ab" / ".left.tmp"
    stale.write_bytes(b"")
    os.utime(stale, (1000, 1000))
    kept.write(keys[3], made_view(rim=made_rim()))
    assert [kept.read(key) is not None for key in keys] == [True, False, True, True, False]
    assert not stale.exists()
    kept.write(keys[4], made_view(stars=500))
    assert kept.read(keys[4]) is None, "an entry above its share is not kept"


def test_the_folder_is_private_and_one_that_is_not_is_refused(kept, recording):
    find = Mock(return_value=made_view(rim=made_rim()))
    kept.view(recording, OPTIONS, find)
    (entry,) = kept.folder.glob("*/*.view")
    modes = [path.stat().st_mode & 0o777 for path in (kept.folder, entry.parent, entry)]
    assert modes == [0o700, 0o700, 0o600]
    kept.folder.chmod(0o770)
    open_to_others = KeptViews(kept.folder)
    open_to_others.view(recording, OPTIONS, find)
    assert find.call_count == 2
    assert "chmod 700" in open_to_others.remarks[0]


def test_a_folder_that_cannot_be_made_is_told_once(tmp_path, recording):
    (tmp_path / "file").write_text("")
    kept = KeptViews(tmp_path / "file" / "views")
    find = Mock(return_value=made_view(rim=made_rim()))
    for _ in range(3):
        kept.view(recording, OPTIONS, find)
    assert find.call_count == 3
    assert len(kept.remarks) == 1


def test_a_full_disk_is_told_once_and_leaves_no_part(kept, recording, monkeypatch):
    monkeypatch.setattr("pathlib.Path.replace", full)
    find = Mock(return_value=made_view(rim=made_rim()))
    for _ in range(2):
        assert same(kept.view(recording, OPTIONS, find), find.return_value)
    assert [remark.count("No space left") for remark in kept.remarks] == [1]
    assert not [path for path in kept.folder.rglob("*") if path.is_file()]


def test_several_writers_of_one_entry_leave_it_whole(kept):
    key = view_key("0" * 64, OPTIONS)
    view, torn = made_view(stars=2000), []

    def work():
        own = KeptViews(kept.folder, most_bytes=1 << 34)
        for _ in range(20):
            own.write(key, view)
            if (read := own.read(key)) is None or not same(read, view):
                torn.append(own.remarks)

    with ThreadPoolExecutor(4) as pool:
        for _ in range(4):
            pool.submit(work)
    assert torn == []
    assert [path.name for path in (kept.folder / key[:2]).iterdir()] == [f"{key}.view"]


def test_a_recording_with_holes_is_not_hashed(kept, recording, monkeypatch):
    with recording.open("r+b") as file:
        file.truncate(10 << 30)
    monkeypatch.setattr("bench.measure.kept_views.sha256_of", lambda _: pytest.fail("it was hashed"))

    def find():
        raise ValueError("holes")

    with pytest.raises(ValueError, match="holes"):
        kept.view(recording, OPTIONS, find)


def test_the_version_of_the_detector_covers_all_that_finds_stars():
    """Every module of ours that a detector imports is part of the hash, or has no influence on a view."""
    without_influence = {
        "bench.base.errors",
        "bench.base.bounded_json",
        "bench.record.",
        "drivers.durable",
        "drivers.file_lock",
        "drivers.lateness",
        "drivers.new_output",
        "sequences.",
    }
    graph = grimp.build_graph(
        "bench", "calib", "drivers", "sequences", "simulators", exclude_type_checking_imports=True
    )
    hashed = tuple(name.removesuffix(".py").replace("/", ".") for name in DETECTOR_SOURCES)
    for detector in ("bench.measure.measure", "calib.boards.detect", "drivers.camera.formats"):
        for module in graph.find_upstream_modules(detector):
            assert module.startswith((*hashed, *without_influence)), f"{detector} imports {module}"
