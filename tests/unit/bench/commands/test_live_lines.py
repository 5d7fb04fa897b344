"""Lines that show how far a command is."""

from bench.commands.workers import CountLine, PartsLine


class TimedLine(PartsLine):
    """A line on a terminal, with a clock that the test moves, that keeps what it shows."""

    def __init__(self):
        self.now_s, self.texts = 0.0, []
        super().__init__("views found", "the camera is calculated", monotonic=lambda: self.now_s)
        self.quiet, self._live = False, True

    def due(self):
        return True

    def show(self, text):
        self.texts.append(text)


def test_recordings_that_are_measured_are_counted_with_the_time_left():
    line = TimedLine()
    for done in range(3):
        line.reached(done, 3)
        line.now_s += 10.0
    assert line.texts == ["1 of 3 views found, 0:20 left", "2 of 3 views found, 0:10 left"]


def test_a_calculation_shows_how_long_it_takes_at_least():
    line = TimedLine()
    line.reached(3, 3)
    for done in (0.0, 0.4, 1.2):
        line.now_s += 4.0
        line.calculated(done, 2.0)
    assert line.texts == [
        "3 views found; the camera is calculated",
        "3 views found; the camera is calculated, at least 0:16 left",
        "3 views found; the camera is calculated, at least 0:05 left",
    ]


def test_what_is_done_is_counted_to_a_share_until_all_is_done(monkeypatch):
    line, shown = CountLine(200, "MB read"), []
    monkeypatch.setattr(line, "due", lambda: True)
    monkeypatch.setattr(line, "show", shown.append)
    for share in (0.1, 0.5, 1.0):
        line.show_share(share)
    assert [text.partition(",")[0] for text in shown] == ["20 of 200 MB read", "100 of 200 MB read"]
