"""Wire logs: all that went over the serial lines, byte for byte, without what a faster computer does more often.

While a stage moves, its position is asked until it has arrived: how often, and what it answers on its way, is a matter
of time. So of the questions between two commands each counts once, with its last answer, in the order of their first.
Zaber's messages are numbered, and the number is in the checksum: both are left out. After an urgent stop the driver
drops what still comes in, so only the first answer counts.
"""

import json
import re
from collections.abc import Iterable, Iterator

_ZABER = re.compile(r"^([/@!]\d+ \d)(?: \d\d)?\b([^:\r\n]*):[0-9A-F]{2}(?=\r?$)", re.MULTILINE)
_URGENT_STOP = re.compile(r"^/0 0 stop\n$")
_QUESTION = re.compile(
    r"^/\d+ \d( get \S+| warnings)?\n$"  # Zaber
    r"|^[A-Z*:]+\?\n$"  # SCPI
    r"|^\?$|^\$[$#GI]?\n$"  # GRBL
)


def exchanges(lines: Iterable[str]) -> dict[str, list[tuple[str, str]]]:
    """Each line's requests with their answers, in order, without numbers of messages."""
    ports: dict[str, list[list[str]]] = {}
    for line in lines:
        event = json.loads(line)
        if "bytes" not in event:
            ports.setdefault("notes", []).append([json.dumps({**event, "t": 0}, sort_keys=True), ""])
            continue
        port = ports.setdefault(event["port"].rpartition("/")[2], [])
        if event["dir"] == ">":
            port.append([event["bytes"], ""])
        else:
            if not port:
                port.append(["", ""])
            port[-1][1] += event["bytes"]
    return {port: [_plain(sent, got) for sent, got in all_] for port, all_ in ports.items()}


def without_repeats(pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    """One text an exchange; of the questions between two commands, each once, with its last answer."""
    asked: dict[str, str] = {}
    for sent, got in pairs:
        if _QUESTION.match(sent):
            asked[sent] = got
            continue
        yield from (f"{question!r} -> {answer!r}" for question, answer in asked.items())
        asked.clear()
        yield f"{sent!r} -> {got!r}"
    yield from (f"{question!r} -> {answer!r}" for question, answer in asked.items())


def _plain(sent: str, got: str) -> tuple[str, str]:
    if _URGENT_STOP.match(sent):
        got = got.partition("\n")[0]
    return _ZABER.sub(r"\1\2", sent), _ZABER.sub(r"\1\2", got)
