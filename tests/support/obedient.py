"""A person who does what the align page says, and nothing else: its advice, its figures, its checks.

The person knows the keys of the page, and has hands at lens and camera. Nothing of the simulated truth is used.
"""

import re
import time

from bench.align.session import Session

FIRST_RING_STEP_DEG = 8.0
LARGEST_JOG_DEG = 5.0
LOOKS = 4
"""After each action the person waits for this number of pictures with stars."""
ENOUGH = 3
"""Pictures without anything to do after which the bench counts as aligned."""


class Obedient:
    """Obeys the first sentence of the advice, again and again, until there is none."""

    def __init__(self, session: Session, *, patience_s: float = 600.0) -> None:
        self.session = session
        self.done: list[str] = []
        self._until_s = time.monotonic() + patience_s
        self._ring_step_deg = FIRST_RING_STEP_DEG
        self._ring_deg: float | None = None

    def align(self) -> list[str]:
        """Obey until nothing is left to do; return the advice that stays."""
        session = self.session
        session.home()
        self._rest()
        said: list[set[str]] = []
        while time.monotonic() < self._until_s:
            figures = self._look()
            if any(self._obey(sentence, figures) for sentence in figures.advice):
                said.clear()
                continue
            # Nothing that hands at this bench could do: look again. What only one picture says is no lasting fault.
            self.done += [f"? {sentence}" for sentence in figures.advice]
            said.append(set(figures.advice))
            if len(said) >= ENOUGH:
                return sorted(set.intersection(*said))
        return [*self.session.picture().figures.advice, "no patience left"]

    # ------------------------------------------------------------------ eyes

    def _look(self, pictures: int = 10):
        """Return the figures of a picture begun after now, when enough of them have shown stars or none do."""
        begun_s = time.monotonic()
        seen, fresh = 0, set()
        last = self.session.picture().number
        while time.monotonic() < self._until_s:
            picture = self.session.picture()
            figures = picture.figures
            if picture.number != last and figures.time_s > begun_s:
                seen, last = seen + 1, picture.number
                if figures.stars_time_s is not None and figures.stars_time_s > begun_s:
                    fresh.add(figures.stars_time_s)
                if len(fresh) >= LOOKS or seen >= pictures:
                    return figures
            time.sleep(0.02)
        return self.session.picture().figures

    def _rest(self) -> None:
        while self.session.bench.stage.moving and time.monotonic() < self._until_s:
            time.sleep(0.02)

    # ------------------------------------------------------------------ hands

    def _obey(self, sentence: str, figures) -> bool:
        """Do what a sentence says; False if it is not understood."""
        if "switch it on" in sentence or "switch the light on" in sentence:
            self._note("light on")
            self.session.light(on=True)
        elif "Set the light's level to 100 %" in sentence:
            self._note("level 100 %")
            self.session.light(level_percent=100)
        elif "Turn the focus ring" in sentence:
            self._turn_ring(sentence)
        elif sentence.startswith("Roll the camera in its mount"):
            self._note(f"roll {figures.turn.roll_by_deg:+.1f}")
            self.session.bench.hands.do("mount turn", {"roll_deg": figures.turn.roll_by_deg})
        elif figures.turn.pan is not None and figures.turn.unit == "°" and ("to the middle" in sentence):
            steps = {axis: getattr(figures.turn, axis) for axis in ("pan", "tilt")}
            self._note("jog " + ", ".join(f"{axis} {step:+.2f}" for axis, step in steps.items()))
            for axis, step in steps.items():
                limited = max(-LARGEST_JOG_DEG, min(LARGEST_JOG_DEG, step))
                if abs(limited) > 0.001:
                    self.session.jog(axis, limited)
            self._rest()
        else:
            return False
        return True

    def _turn_ring(self, sentence: str) -> None:
        """Turn the ring as far as the sentence says; at its end, the other way."""
        if by := re.search(r"turn (on|back) by about ([\d.]+) times the last turn", sentence):
            self._ring_step_deg *= float(by[2]) * (1.0 if by[1] == "on" else -1.0)
        self._note(f"ring {self._ring_step_deg:+.2f}")
        seen = self.session.bench.hands.do("lens turn", {"deg": self._ring_step_deg})
        if seen["ring_deg"] == self._ring_deg:
            self._ring_step_deg = -self._ring_step_deg
        self._ring_deg = seen["ring_deg"]

    def _note(self, what: str) -> None:
        self.done.append(what)
