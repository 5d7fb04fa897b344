"""Two simulated Zaber controllers on one line, and the driver for them."""

import re
from collections.abc import Callable

from drivers.stage import AxisLimits
from drivers.stage.zaber import ZaberAxis, ZaberStage
from simulators.stages.axis_motion import AxisModel, Mechanics
from simulators.stages.zaber import ZaberChain, ZaberController
from tests.hil.direct_stages import HomedStage, VirtualClock, direct_line

SCALE = 1000


def zaber_line(body: str) -> bytes:
    """Return a reply line with its checksum."""
    return f"@{body}:{-sum(body.encode()) & 0xFF:02X}\r\n".encode()


def words(change: Callable[[list[str]], list[str]]) -> Callable[[bytes], bytes]:
    """Change the words of replies (device, axis, id, verdict, state, flag, data ...) and seal them anew."""
    return lambda answer: b"".join(
        zaber_line(" ".join(change(body.decode().split(" "))))
        for body in re.findall(rb"@(.*?):..\r\n", answer)
    )


LIMITS = AxisLimits(-15.0, 15.0, 10.0, 50.0)


def axes(**changes) -> list[ZaberAxis]:
    words = {"microsteps_per_deg": SCALE, "limits": LIMITS, **changes}
    named = (("pan", 1, "100101"), ("tilt", 2, "100102"))
    return [ZaberAxis(name=name, device=at, serial=serial, **words) for name, at, serial in named]


class Bench(HomedStage):
    """Two chained controllers on a line, and the driver for them."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        mechanics = Mechanics(SCALE, -17.0, 17.0, start_deg=2.4)
        self.pan, self.tilt = (
            ZaberController(AxisModel(mechanics, serial, 15_000 / SCALE, encoder=False), self.clock.now_s)
            for serial in ("100101", "100102")
        )
        chain = ZaberChain([self.pan, self.tilt], self.clock.monotonic)
        self.line = direct_line(chain, self.clock)

    def open(self, **changes) -> ZaberStage:
        return ZaberStage(self.line, axes(**changes), clock=self.clock)

    def requests(self, word: str) -> list[str]:
        """Requests with a word, without their checksums."""
        sent = [line.decode().split(":")[0] for line in self.line.sent]
        return [text for text in sent if re.search(rf" {word}\b", text)]

    def motions(self) -> list[str]:
        return [*self.requests("move"), *self.requests("home")]

    def position(self, name: str) -> int:
        return round(getattr(self, name).axis.counter(self.clock.now_s))

    def busy(self) -> bool:
        return any(controller.axis.busy(self.clock.now_s) for controller in (self.pan, self.tilt))

    def go(self, name: str, counts: int = 9000) -> None:
        """Somebody else moves an axis."""
        getattr(self, name).execute(1, ["move", "abs", str(counts)], self.clock.now_s)

    def answer(self, asked_of: str, place: int, word: str) -> Callable[[], None]:
        """Replace a word of the replies to a request (verdict 3, state 4, flag 5, data 6) until the result is called."""
        changed = words(lambda reply: [*reply[:place], word, *reply[place + 1 :]])
        device, _, asked = asked_of.partition(" ")

        def spoil(reply: bytes) -> bytes:
            is_meant = self.requests(asked)[-1:] == [self.line.sent[-1].decode().split(":")[0]]
            return changed(reply) if is_meant and reply.startswith(f"@{device}".encode()) else reply

        self.line.spoil = spoil
        return lambda: setattr(self.line, "spoil", lambda reply: reply)
