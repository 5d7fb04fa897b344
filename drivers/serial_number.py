"""Serial numbers: some drivers of a maker print hexadecimal digits as capitals, others as small letters."""


def is_same_serial(first: str, second: str) -> bool:
    """Return whether two texts are one serial number.

    >>> is_same_serial("00CA51", "00ca51")
    True
    """
    return first.casefold() == second.casefold()
