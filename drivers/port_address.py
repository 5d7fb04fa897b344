"""Addresses of ports and video sources: which URLs a station file may name. Opens nothing.

pyserial and FFmpeg know many more kinds of URL than devices need. Some of them write files (``spy://``), read files,
or choose a device by a search. So only the kinds that reach a device are accepted.
"""

from __future__ import annotations

import re
from typing import Final

PORT_SCHEMES: Final = ("socket", "rfc2217")
"""Kinds of URL that a serial port may have: a device server on the network."""
SOURCE_SCHEMES: Final = ("rtsp", "rtsps", "http", "https", "tcp", "udp", "rtp")
"""Kinds of URL that a video source may have: a camera on the network."""

PORT_REMEDY: Final = "Name a device file, socket://host:port or rfc2217://host:port."
SOURCE_REMEDY: Final = "Name a video device, a video file, or a URL (rtsp, http, tcp)."

_LONGEST: Final = 20  # What follows may be a password that was pasted
_PROTOCOL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)(?:[,:])")  # a single letter is a drive of Windows


def refused_port(address: str) -> str | None:
    """Return why an address cannot be a serial port (`PORT_REMEDY`: what to write instead); None if it may be one.

    >>> refused_port("/dev/ttyUSB0"), refused_port("socket://10.0.0.7:4001")
    (None, None)
    >>> refused_port("spy:///dev/null?file=notes.txt")
    'a port cannot be a URL of the kind spy://.'
    """
    scheme, colons, _ = address.partition("://")
    if not colons or scheme.lower() in PORT_SCHEMES:
        return None
    return f"a port cannot be a URL of the kind {scheme[:_LONGEST]}://."


def refused_source(name: str) -> str | None:
    """Return why a number, path or URL cannot be a video source (`SOURCE_REMEDY`: what instead); None if it may be.

    >>> refused_source("/dev/video0"), refused_source("0"), refused_source("rtsp://10.0.0.8/stream")
    (None, None, None)
    >>> refused_source("concat:a.mp4|b.mp4")
    'a video source cannot be of the kind concat:.'
    """
    protocol = _PROTOCOL.match(name)
    if protocol is None or protocol[1].lower() in SOURCE_SCHEMES:
        return None
    return f"a video source cannot be of the kind {protocol[1][:_LONGEST]}:."
