"""The reticle of a station: its areas, its files, and what it is good for."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.path import Path as Outline

from bench.base.errors import UsageError
from bench.commands.cli import cli
from bench.stations.reticle_files import WRITERS, drawing_file
from bench.stations.station import load_station
from bench.stations.station_fields import TargetConfig
from bench.stations.target_files import optics_of, use_of
from bench.stations.target_shapes import draw_target, scale_bar_mm

SMALL = {"squares": (16, 18), "pitch_mm": 3.0, "tag_square": (6, 7), "serial": "a-7"}


def covered(polygons, places):
    """Return by how many polygons each place is covered."""
    count = np.zeros(len(places), int)
    for polygon in polygons:
        near = np.flatnonzero(((places > polygon.min(axis=0)) & (places < polygon.max(axis=0))).all(axis=1))
        count[near] += Outline(polygon).contains_points(places[near])
    return count


@pytest.mark.parametrize("polarity", ["positive", "negative"])
@pytest.mark.parametrize(("family", "segments", "side"), [("36h11", 16, 4), ("25h9", 12, 3), ("16h5", 4, 5)])
def test_what_is_filled_is_what_is_opaque_on_the_print(polarity, family, segments, side):
    target = TargetConfig(**SMALL, polarity=polarity, tag_family=family, segments=segments, tag_squares=side)
    drawing, pattern = draw_target(target), target.pattern()
    places = np.random.default_rng(2).uniform(-0.5, 0.5, (3000, 2)) * [drawing.width_mm, drawing.height_mm]
    count = covered(drawing.polygons, places)
    assert count.max() == 1
    on_print = places - drawing.offset_mm
    white = pattern.reflectance(*on_print.T) > 0.5
    opaque = white if polarity == "negative" else ~white
    half_mm = 0.5 * np.array([pattern.columns, pattern.rows]) * pattern.pitch_mm
    in_pattern = (np.abs(places) < half_mm).all(axis=1)
    assert np.array_equal(count[in_pattern] == 1, opaque[in_pattern])
    marks = (count == 1) != opaque
    assert 0.002 < marks[~in_pattern].mean() < 0.1


def test_a_mirrored_drawing_has_left_and_right_changed():
    plain = draw_target(TargetConfig(**SMALL))
    mirrored = draw_target(TargetConfig(**SMALL, drawing={"mirrored": True}))
    places = np.random.default_rng(3).uniform(-20, 20, (500, 2))
    assert np.array_equal(covered(plain.polygons, places), covered(mirrored.polygons, places * [-1, 1]))


def test_scale_bars_are_round_and_as_long_as_they_say():
    target = TargetConfig(**SMALL)
    assert scale_bar_mm(target) == 20.0
    widths = [np.ptp(p, axis=0) for p in draw_target(target).parts[2].polygons]
    assert sum(np.allclose(width, [20.0, 0.75]) for width in widths) == 1
    assert sum(np.allclose(width, [0.75, 20.0]) for width in widths) == 1
    assert scale_bar_mm(TargetConfig(**SMALL, drawing={"scale_bar_mm": 7.5})) == 7.5
    without = draw_target(TargetConfig(**SMALL, drawing={"scale_bar_mm": 0}))
    assert len(without.polygons) < len(draw_target(target).polygons)


@pytest.mark.parametrize("ending", WRITERS)
def test_the_same_station_gives_the_same_bytes_in_another_process(ending):
    pytest.importorskip({".dxf": "ezdxf", ".gds": "gdstk"}.get(ending, "numpy"))
    code = (
        "import sys, pathlib; from bench.stations.reticle_files import drawing_file; from bench.stations.station_fields import TargetConfig;"
        f"sys.stdout.buffer.write(drawing_file(TargetConfig(**{SMALL}), pathlib.Path('x{ending}')))"
    )
    drawn = subprocess.check_output([sys.executable, "-c", code], env={**os.environ, "PYTHONHASHSEED": "4"})
    assert drawn == drawing_file(TargetConfig(**SMALL), Path(f"x{ending}"))
    assert drawn != drawing_file(TargetConfig(**(SMALL | {"serial": "a-8"})), Path(f"x{ending}"))


@pytest.mark.parametrize(
    ("change", "name", "message"),
    [
        ({"serial": "Ä7"}, "x.svg", "letters that cannot be drawn: Ä"),
        ({"drawing": {"size_mm": (48, 54)}}, "x.svg", r"at least \[58.8, 64.8\]"),
        ({"drawing": {"scale_bar_mm": 400}}, "x.svg", "longer than the pattern. Give at most"),
        ({}, "x.png", r"ends in '\.png'\. End the name in \.svg"),
        ({}, "x", "a name without an ending"),
        ({"pitch_mm": 400, "squares": (16, 18)}, "x.pdf", "at most 5080 mm wide"),
        ({"pitch_mm": 400, "squares": (16, 18)}, "x.gds", "at most 4295 mm wide"),
        ({"squares": (400, 400), "tag_square": (100, 100)}, "x.svg", "more than 1000000 areas"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_what_to_do(change, name, message):
    with pytest.raises(UsageError, match=message):
        drawing_file(TargetConfig(**(SMALL | change)), Path(name))


@pytest.mark.parametrize(("ending", "library"), [(".dxf", "ezdxf"), (".gds", "gdstk")])
def test_a_missing_library_is_named_with_its_remedy(monkeypatch, ending, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(UsageError, match=rf"{library} .*'starbench\[draw\]'"):
        drawing_file(TargetConfig(**SMALL), Path(f"x{ending}"))


def test_the_command_writes_a_new_file_and_never_over_an_old_one(tmp_path):
    path = tmp_path / "reticle.svg"
    done = CliRunner().invoke(cli, ["target", "-s", "simulated", "-o", str(path)], standalone_mode=False)
    assert done.return_value == 0, done.exception
    assert "36H11-3 50/72 4.01389 mm; 232.806 x 321.111 mm" in done.output
    text = path.read_text()
    assert 'width="232.805556mm" height="321.111111mm"' in text
    again = CliRunner().invoke(cli, ["target", "-s", "simulated", "-o", str(path)], standalone_mode=False)
    assert isinstance(again.exception, UsageError)
    assert path.read_text() == text


@pytest.mark.parametrize(
    ("change", "focal_px", "warning_text"),
    [
        ({}, 12_000.0, "0 stars in view"),
        ({}, 6000.0, "few for poses at the edge"),
        ({}, 500.0, "at least 7.15 mm"),
        ({}, 650.0, "41 px wide"),
        ({}, 6500.0, "half of the image's height"),
        ({"tag_family": "16h5"}, 3300.0, "family 16h5"),
        ({"segments": 20}, 3300.0, "20 segments"),
        ({"squares": (20, 20), "tag_square": (8, 8)}, 3300.0, "ends 8.5 degrees from"),
    ],
)
def test_what_speaks_against_a_target_is_said(change, focal_px, warning_text):
    optics = optics_of(load_station("simulated").value)
    use = use_of(TargetConfig(**change), replace(optics, focal_px=focal_px))
    assert any(warning_text in warning for warning in use.warnings), use.warnings


def test_a_station_must_state_the_lens():
    station = load_station("simulated").value
    with pytest.raises(UsageError, match="Add the section `expected`"):
        optics_of(station.model_copy(update={"expected": None}))
