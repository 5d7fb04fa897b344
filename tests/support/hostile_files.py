"""Files that nobody should have to open: empty, cut, endless, pointing elsewhere, standing for gigabytes.

`WRONG` holds what can stand in the place of any file. The other tables hold what is wrong for one kind of file only.
Each entry makes the file at a path; sparse files and compressed ones keep the disk's use small.
"""

import gzip
import json
import os
import socket
import struct
import zlib
from pathlib import Path

import numpy as np

MANY = 10 << 30


# ---------------------------------------------------------------- instead of any file


def sparse(path):
    with path.open("wb") as file:
        file.truncate(MANY)


def unix_socket(path):
    here = Path.cwd()
    os.chdir(path.parent)  # the names of sockets are short
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(path.name)
    finally:
        os.chdir(here)


def chain_of_links(path):
    for number in range(60):
        (path.parent / f"link{number}").symlink_to(f"link{number + 1}")
    path.symlink_to("link0")


def xml_bomb(path):
    entities = "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(10))
    path.write_text(f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a0 "ha">{entities}]><a>&a10;</a>')


WRONG = {
    "nothing": lambda path: None,
    "empty": lambda path: path.write_bytes(b""),
    "zeros": lambda path: path.write_bytes(bytes(10_000)),
    "one-nul": lambda path: path.write_bytes(b"\0"),
    "random": lambda path: path.write_bytes(np.random.default_rng(7).bytes(100_000)),
    "text": lambda path: path.write_text("Dear reader, this is not what you expect.\n"),
    "utf-16": lambda path: path.write_text("format: starbench\n" * 50, encoding="utf-16"),
    "control": lambda path: path.write_bytes(b"a: \x1b]0;title\x07\x1b[2J\x9b\n"),
    "endless-line": lambda path: path.write_bytes(b"a" * 30_000_000),
    "sparse": sparse,
    "folder": lambda path: path.mkdir(),
    "fifo": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "terminal": lambda path: path.symlink_to("/dev/ptmx"),
    "socket": unix_socket,
    "link-to-itself": lambda path: path.symlink_to(path.name),
    "link-to-nothing": lambda path: path.symlink_to("nothing/at/all"),
    "chain-of-links": chain_of_links,
    "gzip-bomb": lambda path: path.write_bytes(gzip.compress(bytes(200_000_000), 9)),
    "deep-json": lambda path: path.write_bytes(b"[" * 100_000),
    "xml-bomb": xml_bomb,
    "huge-number": lambda path: path.write_text('{"r": ' + "9" * 5000 + "}\n"),
}

# ---------------------------------------------------------------- YAML


YAML = {
    "aliases": "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n",
    "tag": "format: !!python/object/apply:os.system ['touch executed']\n",
    "deep": "a: " + "[" * 5000,
    "duplicate": "format: x\nformat: y\n",
    "many-keys": "".join(f"k{n}: 1\n" for n in range(30_000)),
    "long-key": "k" * 900_000 + ": 1\n",
    "documents": "--- {}\n" * 1000,
    "octal": "format: starbench/sequence/1\nname: x\nsteps: [{record: {attempts: 010}}]\n",
    "list": "- 1\n- 2\n",
    "scalar": "just text\n",
    "merge": "<<: {a: 1}\nformat: x\n",
    "surrogate": 'name: "\\ud800"\n',
    "directive": "%YAML 9.9\n---\na: 1\n",
    "tabs": "a:\n\tb: 1\n",
}

# ---------------------------------------------------------------- recordings

HEADER = b"% format EVT3;height=720;width=1280\n% serial_number 7\n% end\n"


def words(*numbers):
    return np.array(numbers, "<u2").tobytes()


RAW = {
    "header-only": HEADER,
    "size-huge": b"% format EVT3;height=999999999999;width=999999999999\n% end\n",
    "endless-header": b"% a b\n" * 200_000,
    "nul-in-header": b"% format EVT3;height=720;width=1280\n% serial_number \0\x1b[2J\n% end\n"
    + words(0x8001),
    "odd-byte": HEADER + words(0x8001, 0x6002) + b"\1",
    "zero-words": HEADER + bytes(20_000_000),
    "ones": HEADER + b"\xff" * 4_000_000,
    "vectors": HEADER + words(0x8001, 0x6002, 0x0005, 0x3000) + words(0x4FFF) * 100_000,
    "clock-storm": HEADER + words(0x8000, 0x8FFF) * 200_000,
    "triggers-only": HEADER + words(0x8001, 0x6002) + words(0xA000, 0xA001) * 100_000,
    "noise": HEADER + np.random.default_rng(3).bytes(4_000_000),
}

# ---------------------------------------------------------------- pictures


def _chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height, rows=0):
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    packed = zlib.compressobj(1)
    data = b"".join(packed.compress(bytes(1 + width)) for _ in range(rows)) + packed.flush()
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", head) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def tiff(pages, side, *, loop=False):
    data, at = b"II*\0" + struct.pack("<I", 8), 8
    for page in range(pages):
        after = at + 2 + 24 + 4
        following = (8 if loop else 0) if page == pages - 1 else after
        data += struct.pack("<H", 2) + struct.pack("<HHII", 256, 4, 1, side)
        data += struct.pack("<HHII", 257, 4, 1, side) + struct.pack("<I", following)
        at = after
    return data


PICTURES = {
    "huge.png": png(2**31 - 1, 2**31 - 1),
    "bomb.png": png(9000, 9000, rows=9000),
    "black.png": png(1280, 720, rows=720),
    "cut.png": png(1280, 720, rows=720)[:60],
    "bad-sum.png": png(64, 64, rows=64)[:-20] + bytes(20),
    "huge.jpg": b"\xff\xd8\xff\xc0\0\x11\x08\xff\xff\xff\xff\3\1\x11\0\2\x11\1\3\x11\1\xff\xd9",
    "segments.jpg": b"\xff\xd8" + b"\xff\xe0\0\2" * 50_000,
    "loop.tif": tiff(3, 64, loop=True),
    "huge.tif": tiff(1, 2**31 - 1),
    "huge.pgm": b"P5 999999999 999999999 255\n" + bytes(100),
}

# ---------------------------------------------------------------- points, passports


def _points(rows):
    return "".join(" ".join(map(str, row)) + "\n" for row in rows)


POINTS = {
    "words": "a b c d e\n",
    "nan": "nan 2 3 4 5\n",
    "huge": "1e300 1e300 1e300 1e300 5\n",
    "negative-id": "1 2 3 4 -5\n",
    "same-id": _points([(1, 2, 3, 4, 7)] * 30),
    "one-point": "100 100 0 0 1\n",
    "in-a-line": _points([(n, n, n, n, n) for n in range(100)]),
    "all-at-once": _points([(100, 100, 0, 0, n) for n in range(100)]),
    "many": _points([(n % 1000, n // 1000, n % 1000, n // 1000, n) for n in range(150_000)]),
    "comments": "# nothing\n" * 1000,
    "digits": "1 2 3 4 " + "9" * 5000 + "\n",
}

PASSPORT = {"format": "starbench/passport/1", "collimator": "x", "terms": ["r"], "values": [255.0]}
PASSPORTS = {
    "list": "[]",
    "nan": '{"format": "starbench/passport/1", "values": [NaN]}',
    "infinity": '{"format": "starbench/passport/1", "values": [1e999]}',
    "duplicate": '{"format": "a", "format": "starbench/passport/1"}',
    "numbers": "1" * 10_000,
    "no-covariance": json.dumps(PASSPORT),
    "deep": '{"a":' * 50_000,
}

# ---------------------------------------------------------------- cameras

GEOMETRY = {
    "type": "pinhole",
    "width": 1280,
    "height": 720,
    "K": [1800.0, 0, 640, 0, 1800, 360, 0, 0, 1],
    "D": [0, 0, 0, 0, 0],
}


CAMERAS = {
    "fisheye": json.dumps({**GEOMETRY, "type": "kannala-brandt"}),
    "nan-k": json.dumps(GEOMETRY).replace("1800.0", "NaN"),
    "infinite-k": json.dumps(GEOMETRY).replace("1800.0", "1e999"),
    "huge-lens": json.dumps({**GEOMETRY, "D": [1e300] * 5}),
    "many-pixels": json.dumps({**GEOMETRY, "width": 10**9, "height": 10**9}),
    "infinite-size": json.dumps(GEOMETRY).replace("1280", "1e999"),
    "opencv-torn": "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [1",
    "opencv-claims": "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 1000000000\n   cols: 3\n   dt: d\n"
    "   data: [ 1. ]\n",
    "opencv-not-utf-8": b"%YAML:1.0\n---\ncamera_matrix: \xff\xfe\n",
    "results-null": '{"calibration": null}',
}
