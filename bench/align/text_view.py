"""The live figures in a terminal: one block that is drawn again in its place, or plain lines elsewhere.

The module shows what a session measures. It moves nothing and switches no light.
"""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final, TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.align.live_figures import LiveFigures
from bench.align.session import Session
from bench.terminal.block import Block

REDRAWN_EVERY_S: Final = 0.2
LINE_EVERY_S: Final = 2.0
"""Shortest time between two lines where the output is no terminal, s."""
_SHADES: Final = " \N{LIGHT SHADE}\N{MEDIUM SHADE}\N{DARK SHADE}\N{FULL BLOCK}"
_PLAIN_SHADES: Final = " .:+#"
_PICTURE_COLUMNS: Final = 72
_LEAST_ROWS: Final = 9
_FOCUS_NAMES: Final = {"edge_width_px": " px", "sharpness": ""}
_CELL_ASPECT: Final = 2.0
"""Height of a character, in units of its width."""


def show_in_terminal(
    session: Session,
    ended: threading.Event,
    *,
    stream: TextIO | None = None,
    notice: Callable[[], str] = str,
    tail: str = "Ctrl-C ends.",
) -> None:
    """Show the figures of an open session until it shall end.

    ended: Set by another thread, or by a signal, to end.
    stream: Where to write; None for standard output.
    notice: Returns what stands in the place of the advice for the moment; empty for the advice.
    tail: Last line of the block.
    """
    view = TextView(session.station.value.name, stream=stream, tail=tail)
    while not ended.wait(REDRAWN_EVERY_S):
        number, image, figures = session.latest()
        failure = session.bench.loop.failure
        lines = [one.message for one in session.failures()]
        view.show(
            number,
            image,
            replace(figures, advice=(*lines, *figures.advice)) if lines else figures,
            trouble=notice() or (failure.message if failure is not None else ""),
        )


class TextView:
    """Shows one picture's figures after the other.

    stream: Where to write; None for standard output.
    clock: Returns the time, s; it counts pictures per second and spaces plain lines.
    tail: Last line of the block.
    """

    def __init__(
        self,
        name: str,
        *,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
        tail: str = "Ctrl-C ends.",
    ) -> None:
        self._tail = tail
        self._name = name
        self._stream = stream or sys.stdout
        self._block = Block(self._stream)
        self._clock = clock
        self._began_s = clock()
        self._seen: list[tuple[float, int]] = []
        self._line_s = -LINE_EVERY_S
        self._advice: Sequence[str] | None = None

    def show(self, number: int, image: NDArray[np.uint8], figures: LiveFigures, *, trouble: str = "") -> None:
        """Show a picture's figures: as a block, or as a line if some time has passed since the last one.

        number: Number of the picture; 0 before the first one.
        image: (H, W) uint8.
        trouble: Why there are no new pictures; empty while they come.
        """
        if self._block.can_redraw:
            head = self._head(number, figures, trouble)
            self._block.draw(head, self._picture(image, head) if number else [], [self._tail])
            return
        for line in self._plain_lines(number, figures, trouble):
            print(line, file=self._stream, flush=True)

    def _picture(self, image: NDArray[np.uint8], head: Sequence[str]) -> list[str]:
        """Return the picture as large as there is room below the head; empty if there is too little."""
        width, height = shutil.get_terminal_size()
        used = sum(1 + len(line) // max(width - 1, 1) for line in head)
        room = height - used - 2
        if room < _LEAST_ROWS:
            return []
        columns = min(width - 1, int(room * _CELL_ASPECT * image.shape[1] / image.shape[0]))
        return picture_rows(image, columns=max(1, columns), plain=not _is_unicode(self._stream))[:room]

    def _head(self, number: int, figures: LiveFigures, trouble: str) -> list[str]:
        """Return the upper lines of the block; the second one is the most important."""
        title = f"{self._name}: picture {number}, {self._per_second(number):.1f} a second"
        advice = [trouble] if trouble else list(figures.advice)
        if not advice:
            advice = ["Waiting for the first picture."] if not number else ["Nothing is to be improved here."]
        others = [f"- {line}" for line in advice[1:]]
        return [title, advice[0], *others, "", *(figure_lines(figures) if number else []), ""]

    def _plain_lines(self, number: int, figures: LiveFigures, trouble: str) -> Iterator[str]:
        """Yield the lines of a picture: its figures, and the advice if it has changed."""
        now_s = self._clock()
        advice = (trouble,) if trouble else tuple(figures.advice)
        if now_s - self._line_s < LINE_EVERY_S or not (number or trouble):
            return
        self._line_s = now_s
        if number and not trouble:
            yield f"{now_s - self._began_s:.0f} s: {summary(figures)}"
        if advice != self._advice:
            self._advice = advice
            yield from (f"  {line}" for line in advice)

    def _per_second(self, number: int) -> float:
        """Return how many new pictures came in each of the last seconds."""
        now_s = self._clock()
        self._seen = [one for one in self._seen if now_s - one[0] < 4.0] + [(now_s, number)]
        (first_s, first), (last_s, last) = self._seen[0], self._seen[-1]
        return (last - first) / (last_s - first_s) if last_s > first_s else 0.0


def figure_lines(figures: LiveFigures) -> list[str]:
    """Return the figures as lines of at most 80 characters. What was not measured is a dash."""
    f, focus, turn = figures, figures.focus, figures.turn
    rate = None if f.events_per_s is None else f.events_per_s / 1e6
    regions = focus.get("regions") or {}
    signal = [
        _text(rate, ".1f", " Mev/s"),
        f"link {_share(f.link_share)}",
        f"ON {_share(f.on_share)}",
        _text(f.hot_pixels, "d", " hot pixels"),
        f"sensor {_text(f.temperature_c, '.1f', '°C')}",
    ]
    flicker = [
        f"{_text(f.trigger_hz, '.2f', ' Hz')} by triggers",
        f"{_text(f.event_hz, '.1f', ' Hz')} by events",
        f"jitter {_text(f.jitter_us, '.1f', ' us')}",
    ]
    stars = [
        str(len(f.stars)),
        f"tag {f.tag_id if f.tag_id is not None else 'not recognised'}",
        f"contrast {_share(f.contrast)}",
        f"saturated {_share(f.saturation)}",
    ]
    now, best = (
        [_text(focus.get(f"{which}{name}"), ".2f", unit) for name, unit in _FOCUS_NAMES.items()]
        for which in ("", "best_")
    )
    edges = [f"edges {now[0]} (best {best[0]})", f"sharpness {now[1]} (best {best[1]})"]
    subjects = {"Signal": signal, "Flicker": flicker, "Stars": stars, "Focus": edges}
    lines = [f"{subject:9s}{', '.join(parts)}" for subject, parts in subjects.items()]
    if regions:
        centre, *corners = (_text(one.get("edge_width_px"), ".2f", "") for one in regions.values())
        lines.append(f"         centre {centre}, corners {' '.join(corners[:2])} / {' '.join(corners[2:])}")
    form = _turn_form(turn)
    in_deg = turn.get("unit", "°") == "°"
    steps = (
        f"pan {_text(turn.get('pan_deg'), form, '°')}, tilt {_text(turn.get('tilt_deg'), form, '°')}"
        if in_deg
        else f"right {_text(turn.get('right_px'), '+.0f', ' px')}, up {_text(turn.get('up_px'), '+.0f', ' px')}"
    )
    of = f" ({'about, ' if turn['of'] == 'beam' else ''}by the {turn['of']})" if turn.get("of") else ""
    lines.append(f"Turn     {steps}{of}, roll to the pixels {_text(turn.get('roll_deg'), '.1f', '°')}")
    rim = {True: "its rim is in view", False: "its rim is not in view", None: "its rim is unknown"}[
        f.rim_in_view
    ]
    lines.append(f"Beam     covers {_share(f.beam_share)} of the frame, {rim}")
    if turn.get("rim_poses"):
        lines.append(f"         {turn['rim_poses']}")
    return lines


def summary(figures: LiveFigures) -> str:
    """Return the main figures in one line."""
    f, focus, turn = figures, figures.focus, figures.turn
    rate = None if f.events_per_s is None else f.events_per_s / 1e6
    parts = [
        f"{len(f.stars)} stars",
        f"tag {f.tag_id}" if f.tag_id is not None else "no tag",
        f"edges {_text(focus.get('edge_width_px'), '.2f', ' px')}",
        f"sharpness {_text(focus.get('sharpness'), '.2f', '')}",
        f"{_text(rate, '.1f', ' Mev/s')}",
        f"{_text(f.trigger_hz if f.trigger_hz is not None else f.event_hz, '.2f', ' Hz')}",
    ]
    form = _turn_form(turn)
    if turn.get("pan_deg") is not None:
        parts.append(f"turn {_text(turn['pan_deg'], form, '°')}, {_text(turn.get('tilt_deg'), form, '°')}")
    return ", ".join(parts)


def picture_rows(
    image: NDArray[np.uint8], *, columns: int = _PICTURE_COLUMNS, plain: bool = False
) -> list[str]:
    """Return a picture as rows of characters.

    image: (H, W) uint8.
    columns: Number of characters in a row.
    plain: Whether only ASCII characters are used.
    """
    height = max(1, round(columns * image.shape[0] / image.shape[1] / _CELL_ASPECT))
    small = cv2.resize(image, (columns, height), interpolation=cv2.INTER_AREA)
    shades = _PLAIN_SHADES if plain else _SHADES
    levels = np.minimum(small.astype(np.int64) * len(shades) // 256, len(shades) - 1)
    return ["".join(shades[level] for level in row) for row in levels]


def _turn_form(turn: Mapping[str, object]) -> str:
    """Return the form of a turn: whole degrees by the beam, else tenths."""
    return "+.0f" if turn.get("of") == "beam" else "+.1f"


def _text(value: float | None, form: str, unit: str) -> str:
    """Return a number as text; a dash if it is unknown."""
    return "-" if value is None or not np.isfinite(value) else f"{value:{form}}{unit}"


def _share(value: float | None) -> str:
    """Return a share in per cent; a dash if it is unknown."""
    return _text(None if value is None else 100 * value, ".0f", " %")


def _is_unicode(stream: TextIO) -> bool:
    return str(getattr(stream, "encoding", "") or "").lower().startswith("utf")
