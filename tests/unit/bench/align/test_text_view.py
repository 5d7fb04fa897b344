"""The figures in a terminal: one block, drawn again; plain lines elsewhere; nothing that a terminal cannot show."""

import io
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from bench.align.live_figures import LiveFigures
from bench.align.text_view import TextView, figure_lines, picture_rows, show_in_terminal, summary

FIGURES = LiveFigures(
    image_kind="fired-per-edge",
    width_px=1280,
    height_px=720,
    events_per_s=94.1e6,
    link_share=0.19,
    on_share=0.45,
    trigger_hz=60.0,
    event_hz=60.05,
    jitter_us=0.5,
    hot_pixels=18,
    temperature_c=41.5,
    stars=((903, 1.0, 2.0), (904, 3.0, 4.0)),
    tag_id=3,
    rim_in_view=True,
    beam_share=0.98,
    focus={
        "edge_width_px": 0.684,
        "best_edge_width_px": 0.66,
        "sharpness": 0.34,
        "best_sharpness": 0.36,
        "regions": {
            name: {"edge_width_px": 0.7 + 0.1 * i} for i, name in enumerate(("centre", "a", "b", "c", "d"))
        },
    },
    contrast=1.0,
    turn={
        "pan_deg": 0.32,
        "tilt_deg": -0.2,
        "roll_deg": 10.0,
        "of": "tag",
        "unit": "°",
        "rim_poses": "Poses.",
    },
    advice=("Turn pan by +0.32 degrees.", "Second."),
)
IMAGE = np.tile(np.linspace(0, 255, 1280, dtype=np.uint8), (720, 1))


class Terminal(io.StringIO):
    """A terminal of 100 columns, as far as a program can tell."""

    encoding = "utf-8"

    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("LINES", "40")
    monkeypatch.setenv("TERM", "xterm-256color")
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_INTERACTIVE", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    return Terminal()


def test_every_figure_is_in_a_line():
    text = "\n".join(figure_lines(FIGURES))
    for part in (
        "94.1 Mev/s, link 19 %, ON 45 %, 18 hot pixels, sensor 41.5°C",
        "60.00 Hz by triggers, 60.0 Hz by events, jitter 0.5 us",
        "Stars    2, tag 3, contrast 100 %, saturated -",
        "edges 0.68 px (best 0.66 px), sharpness 0.34 (best 0.36)",
        "centre 0.70, corners 0.80 0.90 / 1.00 1.10",
        "pan +0.3°, tilt -0.2° (by the tag), roll to the pixels 10.0°",
        "covers 98 % of the frame, its rim is in view",
    ):
        assert part in text
    assert max(len(line) for line in text.splitlines()) <= 80


def test_unknown_figures_are_dashes():
    text = "\n".join(figure_lines(LiveFigures()))
    assert "Signal   -, link -, ON -, -, sensor -" in text
    assert "tag not recognised" in text
    assert "its rim is unknown" in text
    assert summary(LiveFigures()).startswith("0 stars, no tag, edges -")
    in_px = LiveFigures(turn={"unit": "px", "right_px": -120.0, "up_px": 30.0, "of": "tag"})
    assert "right -120 px, up +30 px (by the tag)" in "\n".join(figure_lines(in_px))


def test_a_block_is_drawn_again_in_its_place(terminal):
    view = TextView("Bench", stream=terminal)
    view.show(1, IMAGE, FIGURES)
    first = terminal.getvalue()
    assert "Turn pan by +0.32 degrees." in first
    assert "- Second." in first
    assert "Ctrl-C ends." in first
    view.show(2, IMAGE, FIGURES)
    second = terminal.getvalue()[len(first) :]
    assert "\x1b[1A" in second  # the cursor goes up over the block before
    assert second.count("Ctrl-C ends.") == 1
    assert first.count("\n") < 40


def test_a_low_terminal_has_no_picture(terminal, monkeypatch):
    monkeypatch.setenv("LINES", "18")
    TextView("Bench", stream=terminal).show(1, IMAGE, FIGURES)
    assert "\N{FULL BLOCK}" not in terminal.getvalue()
    assert "Ctrl-C ends." in terminal.getvalue()


def test_plain_lines_where_there_is_no_terminal():
    now = [100.0]
    stream = io.StringIO()
    view = TextView("Bench", stream=stream, clock=lambda: now[0])
    view.show(0, IMAGE, LiveFigures())
    assert stream.getvalue() == ""
    for number in range(1, 12):
        now[0] += 0.5
        view.show(number, IMAGE, FIGURES)
    lines = stream.getvalue().splitlines()
    assert next(line for line in lines if "stars" in line).startswith("0 s: 2 stars, tag 3, edges 0.68 px")
    assert len([line for line in lines if " s: " in line]) == 3
    assert lines.count("  Second.") == 1  # advice is said once, until it changes
    assert "\x1b" not in stream.getvalue()
    now[0] += 5
    view.show(13, IMAGE, FIGURES, trouble="The camera does not answer.")
    assert stream.getvalue().splitlines()[-1] == "  The camera does not answer."


def test_pictures_as_characters():
    rows = picture_rows(IMAGE, columns=40)
    assert len({len(row) for row in rows}) == 1
    assert rows[0][0] == " "
    assert rows[0][-1] == "\N{FULL BLOCK}"
    assert picture_rows(IMAGE, columns=40, plain=True)[0].isascii()
    assert picture_rows(np.zeros((1, 1), np.uint8), columns=4) == [" " * 4] * 2


def test_it_shows_until_it_shall_end(monkeypatch):
    monkeypatch.setattr("bench.align.text_view.REDRAWN_EVERY_S", 0.001)
    ended, stream, asked = threading.Event(), io.StringIO(), []

    def latest():
        asked.append(1)
        if len(asked) == 3:
            ended.set()
        return 1, IMAGE, FIGURES

    session = SimpleNamespace(
        station=SimpleNamespace(value=SimpleNamespace(name="Bench")),
        latest=latest,
        failures=list,
        bench=SimpleNamespace(loop=SimpleNamespace(failure=None)),
    )
    show_in_terminal(session, ended, stream=stream)
    assert len(asked) == 3
    assert "2 stars, tag 3" in stream.getvalue()
