"""A terminal as far as a block of text needs it: what stands on the screen after some output."""

import io
import re

_TOKEN = re.compile(r"\x1b\[([0-9;?]*)([A-Za-z])|([\r\n])|([^\x1b\r\n]+)")


class Terminal(io.StringIO):
    """A terminal that keeps what is written to it."""

    def isatty(self):
        return True


class Screen:
    """Rows of text, a cursor, and the escape sequences for moving, erasing and colours.

    A line that is longer than the terminal is wide continues in the next row.
    """

    def __init__(self, columns, rows):
        self.columns, self.height = columns, rows
        self.rows = [""]
        self.scrolled = []
        self.row = self.column = 0
        self.unknown = []

    def feed(self, text):
        for codes, kind, move, plain in _TOKEN.findall(text):
            if plain:
                self._write(plain)
            elif move == "\r":
                self.column = 0
            elif move == "\n":
                self.column = 0
                self._down()
            elif kind == "A":
                self.row = max(0, self.row - int(codes or 1))
            elif kind == "K" and codes == "2":
                self.rows[self.row] = ""
            elif kind == "J" and codes == "2":
                self.rows = [""] * len(self.rows)
            elif kind == "H":
                self.row = self.column = 0
            elif kind != "m":
                self.unknown.append((codes, kind))

    def _write(self, plain):
        for character in plain:
            if self.column == self.columns:
                self.column = 0
                self._down()
            row = self.rows[self.row].ljust(self.column)
            self.rows[self.row] = row[: self.column] + character + row[self.column + 1 :]
            self.column += 1

    def _down(self):
        self.row += 1
        if self.row == len(self.rows):
            self.rows.append("")
        if len(self.rows) > self.height:
            self.scrolled.append(self.rows.pop(0))
            self.row -= 1

    @property
    def text(self):
        return "\n".join(row.rstrip() for row in self.rows).rstrip()
