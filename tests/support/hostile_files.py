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

import h5py
import numpy as np

MANY = 10 << 30


# ---------------------------------------------------------------- instead of any file


def sparse(path, start=b""):
    with path.open("wb") as file:
        file.write(start)
        file.truncate(MANY)


def fifo(path):
    os.mkfifo(path)


def device(path):
    path.symlink_to("/dev/zero")


def terminal(path):
    path.symlink_to("/dev/ptmx")


def unix_socket(path):
    here = Path.cwd()
    os.chdir(path.parent)  # the names of sockets are short
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(path.name)
    finally:
        os.chdir(here)


def link_to_itself(path):
    path.symlink_to(path.name)


def link_to_nothing(path):
    path.symlink_to("nothing/at/all")


def chain_of_links(path):
    for number in range(60):
        (path.parent / f"link{number}").symlink_to(f"link{number + 1}")
    path.symlink_to("link0")


def one_endless_line(path):
    path.write_bytes(b"a" * 30_000_000)


def random_bytes(path):
    path.write_bytes(np.random.default_rng(7).bytes(100_000))


def gzip_bomb(path):
    path.write_bytes(gzip.compress(bytes(200_000_000), 9))


def deep_json(path):
    path.write_bytes(b"[" * 100_000)


def xml_bomb(path):
    entities = "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(10))
    path.write_text(f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a0 "ha">{entities}]><a>&a10;</a>')


WRONG = {
    "nothing": lambda path: None,
    "empty": lambda path: path.write_bytes(b""),
    "zeros": lambda path: path.write_bytes(bytes(10_000)),
    "one-nul": lambda path: path.write_bytes(b"\0"),
    "random": random_bytes,
    "text": lambda path: path.write_text("Dear reader, this is not what you expect.\n"),
    "utf-16": lambda path: path.write_text("format: starbench\n" * 50, encoding="utf-16"),
    "control": lambda path: path.write_bytes(b"a: \x1b]0;title\x07\x1b[2J\x9b\n"),
    "endless-line": one_endless_line,
    "sparse": sparse,
    "folder": lambda path: path.mkdir(),
    "fifo": fifo,
    "device": device,
    "terminal": terminal,
    "socket": unix_socket,
    "link-to-itself": link_to_itself,
    "link-to-nothing": link_to_nothing,
    "chain-of-links": chain_of_links,
    "gzip-bomb": gzip_bomb,
    "deep-json": deep_json,
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
    "no-size": b"% evt 3.0\n% end\n",
    "evt2": b"% evt 2.0\n% geometry 1280x720\n% end\n" + bytes(1000),
    "evt21": b"% evt 2.1\n% geometry 1280x720\n% end\n" + bytes(1000),
    "evt4": b"% evt 4.0\n% end\n",
    "dat": b"% Data file containing CD events.\n% Version 2\n% Width 1280\n% Height 720\n\x0c\x08"
    + b"\xff" * 800,
    "dat-of-empty-events": b"% Data file containing CD events.\n% Version 2\n% Height 720\n% Width 1280\n\x0c\0"
    + bytes(800),
    "size-0": b"% format EVT3;height=0;width=0\n% end\n",
    "size-huge": b"% format EVT3;height=999999999999;width=999999999999\n% end\n",
    "size-negative": b"% format EVT3;height=-1;width=-1\n% end\n",
    "two-sizes": b"% format EVT3;height=720;width=1280\n% geometry 640x480\n% end\n",
    "endless-header": b"% a b\n" * 200_000,
    "long-line": b"% " + b"x" * 2_000_000,
    "nul-in-header": b"% format EVT3;height=720;width=1280\n% serial_number \0\x1b[2J\n% end\n"
    + words(0x8001),
    "odd-byte": HEADER + words(0x8001, 0x6002) + b"\1",
    "outside": HEADER + words(0x8001, 0x6002, 0x0005, 0x2000 | 2000) * 50,
    "row-outside": HEADER + words(0x8001, 0x6002, 0x07FF, 0x2001) * 50,
    "zero-words": HEADER + bytes(20_000_000),
    "ones": HEADER + b"\xff" * 4_000_000,
    "vectors": HEADER + words(0x8001, 0x6002, 0x0005, 0x3000) + words(0x4FFF) * 100_000,
    "clock-storm": HEADER + words(0x8000, 0x8FFF) * 200_000,
    "triggers-only": HEADER + words(0x8001, 0x6002) + words(0xA000, 0xA001) * 100_000,
    "noise": HEADER + np.random.default_rng(3).bytes(4_000_000),
}

# ---------------------------------------------------------------- lists of events


def _hdf5(path, change):
    with h5py.File(path, "w") as file:
        file.attrs.update(width=1280, height=720)
        file.create_group("header")
        for name in ("t", "x", "y", "p"):
            file.create_dataset(f"events/{name}", data=np.zeros(50, int))
        for name in ("t", "value", "id"):
            file.create_dataset(f"triggers/{name}", data=np.zeros(1, int))
        change(file)


def _instead(name, **settings):
    def change(file):
        del file[name]
        file.create_dataset(name, **settings)

    return change


def _link(link):
    def change(file):
        del file["events"]
        file["events"] = link

    return change


def _bomb(file):
    del file["events/t"]
    made = file.create_dataset("events/t", (50,), "i8", chunks=(50,), compression=9)
    made.id.write_direct_chunk((0,), zlib.compress(bytes(300_000_000), 9))


def _rows(file):
    for name in ("t", "x", "y", "p"):
        _instead(f"events/{name}", shape=(300_000_000,), dtype="i8", chunks=(1 << 20,), compression=9)(file)
        file[f"events/{name}"].id.write_direct_chunk((0,), zlib.compress(bytes(8 << 20)))


def _external(file):
    del file["events/t"]
    file.create_dataset("events/t", (50,), "i8", external=[(b"/etc/passwd", 0, 400)])


def _virtual(file):
    del file["events/t"]
    layout = h5py.VirtualLayout((50,), "i8")
    layout[:] = h5py.VirtualSource("../canary/secret.h5", "events/t", (50,))
    file.create_virtual_dataset("events/t", layout)


def _loop(file):
    del file["events"]
    file["events"] = h5py.SoftLink("/events")


def _late(file):
    file["events/t"][:] = 2**62


def _outside(file):
    file["events/x"][:] = 5000


HDF5 = {
    "external-link": _link(h5py.ExternalLink("../canary/secret.h5", "/events")),
    "external-storage": _external,
    "virtual": _virtual,
    "soft-link-loop": _loop,
    "chunk-bomb": _bomb,
    "row-bomb": _rows,
    "huge-chunk": _instead("events/t", shape=(50,), dtype="i8", chunks=(1 << 28,), maxshape=(None,)),
    "missing-rows": _instead("events/t", shape=(50,), dtype="i8", chunks=(10,)),
    "claims": _instead("events/t", shape=(10**12,), dtype="i8", chunks=(1000,)),
    "text": _instead("events/t", data=[b"a"] * 50),
    "objects": _instead("events/t", shape=(50,), dtype=h5py.string_dtype()),
    "floats": _instead("events/t", data=np.full(50, np.nan)),
    "negative": _instead("events/t", data=np.full(50, -5)),
    "late": _late,
    "outside": _outside,
    "two-dimensions": _instead("events/t", data=np.zeros((50, 50), int)),
    "uneven": _instead("events/t", data=np.zeros(49, int)),
    "no-size": lambda file: file.attrs.clear(),
    "size-text": lambda file: file.attrs.update(width="wide"),
    "size-huge": lambda file: file.attrs.update(width=10**15),
    "many-triggers": _instead("triggers/t", shape=(10**9,), dtype="i8", chunks=(1000,)),
    "scalar": _instead("events/t", data=5),
}


def write_hdf5(path, name):
    _hdf5(path, HDF5[name])


class Opens:
    """Whoever unpickles it makes a folder."""

    def __reduce__(self):
        return os.mkdir, ("executed",)


def _arrays(**other):
    arrays = {name: np.zeros(50, int) for name in ("t", "x", "y", "p")}
    arrays |= {f"trigger_{name}": np.zeros(1, int) for name in ("t", "value", "id")}
    return {**arrays, "size": np.array([1280, 720]), **other}


NPZ = {
    "pickle": lambda: _arrays(t=np.array([Opens()] * 50, object)),
    "no-time": lambda: {name: values for name, values in _arrays().items() if name != "t"},
    "floats": lambda: _arrays(t=np.full(50, np.inf)),
    "negative": lambda: _arrays(t=np.full(50, -1)),
    "late": lambda: _arrays(t=np.full(50, 2**62)),
    "huge-size": lambda: _arrays(size=np.array([2**62, 2**62])),
    "three-sizes": lambda: _arrays(size=np.array([1, 2, 3])),
    "empty-size": lambda: _arrays(size=np.array([], int)),
    "text": lambda: _arrays(t=np.array(["a"] * 50)),
    "matrix": lambda: _arrays(t=np.zeros((50, 2), int)),
    "structured": lambda: _arrays(t=np.zeros(50, [("a", "i8")])),
    "complex": lambda: _arrays(t=np.zeros(50, complex)),
}


def write_npz(path, name):
    if name == "bomb":
        big = np.zeros(60_000_000, "u1")
        np.savez_compressed(path, **_arrays(t=big, x=big, y=big, p=big))
    else:
        with path.open("wb") as file:
            np.savez(file, **NPZ[name]())


# ---------------------------------------------------------------- pictures


def _chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height, rows=0, filling=b"\0"):
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = zlib.compress((b"\0" + filling * width) * rows, 9)
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
    "large.png": png(60_000, 60_000),
    "bomb.png": png(9000, 9000, rows=9000),
    "black.png": png(1280, 720, rows=720),
    "white.png": png(1280, 720, rows=720, filling=b"\xff"),
    "cut.png": png(1280, 720, rows=720)[:60],
    "no-size.png": png(0, 0),
    "one-pixel.png": png(1, 1, rows=1),
    "bad-sum.png": png(64, 64, rows=64)[:-20] + bytes(20),
    "cut.jpg": b"\xff\xd8\xff\xe0\0\x10JFIF\0\1\1\0\0\1\0\1\0\0",
    "huge.jpg": b"\xff\xd8\xff\xc0\0\x11\x08\xff\xff\xff\xff\3\1\x11\0\2\x11\1\3\x11\1\xff\xd9",
    "segments.jpg": b"\xff\xd8" + b"\xff\xe0\0\2" * 50_000,
    "loop.tif": tiff(3, 64, loop=True),
    "pages.tif": tiff(20_000, 4000),
    "huge.tif": tiff(1, 2**31 - 1),
    "no-data.tif": tiff(1, 64),
    "huge.bmp": b"BM" + bytes(16) + struct.pack("<ii", 2**30, 2**30) + bytes(100),
    "huge.pgm": b"P5 999999999 999999999 255\n" + bytes(100),
    "tiny.pgm": b"P5 4 4 255\n" + bytes(16),
}

# ---------------------------------------------------------------- points, passports


def _points(rows):
    return "".join(" ".join(map(str, row)) + "\n" for row in rows)


POINTS = {
    "four-columns": "1 2 3 4\n",
    "words": "a b c d e\n",
    "nan": "nan 2 3 4 5\n",
    "inf": "1 inf 3 4 5\n",
    "huge": "1e300 1e300 1e300 1e300 5\n",
    "underscore": "6_0 2 3 4 5\n",
    "negative-id": "1 2 3 4 -5\n",
    "big-id": "1 2 3 4 1e300\n",
    "same-id": _points([(1, 2, 3, 4, 7)] * 30),
    "one-point": "100 100 0 0 1\n",
    "in-a-line": _points([(n, n, n, n, n) for n in range(100)]),
    "all-at-once": _points([(100, 100, 0, 0, n) for n in range(100)]),
    "many": _points([(n % 1000, n // 1000, n % 1000, n // 1000, n) for n in range(150_000)]),
    "outside": "99999 99999 1 1 1\n" * 3,
    "comments": "# nothing\n" * 1000,
    "hex": "0x10 2 3 4 5\n",
    "digits": "1 2 3 4 " + "9" * 5000 + "\n",
}

PASSPORT = {"format": "starbench/passport/1", "collimator": "x", "terms": ["r"], "values": [255.0]}
PASSPORTS = {
    "list": "[]",
    "wrong-format": json.dumps({**PASSPORT, "format": "x"}),
    "nan": '{"format": "starbench/passport/1", "values": [NaN]}',
    "infinity": '{"format": "starbench/passport/1", "values": [1e999]}',
    "duplicate": '{"format": "a", "format": "starbench/passport/1"}',
    "numbers": "1" * 10_000,
    "null": "null",
    "text": '"text"',
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
_CAMERA = {
    "camera_model": "pinhole",
    "intrinsics": [1800.0, 1800, 640, 360],
    "distortion_model": "radtan",
    "distortion_coeffs": [0, 0, 0, 0],
    "resolution": [1280, 720],
}
_VALUES = {"fx": 1800.0, "fy": 1800.0, "cx": 640.0, "cy": 360.0, "k1": 0.0}


def _results(**changes):
    names = list(_VALUES)
    held = {"camera": _VALUES, "image_size": [1280, 720], "sigma": dict.fromkeys(names, 1.0)}
    return json.dumps({"calibration": {**held, "covariance": {"names": names, "matrix": []}, **changes}})


CAMERAS = {
    "fisheye": json.dumps({**GEOMETRY, "type": "kannala-brandt"}),
    "list-type": json.dumps({**GEOMETRY, "type": ["pinhole"]}),
    "short-k": json.dumps({**GEOMETRY, "K": [1, 2, 3]}),
    "text-k": json.dumps({**GEOMETRY, "K": ["a"] * 9}),
    "number-k": json.dumps({**GEOMETRY, "K": 5}),
    "nan-k": json.dumps(GEOMETRY).replace("1800.0", "NaN"),
    "infinite-k": json.dumps(GEOMETRY).replace("1800.0", "1e999"),
    "null-d": json.dumps({**GEOMETRY, "D": None}),
    "skew": json.dumps({**GEOMETRY, "K": [1800.0, 9, 640, 0, 1800, 360, 0, 0, 1]}),
    "negative-focal": json.dumps({**GEOMETRY, "K": [-1800.0, 0, 640, 0, 1800, 360, 0, 0, 1]}),
    "tiny-focal": json.dumps({**GEOMETRY, "K": [1e-300, 0, 640, 0, 1e-300, 360, 0, 0, 1]}),
    "huge-lens": json.dumps({**GEOMETRY, "D": [1e300] * 5}),
    "no-pixels": json.dumps({**GEOMETRY, "width": 0}),
    "negative-size": json.dumps({**GEOMETRY, "height": -720}),
    "many-pixels": json.dumps({**GEOMETRY, "width": 10**9, "height": 10**9}),
    "infinite-size": json.dumps(GEOMETRY).replace("1280", "1e999"),
    "text-size": json.dumps({**GEOMETRY, "width": "wide"}),
    "extrinsics": json.dumps({"T_slave_master": [{"camera": "b", "rvec": [0, 0, 0], "tvec": [1, 0, 0]}]}),
    "two-cameras": json.dumps({"cam0": _CAMERA, "cam1": _CAMERA}).replace("{", "{ ", 1),
    "chain-of-text": "cam0: text\n",
    "chain-of-numbers": "cam0: 5\n",
    "chain-list": "cam0: [1, 2]\n",
    "other-lens": json.dumps({"cam0": {**_CAMERA, "distortion_model": "fov"}}),
    "omni": json.dumps({"cam0": {**_CAMERA, "camera_model": "omni"}}),
    "list-model": json.dumps({"cam0": {**_CAMERA, "camera_model": [1]}}),
    "list-lens": json.dumps({"cam0": {**_CAMERA, "distortion_model": [1]}}),
    "ros-list-lens": "distortion_model: [a]\ncamera_matrix: {data: [1]}\n",
    "ros-no-data": "distortion_model: plumb_bob\ncamera_matrix: 5\ndistortion_coefficients: 5\n",
    "ros-many": "distortion_model: plumb_bob\ndistortion_coefficients: {data: [0, 0, 0, 0, 0, 0, 0]}\n",
    "opencv-empty": "%YAML:1.0\n---\n",
    "opencv-scalar": "%YAML:1.0\n---\ncamera_matrix: 5\ndistortion_coefficients: 7\n",
    "opencv-torn": "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [1",
    "opencv-claims": "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 1000000000\n   cols: 3\n   dt: d\n"
    "   data: [ 1. ]\n",
    "opencv-not-utf-8": b"%YAML:1.0\n---\ncamera_matrix: \xff\xfe\n",
    "opencv-of-json": '{"camera_matrix": 5, "distortion_coefficients": "x"}',
    "results-empty": '{"calibration": {}}',
    "results-null": '{"calibration": null}',
    "results-text": '{"calibration": "good"}',
    "results-no-matrix": _results(),
    "results-wrong-matrix": _results(covariance={"names": list(_VALUES), "matrix": [[1.0]]}),
    "results-text-value": _results(camera={**_VALUES, "fx": "long"}),
    "results-negative-variance": _results(
        covariance={"names": list(_VALUES), "matrix": (-np.eye(5)).tolist()}
    ),
    "results-infinite-variance": _results(
        covariance={"names": list(_VALUES), "matrix": (1e308 * np.eye(5)).tolist()}
    ),
}

# ---------------------------------------------------------------- XML

_DCC = "https://ptb.de/dcc"
XML = {
    "external-entity": '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><a>&b;</a>',
    "external-dtd": '<?xml version="1.0"?><!DOCTYPE a SYSTEM "file:///dev/zero"><a/>',
    "parameter-entity": '<!DOCTYPE a [<!ENTITY % b SYSTEM "file:///dev/random"> %b;]><a/>',
    "deep-xml": "<a>" * 200_000,
    "wide-xml": "<a>" + "<b/>" * 500_000 + "</a>",
    "attributes": "<a " + " ".join(f'b{n}="1"' for n in range(100_000)) + "/>",
    "long-text": f"<a>{'x' * 20_000_000}</a>",
    "other-root": "<html><body/></html>",
    "only-dcc": f'<digitalCalibrationCertificate xmlns="{_DCC}" schemaVersion="3.2.1"/>',
    "include": '<a xmlns:xi="http://www.w3.org/2001/XInclude"><xi:include href="file:///etc/passwd"/></a>',
    "stylesheet": '<?xml-stylesheet href="file:///etc/passwd"?><a/>',
    "utf-7": '<?xml version="1.0" encoding="UTF-7"?><a/>',
}
