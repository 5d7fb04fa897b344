"""Named rules for what differs between any two runs, even of the same program: times, hashes of them, names of folders.

A rule replaces what varies by its name in angle brackets; it never removes a line, a key or a value. So a time stamp
that is missing, or a word in its place, is still found.
"""

import re
from collections.abc import Iterable

_MONTH = "(?:Jan|Feb|Mar|Apr|May|Jun|Jul|Aug|Sep|Oct|Nov|Dec)"
#: Name of the rule, and what it replaces in every text. The order counts: longer forms first.
TEXT_RULES: dict[str, re.Pattern[str]] = {
    "folder for temporary files": re.compile(r"/[^\s'\"<>:]*?/starbench-[a-z0-9_]{8}(?![\w-])"),
    "time": re.compile(
        r"\b20\d\d-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?(?:Z|[+-]\d\d:\d\d| UTC)?"
        rf"|\b\d{{1,2}} {_MONTH} 20\d\d \d\d:\d\d(?::\d\d)?|\b(?:Mon|Tue|Wed|Thu|Fri|Sat|Sun) \d\d:\d\d(?: UTC)?"
    ),
    "date": re.compile(rf"\b20\d\d-\d\d-\d\d\b|\b\d{{1,2}} {_MONTH} 20\d\d\b"),
    "hash of a recalculation": re.compile(r"(?<=\brun-)[0-9a-f]{8}\b"),
    "hash of a key": re.compile(r"SHA256:[A-Za-z0-9+/]{43}"),
    "public key": re.compile(r"AAAAC3NzaC1lZDI1NTE5[A-Za-z0-9+/=]+"),
    "hash": re.compile(r"\b(?:[0-9a-f]{64}|[0-9a-f]{32}|[0-9a-f]{16})\b"),
    "duration": re.compile(
        r"\b\d+ min (?:\d+ s\b|(?=earlier\b))|(?<= to )\d\d:\d\d\b|\d+\.\d s late in \d+ s|(?<=rehearsed in )\d+ s"
    ),
    "time of day": re.compile(r"^\d\d:\d\d:\d\d UTC"),
    "time left": re.compile(r"\b\d+:\d\d left"),
    "local port": re.compile(r"\b(?:127\.0\.0\.1|localhost):\d{4,5}\b"),
    "process": re.compile(r"\bprocess \d+\b"),
    "time in a state": re.compile(r"(?<=<text class=\"note\")[^<]*(?=</text>)"),
}
#: Keys of JSON objects whose numbers are times, durations or names of processes.
NUMBER_KEYS = re.compile(r"^(t|pid|(.*_)?mono_s|.*_utc|took_s|elapsed_s|hours|working_hours)$")
#: Objects all of whose numbers tell how busy the computer was, or how much was said while a stage moved.
NUMBER_PLACES = re.compile(r"/lateness/(load|longest_s|lost_s)\b|/written-\d+/wire/[^/]+/size$")
#: Events that tell of the computer, not of the run; their entries are left out.
PASSING_EVENTS = frozenset({"computer_busy"})


def normal_text(text: str, folders: Iterable[tuple[str, str]] = ()) -> str:
    """Replace folders of a side by their names, then apply all rules of texts."""
    for path, name in folders:
        text = text.replace(path, f"<{name}>")
    for name, pattern in TEXT_RULES.items():
        text = pattern.sub(f"<{name}>", text)
    return text


def normal_number(place: str, value: object) -> object:
    """A number at a place that holds a time is replaced; its sign and kind are not looked at."""
    key = place.rpartition("/")[2]
    varies = NUMBER_KEYS.match(key) or NUMBER_PLACES.search(place)
    if varies and isinstance(value, int | float) and not isinstance(value, bool):
        return "<number>"
    return value
