"""Example and drafted station files as a person fills them in."""

import re
from collections import defaultdict

from bench.stations.placeholders import Unknown
from bench.stations.station import SHIPPED_STATIONS

_TEXTS = {
    Unknown.PORT: "/dev/serial/by-id/usb-Maker_Adapter_{}-if00-port0",
    Unknown.ADDRESS: "socket://192.168.7.20:5025",
    Unknown.SOURCE: "/dev/v4l/by-id/usb-Maker_{}",
    Unknown.BOARD: "turntable-{}",
    Unknown.SERIAL: "10000{}",
    Unknown.LABORATORY: "Camera laboratory",
}


def filled(text: str) -> str:
    """Return a station file with a value in place of every placeholder."""
    numbers = defaultdict(lambda: "6400", high_v="2.5")
    text = re.sub(rf"(\w+): {Unknown.NUMBER}", lambda key: f"{key[1]}: {numbers[key[1]]}", text)
    metavision = "driver: metavision\n  serial: "
    text = text.replace(metavision + Unknown.SERIAL, metavision + "00051234")
    count = 0

    def next_value(match: re.Match[str]) -> str:
        nonlocal count
        count += 1
        return _TEXTS[match[0]].format(count)

    return re.sub("|".join(map(re.escape, _TEXTS)), next_value, text)


def filled_example(name: str) -> str:
    return filled((SHIPPED_STATIONS / f"{name}.yaml").read_text(encoding="utf-8"))
