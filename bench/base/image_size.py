"""The size of an image or of a sensor, as options state it."""

from __future__ import annotations

import re

from bench.base.errors import UsageError


def parse_image_size(text: str | None, where: str = "--image-size") -> tuple[int, int] | None:
    """Return width and height, px, of an option WIDTHxHEIGHT; None if it is not given."""
    if text is None:
        return None
    size = re.fullmatch(r"([1-9]\d{0,5})[xX]([1-9]\d{0,5})", text.strip())
    if size is None:
        raise UsageError(
            f"{text!r} is not an image size.",
            where=where,
            remedy="Write it as WIDTHxHEIGHT: 1280x720.",
        )
    return int(size[1]), int(size[2])
