"""How programs lay out a camera in a file: each layout becomes values with OpenCV's names, units and pixel centres.

Names are compared without case and punctuation. A layout has other names than OpenCV, another order, or another
origin of the pixels. The cameras of some programs are not read; the refusal then names the program.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from bench.plan.camera_text import WRITE_OPENCV, OtherForm, colmap_camera
from bench.plan.camera_trees import cameras_in_tree
from bench.plan.camera_values import (
    ALIKE_A_COEFFICIENT,
    CALIBRATE_ANEW,
    LENS,
    LONGEST_NAME,
    MODEL,
    is_like_a_lens,
    plain_name,
    states_a_matrix,
)
from bench.plan.stated_values import Values, listed, numbers_of
from calib.model.lens import FISHEYE

_MOST_NAMED = 10
"""Names that a message shows."""
_FOUR: Final = ("fx", "fy", "cx", "cy")
_HALF_PX, _ONE_PX = 0.5, 1.0
"""Coordinate of the centre of the first pixel: with an origin at its corner, and where counting begins at 1."""
_PREFIXES = {"camera": "ORB-SLAM", "camera1": "ORB-SLAM", "camera2": "ORB-SLAM", "cam": "vikit"}
"""Before each name of a camera, such as ``Camera1.fx`` and ``cam_fx``, and whose they are."""
_AT_END = re.compile(r"(.*?[a-z])(\d{1,2})")
_PAIRS = (("left", "right"), ("l", "r"))
"""Before or after each name of a camera; both are there."""
_OF_VIKIT = ("d0", "d1", "d2", "d3", "d4")
"""Coefficients of vikit, of which the last one may be missing."""
_MATRICES = re.compile("(camera)?(intrinsics?|matrix|parameters|params)|projectionparameters|pinhole|k")
_WORDS = re.compile(r"[A-Za-z][A-Za-z _.-]{3,}\d?")  # no list of numbers, nor one of NaN
_FOUR_ELSEWHERE = (set(_FOUR), {"mu", "mv", "u0", "v0"}, {"fx", "fy", "ppx", "ppy"})
_BEYOND_OPENCV = ("k4", "p3", "p4")
"""Metashape's coefficients of r^8, and of the growth of the tangential terms."""
_FISHEYE_OF_MATLAB = frozenset({"FocalLength", "PrincipalPoint", "ImageSize", "DistortionCoefficients", "K"})
"""All public names of cameraIntrinsicsKB: other programs use some of them too."""
_MODELS_WITH_COEFFICIENTS = ("distortionmodel", "lensmodel", "distmodel")
"""Names of a lens model, below which some programs write its coefficients."""
_NAMES_OF_COEFFICIENTS = ("parameters", "params", "coefficients", "coeffs")

#: Names that only a program has whose cameras are not read.
_FOREIGN = {
    "value0": "Basalt or another program that uses cereal",
    "projectiontype": "OpenSfM",
    **dict.fromkeys(("initializationmode", "pxinitialfocallength"), "AliceVision (Meshroom)"),
    "calibrationinformation": "Azure Kinect",
    "cameraanglex": "Blender",
    "radialdistortion": "a program that writes radial and tangential coefficients apart",
}
#: Names of coefficients of a lens that OpenCV's two models are not.
_OTHER_LENSES = {
    "polyparameters": "camodocal's Scaramuzza",
    "xi": "an omnidirectional or double-sphere camera",
    "mappingcoefficients": "MATLAB's fisheye (Scaramuzza)",
}


@dataclass(frozen=True)
class _Layout:
    """How one program writes a camera."""

    program: str  # in words
    marks: frozenset[str]  # Plain names that the program has, and no other
    names: Mapping[str, str] = field(default_factory=dict)  # A plain name there: the name here
    first_pixel: float = 0.0  # Coordinate of the centre of the first pixel there, px
    change: Callable[[dict[str, Any]], dict[str, Any]] = dict
    applies: Callable[[Values], bool] = lambda _: True  # What must hold beside the marks


def _of_matlab(values: dict[str, Any]) -> dict[str, Any]:
    """Return MATLAB's camera: height before width, matrix in either order, 2 or 3 radial coefficients or a fisheye."""
    matrix = numbers_of("the camera matrix", values.pop("k", values.pop("intrinsicmatrix", [])))
    if "focallength" in values:
        focal, middle = values.pop("focallength"), values.pop("principalpoint")
        fx, fy, cx, cy = [*numbers_of("FocalLength", focal), *numbers_of("PrincipalPoint", middle)]
    elif any(matrix[6:8]):  # column after column, as IntrinsicMatrix is
        fx, _, _, skew, fy, _, cx, cy, _ = matrix
        values.setdefault("skew", skew)
    else:
        fx, skew, cx, _, fy, cy, *_ = matrix
        values.setdefault("skew", skew)
    lens: dict[str, Any] = {"distortionmodel": "fisheye"}  # of cameraIntrinsicsKB
    if "radialdistortion" in values:
        radial = numbers_of("RadialDistortion", values.pop("radialdistortion"))
        tangential = numbers_of("TangentialDistortion", values.pop("tangentialdistortion", [0.0, 0.0]))
        coefficients = [*radial[:2], *tangential, *radial[2:]]
        lens = {"distortioncoefficients": coefficients, "distortionmodel": "plumb_bob"}
    return values | {
        **dict(zip(_FOUR, (fx, fy, cx, cy), strict=True)),
        "imagesize": numbers_of("the size of the image", values["imagesize"])[::-1],
        **lens,
    }


def _is_fisheye_of_matlab(values: Values) -> bool:
    """Return whether a camera has four coefficients and names no lens model, as cameraIntrinsicsKB does."""
    lenses = listed(values, ("distortioncoefficients",)).values()
    counts = [len(numbers_of("the distortion", lens)) for lens in lenses]
    return counts == [len(FISHEYE)] and not any(map(MODEL.fullmatch, values))


def _of_metashape(values: dict[str, Any]) -> dict[str, Any]:
    """Return Metashape's camera: p1 and p2 interchanged, principal point from the middle, affinity b1 and b2."""
    if values["projection"] != "frame":
        raise OtherForm(
            f"Metashape's projection {str(values['projection'])[:LONGEST_NAME]!r} is not read", CALIBRATE_ANEW
        )
    if beyond := [name for name in _BEYOND_OPENCV if any(numbers_of(name, values.pop(name, 0.0)))]:
        raise OtherForm(
            f"Metashape's coefficient {beyond[0]} is a term that OpenCV's lens does not have",
            "In Metashape keep K4, P3 and P4 at zero, optimize the camera again, and save it.",
        )
    names = ("f", "width", "height", "cx", "cy", "b1", "b2", "p1", "p2")
    f, width, height, cx, cy, b1, b2, p1, p2 = (numbers_of(name, values.pop(name, 0.0))[0] for name in names)
    return values | {
        "fx": f + b1, "fy": f, "cx": width / 2 + cx, "cy": height / 2 + cy, "skew": b2, "p1": p2, "p2": p1,
        "imagesize": [width, height],
    }  # fmt: skip


def _of_photoscan(_values: dict[str, Any]) -> dict[str, Any]:
    """Refuse a camera of Metashape's predecessor: its p1 and p2 were interchanged in one of its versions."""
    raise OtherForm(
        "it is a calibration of PhotoScan before 1.2, whose p1 and p2 have another meaning than later",
        "Load it in Metashape and save it again.",
    )


def _of_pycolmap(values: dict[str, Any]) -> dict[str, Any]:
    """Return the camera of a dictionary of pycolmap; its values are those of a line of cameras.txt."""
    model = str(values.pop("model", values.pop("modelname", "")))
    listed = numbers_of("params", values.pop("params"))
    size = numbers_of("the size of the image", [values["width"], values["height"]])
    camera = colmap_camera(str(values.get("cameraid", "")), model, size, listed)
    return values | {plain_name(name): value for name, value in camera.items()}


def _of_toolbox(values: dict[str, Any]) -> dict[str, Any]:
    """Return the camera of the Camera Calibration Toolbox for MATLAB, whose skew is a share of fx."""
    fx, fy, cx, cy = [*numbers_of("fc", values["fc"]), *numbers_of("cc", values["cc"])]
    skew = fx * numbers_of("alpha_c", values.get("alphac", 0.0))[0]
    return values | {**dict(zip(_FOUR, (fx, fy, cx, cy), strict=True)), "skew": skew}


#: In the order in which they are tried.
_LAYOUTS = (
    _Layout("RealSense", frozenset({"ppx", "ppy"}), {"ppx": "cx", "ppy": "cy", "coeffs": "distcoeffs"}),
    _Layout(
        "camodocal",
        frozenset({"mu", "mv", "u0", "v0"}),
        {"mu": "fx", "mv": "fy", "u0": "cx", "v0": "cy"}
        | {f"k{power}": f"k{power - 1}" for power in range(2, 6)},
    ),
    _Layout(
        "nerfstudio",
        frozenset({"flx"}),
        {"flx": "fx", "fly": "fy"},
        _HALF_PX,
        lambda values: {"fy": values["fx"], **values},
    ),
    _Layout("pycolmap", frozenset({"params", "width", "height"}), change=_of_pycolmap),
    _Layout("aniposelib", frozenset({"matrix", "distortions", "size"}), {"matrix": "cameramatrix"}),
    _Layout("MATLAB", frozenset({"RadialDistortion", "ImageSize"}), {}, _ONE_PX, _of_matlab),
    _Layout("MATLAB", _FISHEYE_OF_MATLAB, {}, _ONE_PX, _of_matlab, _is_fisheye_of_matlab),
    _Layout("Metashape", frozenset({"projection", "f", "width"}), {}, _HALF_PX, _of_metashape),
    _Layout("PhotoScan", frozenset({"projection", "fx", "skew", "k1"}), change=_of_photoscan),
    _Layout(
        "the Camera Calibration Toolbox for MATLAB",
        frozenset({"fc", "cc", "kc"}),
        {"nx": "width", "ny": "height"},
        change=_of_toolbox,
    ),
)


def plain(content: Values) -> dict[str, Any]:
    """Return values by their names without case and punctuation."""
    return {plain_name(name): value for name, value in content.items()}


def cameras_of(content: Values) -> dict[str, Values]:
    """Return the cameras of a file by name, each as values by plain names; a camera that is alone may have no name."""
    if deep := cameras_in_tree(content):
        return deep
    values = _laid_out(content)
    if states_a_matrix(values):
        return {"": values}
    cameras = _numbered(values) | _of_basalt(values)
    if cameras:
        return cameras
    # Coefficients may stand beside the camera's part of a file.
    shared = {
        key: value
        for key, value in values.items()
        if is_like_a_lens(key) or not isinstance(value, Mapping | list)
    }
    for name, part, is_listed in _parts(content):
        below = cameras_of(part) or ({"": plain(part)} if re.fullmatch(r"cam\d+", name) else {})
        for own_name, camera in below.items():
            known = name if is_listed and len(below) == 1 else own_name or name
            cameras[f"{name}.{own_name}" if known in cameras else known] = {**shared, **camera}
    return cameras


def _parts(content: Values) -> Iterator[tuple[str, Values, bool]]:
    """Yield what may be cameras one level below: name, values, and whether it stands in a list and has a number."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield name, value, False
        elif isinstance(value, list):
            yield from (
                (f"{name}{at}", part, True) for at, part in enumerate(value) if isinstance(part, Mapping)
            )


def chosen(cameras: Mapping[str, Values], name: str | None) -> Values:
    """Return the camera of a name, or the only one; no values if there is none. Raises OtherForm if it is not clear."""
    listed = ", ".join(camera[:LONGEST_NAME] for camera in list(cameras)[:_MOST_NAMED])
    if name is not None and name not in cameras:
        if list(cameras) == [""]:
            raise OtherForm("it holds one camera without a name", "Leave out --camera.")
        raise OtherForm(f"it has no camera {name!r}", f"It holds {listed or 'none'}.")
    if name is None and len(cameras) > 1:
        raise OtherForm(
            f"it holds {len(cameras)} cameras",
            "Name one with --camera, or copy it to a file of its own.",
            what=f"The file holds {len(cameras)} cameras: {listed}.",
        )
    return cameras[name] if name is not None else next(iter(cameras.values()), {})


def _laid_out(content: Values) -> dict[str, Any]:
    """Return values by OpenCV's names, in its units; those that the layout changes are changed."""
    values = _flat(plain(content))
    for key, lens in _OTHER_LENSES.items():
        if key in values:
            raise OtherForm(f"its lens is that of {lens}, which is not read", CALIBRATE_ANEW)
    exact = set(map(str, content))
    layout = next(
        (a for a in _LAYOUTS if (a.marks <= set(values) or a.marks <= exact) and a.applies(values)), None
    )
    if layout is not None:
        values = _renamed(values, layout)
    else:
        for key, program in _FOREIGN.items():
            if key in values and not (key == "value0" and _of_basalt(values)):
                raise OtherForm(f"it is a file of {program}, which is not read", WRITE_OPENCV)
    if set(_FOUR) <= set(values):
        values["intrinsics"] = [values[name] for name in _FOUR]
    if "focallength" in values and "principalpoint" in values:
        values["cameramatrix"] = [values["focallength"], values["principalpoint"]]
    return values


def _renamed(values: dict[str, Any], layout: _Layout) -> dict[str, Any]:
    """Return the values of a layout by OpenCV's names, in its units."""
    # A new name must not meet an old one: k2 becomes k1, and k3 becomes k2.
    kept = {name: value for name, value in values.items() if name not in layout.names}
    moved = {layout.names[name]: value for name, value in values.items() if name in layout.names}
    renamed = layout.change(kept | moved) | {"program": layout.program}
    for name in ("cx", "cy") if layout.first_pixel else ():
        renamed[name] = numbers_of(name, renamed.get(name))[0] - layout.first_pixel
    return renamed


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    """Return values with those of a matrix or of a lens that stand one level below among them."""
    flat = dict(values)
    for name, part in values.items():
        if LENS.fullmatch(name) and isinstance(part, str) and _WORDS.fullmatch(part):
            del flat[name]
            flat.setdefault("distortionmodel", part)
        if not isinstance(part, Mapping) or "data" in part:
            continue
        inner = plain(part)
        if LENS.fullmatch(name) or name in _MODELS_WITH_COEFFICIENTS:
            del flat[name]
            coefficients = next((inner.pop(key) for key in _NAMES_OF_COEFFICIENTS if key in inner), None)
            model = inner.pop("type", inner.pop("model", None))
            own = {"distortioncoefficients": coefficients, "distortionmodel": model}
            own |= {_of_lens(key, name): value for key, value in inner.items()}
        elif _MATRICES.fullmatch(name) and any(four <= set(inner) for four in _FOUR_ELSEWHERE):
            del flat[name]
            own = inner | ({"program": "camodocal"} if name == "projectionparameters" else {})
        else:
            continue
        for key, value in own.items():
            if value is not None and flat.setdefault(key, value) != value:
                raise OtherForm(f"it states {key[:LONGEST_NAME]!r} twice, with different values")
    return flat


def _of_lens(key: str, lens: str) -> str:
    """Return the name of a number below a lens; an unknown one keeps the name of the lens: ``distortion_rk1``."""
    return key if ALIKE_A_COEFFICIENT.fullmatch(key) or not key[-1:].isdigit() else lens + key


def _numbered(values: dict[str, Any]) -> dict[str, Values]:
    """Return cameras whose names have a prefix, a side or a number: ORB-SLAM's, M1 and D2 of OpenCV's stereo."""
    cameras: dict[str, Values] = {}
    prefixes = [prefix for prefix in _PREFIXES if all(f"{prefix}{name}" in values for name in _FOUR)]
    for prefix in prefixes:
        own = _without(prefix.rstrip("12"), values) | _without(prefix, values)
        if set(_OF_VIKIT[:4]) <= set(own):
            own["distcoeffs"] = [own.pop(name) for name in _OF_VIKIT if name in own]
            own["distortionmodel"] = (
                "radtan" if plain_name(own.get("model")) == "pinhole" else own.get("model")
            )
        camera = _laid_out(values | own) | {"program": _PREFIXES[prefix]}
        cameras[prefix if len(prefixes) > 1 else ""] = camera
    for number, own in _by_number(values).items():
        if states_a_matrix(own):
            if "s" in own:  # KITTI's S_00
                own["imagesize"] = own.pop("s")
            cameras[number] = {**values, **own}
    for names in _PAIRS:
        pair = {name: _of_side(name, values) for name in names}
        if all(map(states_a_matrix, pair.values())):
            cameras |= {name: {**values, **own} for name, own in pair.items()}
    if "" in cameras and len(cameras) > 1:
        cameras[prefixes[0]] = cameras.pop("")
    return cameras


def _by_number(values: Values) -> dict[str, dict[str, Any]]:
    """Return the values whose names end in a number, by it, without a number that is a coefficient, such as k1."""
    numbered: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        match = _AT_END.fullmatch(key)
        is_word = isinstance(value, str) and len(value.split()) == 1
        if match and not (is_word and ALIKE_A_COEFFICIENT.fullmatch(key)):
            numbered.setdefault(match[2], {})[match[1]] = value
    return numbered


def _of_side(name: str, values: Values) -> dict[str, Any]:
    """Return the values of one camera of a pair: ``LEFT.K`` of ORB-SLAM2, ``K_left`` of stella_vslam, ``mtxL``."""
    return _without(name, values) | {
        key.removesuffix(name): value for key, value in values.items() if key.endswith(name)
    }


def _without(prefix: str, values: Values) -> dict[str, Any]:
    return {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}


def _of_basalt(values: Values) -> dict[str, Values]:
    """Return the cameras of Basalt's calibration.json: intrinsics and resolutions in two lists."""
    inner = plain(values["value0"]) if isinstance(values.get("value0"), Mapping) else {}
    listed, sizes = inner.get("intrinsics"), inner.get("resolution")
    if not isinstance(listed, list) or not isinstance(sizes, list) or len(listed) != len(sizes):
        return {}
    return {
        f"cam{at}": _laid_out({**camera, "resolution": size}) | {"program": "Basalt"}
        for at, (camera, size) in enumerate(zip(listed, sizes, strict=True))
        if isinstance(camera, Mapping)
    }
