"""One camera from the values of a calibration file, which have names without case and punctuation.

Coefficients have names, or the order of their lens model.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from bench.plan.camera_text import OtherForm, numbers
from bench.plan.possible_camera import require_possible_camera
from bench.plan.stated_values import OF_OTHER_FORM, Values, agreed, listed, numbers_of, size_of_values
from calib.model.camera import PINHOLE, SKEW, CameraModel
from calib.model.lens import FISHEYE, OPENCV, OPENCV_LENGTHS

Array = NDArray[np.float64]
LensFamily = Literal["brown", "fisheye"]

LONGEST_NAME: Final = 40
"""Characters of a name that a message shows."""
_ALIKE_PX = 0.01
"""Two readings of a file are one if they project less apart than this: a tenth of what the best calibration states."""
_LEAST_SKEW_PX = 1e-9  # Less is rounding
_MOST_SKEW = 0.05  # Share of the focal length
_LEAST_NAMED = 5
"""Coefficients of OpenCV that are kept by name although they are zero."""
_OF_MATRIX = 9  # 3 x 3
_WITH_A_COLUMN = (12, 16)
"""Numbers of a matrix that has a fourth column, and row, of zeros."""
#: Names without case and punctuation, as programs write them.
_MATRIX = (
    "cameramatrix", "k", "mtx", "cameramat", "intrinsicmatrix", "intrinsics", "intrinsic", "m", "camk", "cammatrix",
    "cameraintrinsics", "cameraintrinsic", "intrinsicsmatrix",
)  # fmt: skip
_AFTER = "(coef|coefs|coeffs?|coefficients?|params?|parameters?|factors?|vect?|vector)?"
LENS = re.compile(f"(lens|camera|cam)?(d|dist|distortions?){_AFTER}|kc|coeffs")
"""Names of the coefficients of a lens."""
_LIKE_A_LENS = re.compile(".*(dist(?!an)|coef|radial|tangential|lens)")
"""Names that may be those of coefficients."""
_BESIDE = re.compile(
    f"((lens|camera|cam|k|d|dist|distortions?)?{_AFTER}((thin)?prism|radial|tangential|radialtangential)"
    "|(lens|dist|distortion)?tilt(ed)?)"
    rf"(dist|distortions?)?{_AFTER}((?<!tilt)\d+)?"
)
"""Names of those that some programs write beside the others; ``tilt1`` is a pose."""
MODEL = re.compile(
    "(distortion|dist|lens|camera|cam|projection|calibration|usefisheye|fisheye)?model(type)?"
    "|(distortion|dist|lens|camera|projection)type|(use|is)?fisheye"
)
_OF_CAMERA = ("cameramodel", "cameratype", "cammodel", "camtype")
"""Of these names, those that may as well have the name of the camera."""
_EQUIDISTANT = (
    "equidistant", "equi", "fisheye", "opencvfisheye", "pinholeequidistant", "equidistantcamera", "kannalabrandt",
    "kannalabrandt4", "kannalabrandt8", "kb4",
)  # fmt: skip
_WITHOUT = (
    "none", "nodistortion", "pinholenodistortion", "lensmodelpinhole", "inversebrownconrady", "modifiedbrownconrady",
)  # fmt: skip
"""Lens models of which only coefficients of zero are read."""
_PICTURES = ("gray", "rgb", "graydepth", "rgbdepth", "mono", "color", "frame", "event", "dvs")
"""What ``camera_type`` is in files of OKVIS and of DSEC: it says nothing of the lens."""
_STATES_ALL = "RealSense"
"""A program whose files hold coefficients of zero too; most leave them out."""
_MASKED = "camodocal"
"""A program whose files belong to VINS: ``fisheye`` there asks for a round mask, and ``model_type`` has the lens."""
#: Coefficients of each lens model, by its name in any program; None: the name says nothing of the distortion.
_LENSES: Mapping[str, tuple[str, ...] | None] = {
    **dict.fromkeys(
        ("plumbbob", "radialtangential", "radtan5", "lensmodelopencv5", "rectilinear", "standard"), OPENCV[:5]
    ),
    **dict.fromkeys(("radtan", "radtan4", "pinholeradialtangential", "lensmodelopencv4"), OPENCV[:4]),
    **dict.fromkeys(
        ("lensmodelopencv8", "radtan8", "pinholeradtan8", "radialtangential8", "pinholefull", "rational"),
        OPENCV[:8],
    ),
    "lensmodelopencv12": OPENCV[:12],
    **dict.fromkeys(("rationalpolynomial", "opencv", "brown", "brownconrady"), OPENCV),
    **dict.fromkeys(_EQUIDISTANT, FISHEYE),
    **dict.fromkeys(_WITHOUT, ()),
    **dict.fromkeys(("pinhole", "simplepinhole", "perspective", "rectified"), None),
    **dict.fromkeys(_PICTURES, None),
}
#: Whether the lens is a fisheye, in a key that asks for it.
_IS_FISHEYE: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("0", "false", "no"), OPENCV),
    **dict.fromkeys(("1", "true", "yes"), FISHEYE),
}
_OF_MC_CALIB = "distortionvector"
"""Only MC-Calib has this name. There, a `distortion_type` of 1 means a fisheye."""
_IN_ANY_ORDER = "brown"
"""A model whose list of coefficients is k1 k2 p1 p2 k3 in some programs, and k1 k2 k3 p1 p2 in cuVSLAM and openMVG."""
_OF_ANDROID = "lensdistortion"
"""Name of a list that is k1 k2 k3 p1 p2 on Android (LENS_DISTORTION), and in no one order elsewhere."""
_RADIAL_FIRST = ("k1", "k2", "k3", "p1", "p2")
_TYPES = {
    *_EQUIDISTANT,
    "omni",
    "omnidirectional",
    "mei",
    "ocam",
    "ds",
    "doublesphere",
    "ucm",
    "eucm",
    "unifiedprojection",
    "fov",
    "atan",
}
"""Lenses that the name `type` alone may state."""
_OPENCV_IN_FILES, _FISHEYE_IN_FILES = tuple(name.lower() for name in OPENCV), ("k1", "k2", "k3", "k4")
"""Names of single coefficients in files."""
ALIKE_A_COEFFICIENT = re.compile("[bdkprst][0-9]+|tau[xy]")
CALIBRATE_ANEW = (
    "Only OpenCV's lenses are read, Brown and fisheye. Calibrate with one of them, such as pinhole-radtan or"
    " pinhole-equi of Kalibr."
)
_ASK = "Give --lens brown or --lens fisheye, or write `fisheye_model: 0` or `fisheye_model: 1` into the file."
_ASK_ORDER = "Give --lens brown for the first order. For the other, give each its name in the file, such as `k1: -0.1`."


def camera_of_values(values: Values, family: LensFamily | None) -> CameraModel:
    """Return the camera of one set of values."""
    model, names = _stated_lens(values)
    matrix, four_more = _matrix(values)
    stated = _distortion(values, four_more, is_fisheye=names is FISHEYE or family == "fisheye")
    _require_no_more(values, is_like_a_lens if stated is None else _BESIDE.fullmatch)
    may_be_without = values.get("program", _STATES_ALL) != _STATES_ALL or names == () or _is_rectified(values)
    if stated is None and not may_be_without:
        _require_no_lens(values)
    stated = stated or []
    if family is not None:
        if names is not None and (names is FISHEYE) != (family == "fisheye"):
            raise OtherForm(f"its lens model is {model}, not {family}", "Leave out --lens.")
        names = names if names is not None else FISHEYE if family == "fisheye" else OPENCV
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    plain = CameraModel(fx, fy, cx, cy, size_of_values(values))
    require_possible_camera(plain)
    if names is None and len(stated) == len(FISHEYE) and any(stated) and "p1" not in _single(values):
        why = (
            "it states four coefficients and no lens model: they are k1 k2 p1 p2, or those of a fisheye lens"
        )
        _require_alike(plain, stated, (OPENCV, FISHEYE), f"{why} (cv2.fisheye)", _ASK)
    is_in_any_order = plain_name(model or "") == _IN_ANY_ORDER or (names is None and _OF_ANDROID in values)
    if family is None and is_in_any_order and "k1" not in _single(values):
        whose = "lens_distortion" if _OF_ANDROID in values else "the lens model brown"
        why = f"{whose} has no one order: they are k1 k2 p1 p2 k3, or k1 k2 k3 p1 p2"
        _require_alike(plain, stated, (OPENCV, _RADIAL_FIRST), why, _ASK_ORDER)
    coefficients = _coefficients(stated, names if names is not None else OPENCV, model or "OpenCV")
    skew_px = _skew_px(values, float(matrix[0, 1]))
    skew = {SKEW: skew_px} if abs(skew_px) > _LEAST_SKEW_PX else {}
    return replace(plain, distortion={**coefficients, **skew})


def plain_name(name: Any) -> str:
    """Return a name without case and punctuation."""
    return re.sub(r"[^a-z0-9]", "", str(name).lower())


def _is_rectified(values: Values) -> bool:
    """Return whether a camera says that its images have no distortion, as DSEC's camRect0 does."""
    return any(str(values.get(name)).lower() == "true" for name in ("isrectified", "rectified"))


def _skew_px(values: Values, of_matrix_px: float) -> float:
    """Return the skew in the matrix or beside it, px."""
    skews = numbers_of("the skew", values.get("skew") or 0.0)
    if len(skews) != 1 or (of_matrix_px and skews[0] not in {0.0, of_matrix_px}):
        raise OtherForm("it states two different skews", "Keep the right one in a copy of the file.")
    return of_matrix_px or skews[0]


def is_like_a_lens(name: str) -> bool:
    """Return whether a plain name may be that of coefficients."""
    return bool(LENS.fullmatch(name) or _LIKE_A_LENS.match(name))


def _require_no_more(values: Values, is_of_lens: Callable[[str], object]) -> None:
    """Raise OtherForm if numbers have a name that may be one of coefficients, but is not known.

    A number alone is one if its name is numbered: ``radial_distortion_1``, not the number of coefficients.
    """
    for name, value in values.items():
        if is_of_lens(name) and _holds_numbers([value] if name[-1:].isdigit() else value):
            raise OtherForm(
                f"{name[:LONGEST_NAME]!r} may be distortion coefficients, but is no name or form of theirs",
                "Write all as distortion_coefficients, in the order k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tauX tauY.",
            )


def _require_no_lens(values: Values) -> None:
    """Raise OtherForm, because a file must state coefficients."""
    if "alpha" in values:
        raise OtherForm(
            "it states alpha and no distortion coefficients, as a unified camera (UCM, EUCM) does, which is not read",
            CALIBRATE_ANEW,
        )
    raise OtherForm(
        "it states no distortion coefficients",
        "Add distortion_coefficients; zeros are without distortion.",
    )


def _holds_numbers(value: Any) -> bool:
    """Return whether a list, a text of several numbers or a mapping holds a number that is not zero."""
    if isinstance(value, Mapping):
        return any(_holds_numbers([element]) for element in value.values())
    if not isinstance(value, str | list):
        return False
    try:
        stated = numbers(value)
        # Of YAML and XML, a number alone is a text too.
        return any(stated) and not (isinstance(value, str) and len(stated) == 1)
    except OF_OTHER_FORM:
        return False


def states_a_matrix(values: Values) -> bool:
    """Return whether values name a camera matrix."""
    return bool(listed(values, _MATRIX))


def _distortion(values: Values, of_intrinsics: list[float], *, is_fisheye: bool) -> Sequence[float] | None:
    """Return the coefficients in the order of their lens model, as lists or names state them; None without any.

    Zeros at the end do not count when two statements are compared.
    """
    by_place = {
        name: numbers_of("the distortion", value)
        for name, value in listed(values, filter(LENS.fullmatch, values)).items()
    }
    if of_intrinsics:
        by_place["intrinsics"] = of_intrinsics
    if named := _named(values, is_fisheye=is_fisheye):
        by_place["k1, k2, ..."] = named
    if not by_place:
        return None
    longest = max(map(len, by_place.values()))
    agreed(
        "the distortion",
        {
            name: [*coefficients, *[0.0] * (longest - len(coefficients))]
            for name, coefficients in by_place.items()
        },
    )
    return next(iter(by_place.values()))


def _named(values: Values, *, is_fisheye: bool) -> list[float]:
    """Return coefficients that have a name each, such as ``k1: -0.1``, also below ``distortion``; empty without any."""
    names = _FISHEYE_IN_FILES if is_fisheye else _OPENCV_IN_FILES
    single = _single(values)
    named = {name: single[name] for name in _OPENCV_IN_FILES if name in single}
    if not named:
        return []
    _require_known(single, named)
    coefficients = {name: numbers_of(f"the coefficient {name}", value) for name, value in named.items()}
    if any(len(coefficient) != 1 for coefficient in coefficients.values()):
        raise OtherForm(f"one of the coefficients {', '.join(named)} is no number")
    other = [name for name, (value,) in coefficients.items() if value and name not in names]
    if other:
        raise OtherForm(f"a fisheye lens has no coefficient {other[0]}", "Correct the name of the model.")
    if not is_fisheye and coefficients.get("k4", [0.0]) != [0.0] and not {"k5", "k6"} & set(named):
        if "p1" not in named:
            raise OtherForm("it states k1 to k4 and no lens model, as of a fisheye lens", _ASK)
        raise OtherForm(
            "it states k4, but neither k5 nor k6: in some programs k4 is the term of r^8, which OpenCV has not",
            "If k4 is OpenCV's, add k5: 0 and k6: 0.",
        )
    last = max(names.index(name) for name in named if name in names)
    in_order = [coefficients.get(name, [0.0])[0] for name in names[: last + 1]]
    lengths = (len(FISHEYE),) if is_fisheye else OPENCV_LENGTHS
    return in_order + [0.0] * (next(length for length in lengths if length >= len(in_order)) - len(in_order))


def _single(values: Values) -> dict[str, int | float | str]:
    """Return the numbers whose names are like those of coefficients; a matrix, such as P1, has more numbers."""
    return {
        name: value
        for name, value in values.items()
        if ALIKE_A_COEFFICIENT.fullmatch(name)
        and (
            isinstance(value, int | float)
            or (isinstance(value, str) and len(value.replace(",", " ").split()) < 4)
        )
    }


def _require_known(single: Values, known: Values) -> None:
    """Raise OtherForm if a number that is not zero stands beside the coefficients, with another such name."""
    for name in sorted(single.keys() - known.keys()):
        if _holds_numbers([single[name]]):
            raise OtherForm(
                f"{name} = {str(single[name])[:LONGEST_NAME]} is no coefficient of OpenCV",
                "If it is one under another name, such as t1 for p1, give it OpenCV's name; else see if it can be left"
                " out.",
            )


def _stated_lens(values: Values) -> tuple[str | None, tuple[str, ...] | None]:
    """Return the name of the lens model in the file, and the names of its coefficients; None for what is not stated."""
    if "k" in values and values.get("type", "pinhole") != "pinhole":
        raise OtherForm(
            f"the camera geometry has the type {str(values['type'])[:LONGEST_NAME]!r}; only `pinhole` is known: the"
            " maker does not publish how a fisheye is written",
            "Use another file of the same calibration, for example OpenCV's YAML.",
        )
    model, names = None, None
    for key, value in values.items():
        if not (MODEL.fullmatch(key) or (key == "type" and plain_name(value) in _TYPES)):
            continue
        if value in (None, "") or isinstance(value, Mapping):  # ROS leaves a model empty that was not stated
            continue
        if key == "fisheye" and values.get("program") == _MASKED:
            continue
        own = _lens_of(key, value, is_answer="fisheye" in key or _OF_MC_CALIB in values)
        model = str(value) if model is None or own is not None else model
        if own is None:
            continue
        if names is not None and (names is FISHEYE) != (own is FISHEYE):
            raise OtherForm(
                f"it states two lens models that contradict each other, one of them {str(value)!r}"
            )
        names = own if names is None else min(names, own, key=len)
    return model, names


def _lens_of(key: str, value: Any, *, is_answer: bool) -> tuple[str, ...] | None:
    """Return the coefficients of the lens that a value names, or that it answers whether it is a fisheye."""
    word = plain_name(value).removeprefix("distortion")  # as RealSense writes it
    if is_answer and word in _IS_FISHEYE:
        return _IS_FISHEYE[word]
    if word.isdecimal():
        raise OtherForm(
            f"its lens model is the number {word} ({key}), and programs number them differently",
            "Write its name instead, such as `distortion_model: plumb_bob` or `equidistant`.",
        )
    if key in _OF_CAMERA and word not in _LENSES and word not in _TYPES:
        raise OtherForm(
            f"{key} is {str(value)[:LONGEST_NAME]!r}, which is no lens model that is read",
            f"If it is the name of the camera, take it out of a copy of the file. {CALIBRATE_ANEW}",
        )
    if word not in _LENSES or isinstance(value, list):
        raise OtherForm(f"the lens model {str(value)[:LONGEST_NAME]!r} is not read", CALIBRATE_ANEW)
    return _LENSES[word]


def _coefficients(stated: Sequence[float], names: Sequence[str], model: str) -> dict[str, float]:
    """Return the coefficients by name: the one rule for their number. Those beyond the model's must be zero."""
    beyond = [at for at, value in enumerate(stated) if value and at >= len(names)]
    if beyond and not names:
        raise OtherForm(
            f"the lens model {model!r} is read only without distortion, but coefficient {beyond[0] + 1} is"
            f" {stated[beyond[0]]:g}",
            CALIBRATE_ANEW,
        )
    if beyond:
        raise OtherForm(
            f"the lens model {model} has {len(names)} coefficients, but the file states {len(stated)}:"
            f" coefficient {beyond[0] + 1} is {stated[beyond[0]]:g}, not 0",
            "Correct the name of the model, or the coefficients.",
        )
    if names is FISHEYE and not stated:
        return dict.fromkeys(FISHEYE, 0.0)
    lengths = (len(FISHEYE),) if names is FISHEYE else (0, *OPENCV_LENGTHS)
    if min(len(stated), len(names)) not in lengths:
        raise OtherForm(
            f"{len(stated)} distortion coefficients are no camera's: there are {', '.join(map(str, lengths))}",
            "OpenCV's order is k1 k2 p1 p2 k3; write zeros for those that are not estimated.",
        )
    last = max((at + 1 for at, value in enumerate(stated) if value), default=0)
    used = next(
        length for length in lengths if length >= min(max(last, _LEAST_NAMED), len(stated), len(names))
    )
    return dict(zip(names[:used], stated, strict=False))


def _require_alike(
    camera: CameraModel, coefficients: Sequence[float], orders: Sequence[Sequence[str]], why: str, remedy: str
) -> None:
    """Refuse coefficients that are read in two ways, unless both project alike."""
    first, other = (
        replace(camera, distortion=dict(zip(names, coefficients, strict=False))) for names in orders
    )
    width, height = camera.image_size
    border = np.array([(x, y) for x in np.linspace(0, width - 1, 9) for y in np.linspace(0, height - 1, 9)])
    apart = np.linalg.norm(other.project(first.rays(border)) - border, axis=1)
    if not np.isfinite(apart).all() or apart.max() > _ALIKE_PX:
        most = f", up to {np.nanmax(apart):.1f} px apart" if np.isfinite(apart).any() else ""
        raise OtherForm(f"{why}{most}", remedy)


def _matrix(values: Values) -> tuple[Array, list[float]]:
    """Return the camera matrix, and the numbers beside it where a program writes both in one list."""
    stated = {name: numbers_of("the camera matrix", value) for name, value in listed(values, _MATRIX).items()}
    stated = {name: elements for name, elements in stated.items() if not _is_pose(elements)}
    if not stated:
        raise OtherForm("it has no camera matrix")
    elements, *others = map(_square, stated.values())
    after_four: list[float] = []
    five_beside = (
        len(elements) == _OF_MATRIX and elements[1] and elements[3] and elements[6:] != [0.0, 0.0, 1.0]
    )
    if len(elements) >= len(PINHOLE) and (
        len(elements) != _OF_MATRIX or "lensmodel" in values or five_beside
    ):
        elements, after_four = _of_pinhole(elements[:4]), elements[4:]
    if len(after_four) == 1:  # fx, fy, cx, cy and the skew; GTSAM has fx, fy, the skew, cx, cy
        elements[1], after_four = after_four[0], []
        if abs(elements[1]) > _MOST_SKEW * elements[0]:
            raise OtherForm(
                "five numbers in place of a camera matrix are fx, fy, cx, cy and the skew, but the last one is no skew",
                "Write fx, fy, cx and cy.",
            )
    if len(elements) != _OF_MATRIX:
        raise OtherForm(f"the camera matrix has {len(elements)} numbers; 9 are needed, or fx, fy, cx, cy")
    alike = [_of_pinhole(other) if len(other) == len(PINHOLE) else other for other in others]
    matrices = zip(
        stated, [elements, *alike], strict=True
    )  # others, such as of extrinsics, have another last row
    agreed("the camera matrix", {name: other for name, other in matrices if other[6:] == elements[6:]})
    matrix = np.array(elements).reshape(3, 3)
    if not matrix[:2].any():
        raise OtherForm(
            "the camera is not calibrated: its camera matrix is zero", "Calibrate the camera first."
        )
    if not np.array_equal(matrix[2], [0.0, 0.0, 1.0]) or matrix[1, 0]:
        raise OtherForm(
            "the camera matrix is not fx 0 cx, 0 fy cy, 0 0 1, row after row",
            "MATLAB and Open3D write it column after column; MATLAB counts pixels from 1.",
        )
    return matrix, after_four


def _is_pose(elements: list[float]) -> bool:
    """Return whether a matrix turns and shifts, as OpenPose's CameraMatrix does beside its Intrinsics."""
    if len(elements) not in {_OF_MATRIX, *_WITH_A_COLUMN}:
        return False
    columns = 3 if len(elements) == _OF_MATRIX else 4
    turn = np.array(elements[: 3 * columns]).reshape(3, columns)[:, :3]
    return np.allclose(turn @ turn.T, np.eye(3), atol=1e-3)


def _square(elements: list[float]) -> list[float]:
    """Return the first three columns and rows of a matrix whose fourth ones are zero; other numbers unchanged."""
    if len(elements) not in _WITH_A_COLUMN or any(elements[3:12:4]) or elements[8:11] != [0.0, 0.0, 1.0]:
        return elements
    return [number for at, number in enumerate(elements[:12]) if at % 4 != 3]


def _of_pinhole(elements: Sequence[float]) -> list[float]:
    fx, fy, cx, cy = elements
    return [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
