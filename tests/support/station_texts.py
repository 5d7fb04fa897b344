"""Station files as texts, for tests that change them."""

import re

from bench.stations.station import SHIPPED_STATIONS, Station
from sequences.reader import check_document


def without(text: str, *sections: str) -> str:
    """The text of a station file without some sections and the comments directly before them."""
    for name in sections:
        text, replaced = re.subn(rf"(?m)(^#.*\n)*^{name}:.*\n((?=[ #]).*\n|\n(?= ))*", "", text)
        assert replaced == 1, name
    return text


def document_of(text: str):
    """The text of a station file, read; where it has faults, they are raised."""
    return check_document(text.encode(), "station.yaml", Station)


def station_of(text: str) -> Station:
    return document_of(text).value


IDEAL = (SHIPPED_STATIONS / "simulated_ideal.yaml").read_text(encoding="utf-8")
#: The ideal bench, with nothing stated about its collimator, gimbal and target: the views alone decide.
PLAIN = (
    without(IDEAL, "collimator", "gimbal", "budget") + "collimator: {serial: simulated, nominal_r_mm: 255}\n"
)
