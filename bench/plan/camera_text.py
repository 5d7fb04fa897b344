"""The text of a calibration file of any program as nested values: YAML, JSON, TOML, XML, Python, COLMAP, INI, MATLAB.

Files come from strangers: sizes and nesting are bounded, and no reader of another program runs on them.
"""

from __future__ import annotations

import ast
import codecs
import configparser
import json
import re
import struct
import tomllib
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as ET

from bench.base.bounded_json import parse_json
from drivers.camera.file_kinds import in_place_of_file
from sequences.yaml_text import MOST_BYTES, parse

_MOST_LEVELS = 40  # Far above camera files; a hostile one ends here
#: The longest text of Python that is read: mrcal adds its measurements to a camera, about 1 MB.
_MOST_CHARACTERS = 5_000_000
_MOST_ENTRIES = 100_000  # Far above camera files; a hostile one ends here
#: A longer list of numbers, in characters, is no part of a camera, but what it was calibrated from.
_LONGEST_LIST = 100_000
_MOST_DOCUMENTS = 100  # Far above camera files; a hostile one ends here
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
#: Files that begin so are no text.
_BINARY = {
    b"MATLAB": "a file of MATLAB (.mat)",
    b"\x93NUMPY": "an array of numpy (.npy)",
    b"PK\x03\x04": "a ZIP archive, such as numpy's .npz",
    b"\x80": "a Python pickle",
    b"\x1f\x8b": "a compressed file (gzip)",
    b"\x89HDF": "an HDF5 file",
    b"% ": "a recording (RAW)",
    b"\x89PNG": "a picture (PNG)",
    b"\xff\xd8\xff": "a picture (JPEG)",
    b"#ROSBAG": "a ROS bag",
    b"SQLite": "a database (SQLite), such as a ROS 2 bag or COLMAP's",
    b"\x89MCAP": "a ROS 2 bag (MCAP)",
}
WRITE_OPENCV = (
    "Write the camera by cv2.FileStorage: camera_matrix, distortion_coefficients, image_width, image_height."
)
_AS_TEXT = {
    b"MATLAB": 'In MATLAB write it as text: writelines(jsonencode(toStruct(cameraParams)), "camera.json").',
    b"% ": "",
    b"#ROSBAG": "Give what `rostopic echo -n 1` prints of its camera_info.",
    b"SQLite": "Give what `ros2 topic echo --once` prints of camera_info, or the cameras.txt of COLMAP's model.",
    b"\x1f\x8b": "Unpack it first.",
    b"\x89MCAP": "Give what `ros2 topic echo --once` prints of its camera_info.",
}
"""How a camera in such a file is written as text, if not by OpenCV."""
_COLMAP_BINARY = re.compile(rb".{2}\0{6}.{2}\0{2}[\0-\x11]\0{3}(?:.{3}\0{5}){2}", re.DOTALL)
"""COLMAP's cameras.bin: number of cameras, number and model of the first one, its width and height."""
_COLMAP_HEAD = struct.Struct("<iiQQ")
"""Of each camera there: its number, its model, width and height; the values follow as doubles."""
_COLMAP_NUMBERS = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION",
    "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR",
)  # fmt: skip
"""Names of its models by their numbers."""
_TOOLBOX = re.compile(r"^(\w+)\s*=\s*\[?([-+.\deE;\s]+)\]?;", re.MULTILINE)
"""A line of numbers of Calib_Results.m."""
_OF_MATLAB = re.compile(rb"^\w+\s*=\s*\[", re.MULTILINE)
"""A line of a file of MATLAB, whose comments begin as a recording does."""
_COMMENT = re.compile(r"^[ \t]*[#;].*", re.MULTILINE)  # of TOML and INI
_TOML = re.compile(r"\A(?:\s|#.*\n)*(?:\[[\w. \"'-]+\]\s*$|\w+\s*=)", re.MULTILINE)
_OTHER_TEXTS = {
    **dict.fromkeys(
        ("Camera-system parameters", "\nReprojection error (cam0)"),
        (
            "it is a report of Kalibr (results-cam.txt, results-imucam.txt)",
            "Give the camchain.yaml that Kalibr writes beside it.",
        ),
    ),
    "\ncam0_calib:": ("it names the files of its cameras", "Give one of those, such as cam0_pinhole.yaml."),
    "\nrelative_config_imucam:": (
        "it names the file of its cameras",
        "Give that, such as kalibr_imucam_chain.yaml.",
    ),
    "\nConfigor:": (
        "it names the files of its cameras",
        "Give one of those, such as cam-intri-pinhole-brown.yaml, or the result (CalibParam).",
    ),
    'Intrinsic of "': ("it is what rs-enumerate-devices prints of a RealSense", WRITE_OPENCV),
    "# hugin project file": ("it is a project of Hugin", WRITE_OPENCV),
    "ParGroup: Cam": ("it is a camera of HALCON, whose lenses are others than OpenCV's", WRITE_OPENCV),
    "<fov_video ": ("it is a calibration of Qualisys, which counts in 1/64 px", WRITE_OPENCV),
    "#polynomial coefficients": ("it is a fisheye of OCamCalib (Scaramuzza)", WRITE_OPENCV),
}
"""Words that only the texts of a program have, what they are, and what to do."""
_OF_NUMPY = ("np.array(", "array([[")
"""Words of Python code and of arrays that numpy printed. Comments may hold them too, so parsers come first."""
_OTHER_ROOTS = {
    "document": "In Metashape save the adjusted calibration alone: Tools, Camera Calibration, Save.",
}
_NUMBERS = re.compile(r"\[([-+.\deE,\s]*)\]")
_NOT_A_NUMBER = re.compile(r"\.(nan|inf)", re.IGNORECASE)  # as YAML writes it
_NO_BLANK = re.compile(r"^([ \t]*[\w.]+):(?=[^\s:])", re.MULTILINE)
"""A name and its value without a blank between, which OpenCV's FileStorage reads, as in ORB-SLAM2's own files."""
_TAB = re.compile(r"(?<=[^\s#])\t+")  # behind a name, which yaml-cpp reads
_BETWEEN = re.compile(r"[][(),;]")  # as numpy, MATLAB and Python print lists
_SEPARATOR = re.compile(r"^(?:---|\.\.\.)(?:[ \t].*)?$", re.MULTILINE)
#: Lines of a message of ROS that differ although the camera is the same.
_TIMES = re.compile(r"^ *(?:seq|secs|nsecs|sec|nanosec): *\d+[ \t]*$", re.MULTILINE)
_COLMAP = re.compile(
    r"^(\d+)[ \t]+([A-Z_]+)[ \t]+(\d+)[ \t]+(\d+)((?:[ \t]+[-+.\deE]+)+)[ \t]*$", re.MULTILINE
)
_YARP = re.compile(r"^\[(CAMERA_CALIBRATION\w*)\]\s*$", re.MULTILINE)
_YARP_COEFFICIENTS = ("k1", "k2", "p1", "p2")
_INI_MATRIX = re.compile(r"^camera matrix\s*$", re.MULTILINE)
#: Numbers of focal lengths and of coefficients of COLMAP's models; the coefficients are in OpenCV's order.
_COLMAP_MODELS = {
    "SIMPLE_PINHOLE": (1, 0), "PINHOLE": (2, 0), "SIMPLE_RADIAL": (1, 1), "RADIAL": (1, 2), "OPENCV": (2, 4),
    "FULL_OPENCV": (2, 8), "SIMPLE_RADIAL_FISHEYE": (1, 1), "RADIAL_FISHEYE": (1, 2), "OPENCV_FISHEYE": (2, 4),
    "SIMPLE_FISHEYE": (1, 0), "FISHEYE": (2, 0),
}  # fmt: skip


class OtherForm(ValueError):
    """A file holds something else than what is wanted: why, as a part of a sentence or a whole one, and what to do."""

    def __init__(self, why: str, remedy: str = "", *, what: str = "") -> None:
        super().__init__(why)
        self.remedy, self.what = remedy, what


def values_of(data: bytes) -> tuple[str, list[dict[str, Any]]]:
    """Return the syntax of a file and its documents, each once, of text, numbers, lists and mappings; or OtherForm."""
    if _COLMAP_BINARY.match(data):
        return "COLMAP", [_colmap_binary(data)]
    text = _text(data)
    if not text:
        raise OtherForm("it is empty")
    for words, (what, remedy) in _OTHER_TEXTS.items():
        if words in text:
            raise OtherForm(what, remedy)
    try:
        return _parsed(text)
    except OtherForm:
        _require_no_python(text)
        raise


def _parsed(text: str) -> tuple[str, list[dict[str, Any]]]:
    for is_syntax, syntax, read in _SYNTAXES:
        if is_syntax(text):
            return syntax, [read(text)]
    return "YAML", _yaml(text)


def _require_no_python(text: str) -> None:
    if any(words in text for words in _OF_NUMPY):
        raise OtherForm("it is Python code, or a print of numpy's arrays", WRITE_OPENCV) from None


def _toolbox(text: str) -> dict[str, Any]:
    """Read Calib_Results.m of the Camera Calibration Toolbox for MATLAB: lines of numbers with a name."""
    return {name: value.replace(";", " ") for name, value in _TOOLBOX.findall(text[:_LONGEST_LIST])}


def _toml(text: str) -> dict[str, Any]:
    if len(text) > MOST_BYTES:
        raise OtherForm("it is too large for a camera")
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise OtherForm(f"it is no complete TOML: {str(error)[:80]}", WRITE_OPENCV) from None


def _is_ini_of_names(text: str) -> bool:
    """Return whether a text looks like TOML, whose parser refuses it although no list is torn."""
    if not _TOML.match(text) or len(text) > MOST_BYTES:
        return False
    lines = _COMMENT.sub("", text)
    if lines.count("[") != lines.count("]"):
        return False
    try:
        tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError):
        return True
    return False


def _ini_of_names(text: str) -> dict[str, Any]:
    """Read INI with a name and its value a line; its lists may have blanks between their numbers."""
    ini = configparser.ConfigParser(interpolation=None)
    try:
        ini.read_string(f"[{ini.default_section}]\n{text}")
    except configparser.Error:
        raise OtherForm("it is no complete TOML, and no INI", WRITE_OPENCV) from None
    values: dict[str, Any] = {name: dict(ini[name]) for name in ini.sections()}
    values = values or dict(ini.defaults())
    _require_no_python(str(values))
    return values


def _text(data: bytes) -> str:
    if in_place := in_place_of_file(data):
        raise OtherForm(f"it is {in_place[0]}", in_place[1])
    for begin, what in _BINARY.items():
        if data.startswith(begin) and not (begin == b"% " and _OF_MATLAB.search(data)):
            raise OtherForm(f"it is {what}, which is not read as a camera", _AS_TEXT.get(begin, WRITE_OPENCV))
    codec = next((codec for mark, codec in _MARKS.items() if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(codec)
    except UnicodeDecodeError:
        raise OtherForm("it is no text in UTF-8", "Write it again as UTF-8.") from None
    if "\0" in text:
        raise OtherForm("it is a binary file", WRITE_OPENCV)
    return text.replace("\r\n", "\n").strip()


def _json(text: str) -> dict[str, Any]:
    try:
        document = parse_json(text)
    except json.JSONDecodeError as error:
        if re.match(r"\{\s*'", text):
            return _python(text)
        raise OtherForm(f"it is no complete JSON: line {error.lineno}, column {error.colno}") from None
    except ValueError as error:  # the sentences of `parse_json`
        raise OtherForm(str(error)) from None
    return _mapping(document)


def _python(text: str) -> dict[str, Any]:
    """Read a Python dictionary, which is how mrcal and many a script write a camera."""
    if len(text) > _MOST_CHARACTERS or text.count(",") > _MOST_ENTRIES:
        raise OtherForm("it is too large for a camera")
    try:
        return _mapping(ast.literal_eval(text.strip()))
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        raise OtherForm("it is no complete dictionary of Python") from None


def _mapping(document: Any) -> dict[str, Any]:
    if isinstance(document, list) and document and all(isinstance(element, dict) for element in document):
        return {"camera": document}
    if isinstance(document, str):
        raise OtherForm(
            "it holds words or numbers without names, as calib.txt of the RPG data sets and camera.txt of DSO do",
            WRITE_OPENCV,
        )
    if not isinstance(document, dict):
        raise OtherForm("it holds no names with values")
    return {str(name): value for name, value in document.items()}


def _yaml(text: str) -> list[dict[str, Any]]:
    """Read YAML, and what OpenCV and ROS write beside it: tags, a first line that YAML has not, several documents."""
    if "tag:yaml.org,2002:python/object" in text or "!!python/object" in text:
        raise OtherForm("it is a dump of Python objects, such as numpy arrays", WRITE_OPENCV)
    spaced = _NO_BLANK.sub(r"\1: ", text) if text.startswith("%YAML:") else text
    body = _TIMES.sub("", _NUMBERS.sub(_as_text, re.sub(r"\A%YAML.*", "", _TAB.sub(" ", spaced))))
    lines, documents = 1, dict[str, int]()
    for document in _SEPARATOR.split(body):
        documents.setdefault(document.strip(), lines + document.count("\n") - document.lstrip().count("\n"))
        lines += document.count("\n")
    if len(body) > MOST_BYTES or len(documents) > _MOST_DOCUMENTS:
        raise OtherForm("it is too large for a camera")
    parsed = [_document(text, line) for text, line in documents.items()]
    return [_mapping(parsed_document) for parsed_document in parsed if parsed_document is not None] or [
        _mapping(None)
    ]


def _as_text(listed: re.Match[str]) -> str:
    """Return a list of numbers as one text, so that thousands of image points are read at once."""
    return f'"{listed[1]}"' if len(listed[1]) < _LONGEST_LIST else '""'


def _document(text: str, line: int) -> Any:
    tree = parse(text.encode(), "", allow_tags=True)
    if tree.faults:
        fault = tree.faults[0]
        why = fault.message.rstrip(".") if tree.complete else "this is no YAML"
        raise OtherForm(f"line {line + fault.line - 1}: {why}")
    return tree.value


def _xml(text: str) -> dict[str, Any]:
    """Read OpenCV's XML: the names of elements are keys, and elements `_` are a list."""
    if text.count("<") > _MOST_ENTRIES:
        raise OtherForm("it is too large for a camera")
    try:
        root = ET.fromstring(text)  # noqa: S314 - it fetches nothing, and expat bounds what entities grow to
    except ET.ParseError as error:
        raise OtherForm(f"it is no complete XML: line {error.position[0]}") from None
    if root.tag not in {"opencv_storage", "calibration"}:  # OpenCV's, and Metashape's
        remedy = _OTHER_ROOTS.get(root.tag, WRITE_OPENCV)
        raise OtherForm(f"it is XML of another program ({root.tag[:40]})", remedy)
    return _mapping(_element(root, _MOST_LEVELS))


def _element(element: ET.Element, levels: int) -> Any:
    if not levels:
        raise OtherForm(f"it is nested deeper than {_MOST_LEVELS} levels")
    children = [(child.tag, _element(child, levels - 1)) for child in element]
    if element.find("_") is not None:
        return [value for _, value in children]
    return dict(children) if children else (element.text or "").strip()


def _ini(text: str) -> dict[str, Any]:
    """Read the INI of ROS's cameracalibrator (ost.txt): sections of names, each with lines of numbers below it."""
    sections: dict[str, Any] = {}
    rows: dict[str, str] = {}
    name = ""
    for line in map(str.strip, text.splitlines()):
        if line.startswith("[") and line.endswith("]"):
            rows = sections.setdefault(line[1:-1], {})
        elif line and line[0] not in "#;":
            if re.fullmatch(r"[-+.\deE\s]+", line):
                rows[name] = f"{rows.get(name, '')} {line}"
            else:
                name = line
    image = sections.pop("image", {})
    return {camera: {**image, **rows} for camera, rows in sections.items()}


def _yarp(text: str) -> dict[str, Any]:
    """Read the INI of event-driven and of iCub: a name, a blank and a value a line.

    event-driven gives the coefficients of a fisheye the names of the others. Only with ``projection`` are they sure.
    """
    cameras: dict[str, Any] = {}
    _, *parts = _YARP.split(text)
    for name, part in zip(parts[::2], parts[1::2], strict=True):
        lines = (line.split(None, 1) for line in part.partition("\n[")[0].splitlines())
        values: dict[str, Any] = {words[0]: words[1].strip() for words in lines if len(words) > 1}
        if "projection" not in values and set(_YARP_COEFFICIENTS) <= set(values):
            values["D"] = " ".join(values.pop(coefficient) for coefficient in _YARP_COEFFICIENTS)
        cameras[name] = values | {"program": "event-driven or iCub"}
    return cameras


def _colmap(text: str) -> dict[str, Any]:
    """Read COLMAP's cameras.txt."""
    return {
        number: colmap_camera(number, model, [width, height], [float(value) for value in listed.split()])
        for number, model, width, height, listed in _COLMAP.findall(text)
    }


def _colmap_binary(data: bytes) -> dict[str, Any]:
    """Read COLMAP's cameras.bin: the same values in binary, one camera after the other."""
    cameras: dict[str, Any] = {}
    at = 8
    for _ in range(int.from_bytes(data[:8], "little")):
        if len(data) < at + _COLMAP_HEAD.size:
            raise OtherForm("it is COLMAP's cameras.bin, and ends before its last camera")
        number, model, width, height = _COLMAP_HEAD.unpack_from(data, at)
        name = _COLMAP_NUMBERS[model] if model < len(_COLMAP_NUMBERS) else f"number {model}"
        focal, count = _COLMAP_MODELS.get(name, (0, 0))
        values = data[at + _COLMAP_HEAD.size :][: 8 * (focal + 2 + count)]
        listed = list(struct.unpack(f"<{len(values) // 8}d", values[: len(values) // 8 * 8]))
        cameras[str(number)] = colmap_camera(str(number), name, [width, height], listed)
        at += _COLMAP_HEAD.size + len(values)
    if at != len(data):
        raise OtherForm("it is COLMAP's cameras.bin, and more bytes follow its last camera")
    return cameras


def colmap_camera(number: str, model: str, size: Sequence[Any], values: Sequence[float]) -> dict[str, Any]:
    """Return a camera of COLMAP: the pixel centres lie at half integers there."""
    if model not in _COLMAP_MODELS:
        raise OtherForm(
            f"COLMAP's model {model[:40]} is not read", "Reconstruct with its model OPENCV or OPENCV_FISHEYE."
        )
    focal, count = _COLMAP_MODELS[model]
    if len(values) != focal + 2 + count:
        raise OtherForm(
            f"COLMAP's model {model} has {focal + 2 + count} values; camera {number} has {len(values)}"
        )
    lengths, (cx, cy), lens = values[:focal], values[focal : focal + 2], values[focal + 2 :]
    return {
        "K": [lengths[0], lengths[-1], cx - 0.5, cy - 0.5],
        "D": [*lens, *[0.0] * (4 - count)],
        "distortion_model": "fisheye" if "FISHEYE" in model else "opencv",
        "image_size": list(size),
    }


_SYNTAXES: Sequence[tuple[Callable[[str], Any], str, Callable[[str], dict[str, Any]]]] = (
    (lambda text: text.startswith("<"), "XML", _xml),
    (lambda text: text.startswith("{"), "JSON", _json),
    (lambda text: "'lensmodel'" in text, "Python", _python),
    (_COLMAP.search, "COLMAP", _colmap),
    (_INI_MATRIX.search, "INI", _ini),
    (_YARP.search, "INI", _yarp),
    (lambda text: {"fc", "cc", "kc"} <= set(_toolbox(text)), "MATLAB", _toolbox),
    (_is_ini_of_names, "INI", _ini_of_names),
    (_TOML.match, "TOML", _toml),
)
"""How a text is recognised, its name, and its reader; any other text is YAML."""


def numbers(value: Any) -> list[float]:
    """Return the numbers of a matrix or a list in any form, row after row. Raises ValueError, TypeError, KeyError."""
    if isinstance(value, Mapping):
        return numbers(value["data"])
    if isinstance(value, str):
        return [float(word) for word in _BETWEEN.sub(" ", _NOT_A_NUMBER.sub(r"\1", value)).split()]
    if isinstance(value, list | tuple):
        return [number for element in value for number in numbers(element)]
    return [float(value)]
