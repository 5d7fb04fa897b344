"""`rig --sync`: the offset of two cameras' clocks from the trigger edges in their recordings."""

import json

import cv2
import numpy as np
import pytest
from drawn_rig import BOARD, Drawn

from bench.commands.cli import main

SIZE = (400, 300)
PERIOD_US, PERIODS = 4000, 6
OFFSET_US, GAIN = 1700.0, 60e-6
WORDS = ("--board", "checkerboard:11x7:20mm")


def flickering(view, clock, edges_us, path):
    """Write a recording of a board under a lamp that flickers: white paper sends events, and the sync signal edges."""
    whole = (
        np.kron((np.add.outer(range(8), range(12)) + 1) % 2, np.ones((40, 40), np.uint8)).astype(np.uint8)
        * 255
    )
    sheet = cv2.copyMakeBorder(whole, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    to_image, _ = cv2.findHomography(BOARD * 2.0 + 79.5, view.points_px)
    rows, columns = np.nonzero(cv2.warpPerspective(sheet, to_image, SIZE, borderValue=0) > 127)
    edges = np.round(clock(np.asarray(edges_us, float))).astype(np.int64)
    n, up = len(rows), np.arange(len(edges)) % 2 == 0
    later = np.tile(np.sort((np.arange(n) * 997) % 300), len(edges))  # pixels fire one after the other
    np.savez(
        path.with_suffix(".npz"),
        t=np.repeat(edges, n) + 20 + later,
        x=np.tile(columns, len(edges)).astype(np.uint16),
        y=np.tile(rows, len(edges)).astype(np.uint16),
        p=np.repeat(up, n).astype(np.uint8),
        trigger_t=edges,
        trigger_value=up.astype(np.uint8),
        trigger_id=np.zeros(len(edges), np.uint8),
        size=np.array(SIZE),
    )
    with pytest.raises(SystemExit) as end:
        main(["convert", str(path.with_suffix(".npz")), str(path)])
    assert end.value.code == 0
    path.with_suffix(".npz").unlink()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Recordings of both cameras; those of the folder `alone` under another lamp."""
    rig, folder = Drawn(5, boards=5, sizes=(SIZE, SIZE), sigma_px=0.0), tmp_path_factory.mktemp("sync")
    lamp = 2000 + PERIOD_US // 2 * np.arange(2 * PERIODS)
    clocks = {
        "left": lambda t: t,
        "right": lambda t: t + OFFSET_US + GAIN * (t - lamp.mean()),
        "alone": lambda t: 1.01 * t,
    }
    for name, views in {"left": rig.views[0], "right": rig.views[1], "alone": rig.views[1]}.items():
        (folder / name).mkdir()
        for view in views[: 2 if name == "alone" else None]:
            flickering(view, clocks[name], lamp, folder / name / f"{view.name}.raw")
    return folder


def said(capsys, *words, status=0):
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    out = capsys.readouterr()
    assert end.value.code == status, out.err
    return out.err if status else out.out


def test_the_offset_of_the_clocks_comes_from_the_trigger_edges(capsys, folder, tmp_path):
    words = ("rig", folder / "left", folder / "right", *WORDS, "--sync", "-o", tmp_path / "rig")
    told = json.loads(said(capsys, *words, "--json"))
    held = json.loads((tmp_path / "rig" / "rig.json").read_text())
    assert held["clocks"] == told["clocks"]
    assert len(told["clocks"]["recordings"]) == 5
    for one in told["clocks"]["recordings"]:
        assert one["offset_us"] == pytest.approx(OFFSET_US, abs=3.0 * one["sigma_us"])
        assert one["period_us"] == pytest.approx(PERIOD_US, abs=1.0)
        assert one["edges"] == PERIODS
    assert told["clocks"]["rate_ppm"] == pytest.approx(60.0, abs=3.0 * told["clocks"]["sigma_rate_ppm"])
    shown = said(capsys, *words[:-2])
    assert "second - first = 1700" in shown
    assert "us: the offsets may differ by whole periods. The values nearest zero are given." in shown
    fewer = json.loads(said(capsys, *words[:-2], "--views", "1,2,4", "--json"))
    assert [one["name"] for one in fewer["clocks"]["recordings"]] == ["board-0", "board-1", "board-3"]
    assert "Clock of" not in said(capsys, *words[:-3])


def test_recordings_that_are_not_synchronised_are_one_error(capsys, folder, tmp_path):
    words = ("rig", folder / "left", folder / "alone", *WORDS, "--sync", "-o", tmp_path / "new")
    assert "the sync edges of the two cameras do not belong together" in said(capsys, *words, status=1)
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures" / "board-0.png"), np.zeros((300, 400), np.uint8))
    words = ("rig", folder / "left", tmp_path / "pictures", *WORDS, "--sync", "-o", tmp_path / "new")
    assert "Sync edges stand in RAW recordings only." in said(capsys, *words, status=2)
    assert not (tmp_path / "new").exists()
