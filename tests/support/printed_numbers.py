"""Every number and every text of a certificate, and whether a printed page shows it."""

import json
import re
import unicodedata
from datetime import datetime

from bench.base.bounded_json import leaves

SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
NUMBER = re.compile(r"(?<![\w.])[-\u2212]?\d+(?:\.\d+)?(?:e-?\d{1,3}(?!\w)|·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?(?!\w)")
NOT_PRINTED = ("format", "language", "series", "title", "laboratory.place_kind")
"""Fields for machines; the title stands on the page with the number."""


def fields_of(certificate):
    """Each number and text of a certificate with the path of its field."""
    for path, value in leaves(json.loads(certificate.to_json())):
        yield re.sub(r"\.(\d+)(?=\.|$)", r"[\1]", ".".join(map(str, path))), value


def numbers_of(text):
    """Each number of a text: its value, and half a unit of its last digit."""
    numbers = set()
    for token in NUMBER.findall(text):
        plain, _, power = (
            token.replace("\u2212", "-").replace("·10", "e").translate(SUPERSCRIPTS).partition("e")
        )
        scale = 10.0 ** int(power or 0)
        decimals = len(plain.partition(".")[2])
        digits = len(plain.lstrip("-0.").replace(".", ""))
        numbers.add((float(plain) * scale, 0.5000001 * 10.0**-decimals * scale, digits))
        zeros = (
            0 if decimals else len(plain) - len(plain.rstrip("0"))
        )  # of 2910, the last digit may be rounded
        numbers.add((float(plain) * scale, 0.5000001 * 10.0 ** (zeros - decimals) * scale, digits - zeros))
    return numbers


def missing_numbers(certificate, text):
    """The numbers of a certificate that a text does not show, to two significant digits or better."""
    printed = numbers_of(text)
    return [
        (path, value)
        for path, value in fields_of(certificate)
        if isinstance(value, int | float)
        and not isinstance(value, bool)
        and not _ends_with_its_uncertainty(certificate, path, value)
        and not _shown(path, value, printed)
    ]


def _ends_with_its_uncertainty(certificate, path, value):
    """Whether a result is rounded in its own text, which `missing_texts` looks for, at the digit of its U."""
    place = re.fullmatch(r"(results|further)\[(\d+)\]\.value", path)
    if not place:
        return False
    result = getattr(certificate, place[1])[int(place[2])]
    own = getattr(result, "printed_value", result.text)
    return any(abs(value - shown) <= half for shown, half, _ in numbers_of(own))


def _shown(path, value, printed):
    if path.endswith(".share"):  # in percent, with one decimal; below 0.05 % as "< 0.1"
        return value < 0.0005 or any(abs(100 * value - shown) <= 0.0500001 for shown, _, _ in printed)
    if path.endswith(".p"):
        value *= 100
    return any(
        value == shown or (digits >= 2 and abs(value - shown) <= half) for shown, half, digits in printed
    )


def missing_texts(certificate, text):
    """The texts of a certificate that a text does not show; spaces and line breaks do not matter."""
    squashed = squash(text)
    return [
        (path, value)
        for path, value in fields_of(certificate)
        if isinstance(value, str)
        and path not in NOT_PRINTED
        and not re.search(
            r"(statements|further)\[\d+\]\.id$|deviations\[\d+\]\.source$|results\[\d+\]\.text$", path
        )
        and squash(_as_printed(value)) not in squashed
    ]


def _as_printed(value):
    if re.fullmatch(r"\d{4}-\d\d-\d\dT[\d:.]+Z", value):
        return f"{datetime.fromisoformat(value):%Y-%m-%d %H:%M:%S} UTC"
    return {"run": "recorded by the run", "laboratory": "stated by the laboratory"}.get(value, value)


def squash(text):
    """A text without spaces, ligatures, case and kinds of minus."""
    text = re.sub(r"\^(\d)", r"\1", text)
    return "".join(unicodedata.normalize("NFKC", text).replace("\u2212", "-").split()).casefold()


def texts_of(document):
    """Each text of a document as the layout gets it."""
    return [text for _, text in leaves(document) if isinstance(text, str)]
