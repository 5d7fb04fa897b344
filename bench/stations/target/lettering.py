"""Letters made of upright rectangles, for the text on a reticle.

Letters of rectangles need no font file, keep their exact size in every file format, and can be left out of a chrome
area as well as drawn. The module knows no drawing and no target.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

ROWS, COLUMNS = 7, 5
"""Cells of a letter; one empty column follows each letter."""

_LETTERS = """
A .###. #...# #...# ##### #...# #...# #...#
B ####. #...# #...# ####. #...# #...# ####.
C .#### #.... #.... #.... #.... #.... .####
D ####. #...# #...# #...# #...# #...# ####.
E ##### #.... #.... ####. #.... #.... #####
F ##### #.... #.... ####. #.... #.... #....
G .#### #.... #.... #..## #...# #...# .####
H #...# #...# #...# ##### #...# #...# #...#
I .###. ..#.. ..#.. ..#.. ..#.. ..#.. .###.
J ..### ....# ....# ....# ....# #...# .###.
K #...# #..#. #.#.. ##... #.#.. #..#. #...#
L #.... #.... #.... #.... #.... #.... #####
M #...# ##.## #.#.# #.#.# #...# #...# #...#
N #...# ##..# #.#.# #.#.# #..## #...# #...#
O .###. #...# #...# #...# #...# #...# .###.
P ####. #...# #...# ####. #.... #.... #....
Q .###. #...# #...# #...# #.#.# #..#. .##.#
R ####. #...# #...# ####. #.#.. #..#. #...#
S .#### #.... #.... .###. ....# ....# ####.
T ##### ..#.. ..#.. ..#.. ..#.. ..#.. ..#..
U #...# #...# #...# #...# #...# #...# .###.
V #...# #...# #...# #...# #...# .#.#. ..#..
W #...# #...# #...# #.#.# #.#.# ##.## #...#
X #...# #...# .#.#. ..#.. .#.#. #...# #...#
Y #...# #...# .#.#. ..#.. ..#.. ..#.. ..#..
Z ##### ....# ...#. ..#.. .#... #.... #####
0 .###. #...# #..## #.#.# ##..# #...# .###.
1 ..#.. .##.. ..#.. ..#.. ..#.. ..#.. .###.
2 .###. #...# ....# ...#. ..#.. .#... #####
3 ####. ....# ....# .###. ....# ....# ####.
4 #..#. #..#. #..#. ##### ...#. ...#. ...#.
5 ##### #.... ####. ....# ....# #...# .###.
6 .###. #.... #.... ####. #...# #...# .###.
7 ##### ....# ...#. ..#.. ..#.. ..#.. ..#..
8 .###. #...# #...# .###. #...# #...# .###.
9 .###. #...# #...# .#### ....# ....# .###.
m ..... ..... ##.#. #.#.# #.#.# #.#.# #.#.#
- ..... ..... ..... ##### ..... ..... .....
_ ..... ..... ..... ..... ..... ..... #####
. ..... ..... ..... ..... ..... .##.. .##..
, ..... ..... ..... ..... .##.. ..#.. .#...
: ..... .##.. .##.. ..... .##.. .##.. .....
/ ....# ....# ...#. ..#.. .#... #.... #....
+ ..... ..#.. ..#.. ##### ..#.. ..#.. .....
= ..... ..... ##### ..... ##### ..... .....
( ...#. ..#.. .#... .#... .#... ..#.. ...#.
) .#... ..#.. ...#. ...#. ...#. ..#.. .#...
# .#.#. .#.#. ##### .#.#. ##### .#.#. .#.#.
"""

GLYPHS = {
    line[0]: [[cell == "#" for cell in row] for row in line[2:].split(" ")]
    for line in _LETTERS.strip().split("\n")
} | {" ": [[False] * COLUMNS] * ROWS}
"""Cells of each letter, row by row from the top; capital letters, and the m of the unit."""


def unknown_letters(text: str) -> str:
    """Return the letters of a text that cannot be drawn, each once.

    Returns: The letters in their order; empty if all can be drawn.
    """
    return "".join(dict.fromkeys(letter for letter in text.upper() if letter not in GLYPHS))


def text_width(text: str, height: float) -> float:
    """Return the width of a text."""
    return max(0, (COLUMNS + 1) * len(text) - 1) * height / ROWS


def text_rectangles(text: str, height: float) -> NDArray[np.float64]:
    """Return the rectangles of a text, with the upper left corner of its first letter at the origin, Y down.

    text: The text, with letters of `GLYPHS` only.
    Returns: (N, 4) float64, in the unit of the height: left, top, right, bottom of each rectangle; they do
      not overlap.
    """
    cells = [
        (left + place * (COLUMNS + 1), row, right + place * (COLUMNS + 1), row + 1)
        for place, letter in enumerate(text)
        for row, left, right in _runs(GLYPHS[letter])
    ]
    return np.array(cells, np.float64).reshape(-1, 4) * (height / ROWS)


def _runs(cells: list[list[bool]]) -> Iterator[tuple[int, int, int]]:
    """Yield row, first column and column after the last, of every run of filled cells."""
    for row, line in enumerate(cells):
        edges = np.flatnonzero(np.diff([0, *map(int, line), 0]))
        for left, right in edges.reshape(-1, 2):
            yield row, int(left), int(right)
