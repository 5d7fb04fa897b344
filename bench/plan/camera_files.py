"""Reads one calibrated camera from a file: a run's, an export of ours, or one of another program.

A file is recognised by its content, and every camera goes one way: names without case and punctuation, the model of the
lens as the file states it, one rule for the number of coefficients. Nothing is dropped in silence; what a file does not
state, such as a covariance, stays unknown.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from bench.base.errors import UsageError
from bench.plan.camera_text import WRITE_OPENCV, OtherForm, numbers, values_of
from bench.record.results import CameraData
from bench.record.storage import read_bounded
from bench.record.stored_calibration import camera_covariance, camera_of
from calib.model.camera import PINHOLE, SKEW, CameraModel
from calib.model.lens import FISHEYE, OPENCV, OPENCV_LENGTHS

Array = NDArray[np.float64]
LensFamily = Literal["brown", "fisheye"]

_MOST_BYTES = 20_000_000
_MOST_PX = 200_000_000
_LARGEST = 1e15
"""Of any value: a lens of long focal length has coefficients of 1e9."""
_NEGATIVE = 1e-6
"""Least eigenvalue of a covariance, as a share of the largest: rounding."""
_FAR_FROM_MIDDLE = 0.15
"""Of the width or height: farther from the middle, a principal point is remarkable; `calibrate` has the same share."""
_ALIKE_PX = 0.01
"""Two readings of a file that project so much apart are one: a tenth of what the best calibration states."""
_LEAST_SKEW_PX = 1e-9
_LEAST_NAMED = 5
"""Coefficients of OpenCV that are kept by name although they are zero."""
_OF_MATRIX = 9
_LONGEST_NAME, _MOST_NAMED = 40, 10
"""Characters of a name, and names, that a message shows."""
_REGION = ("x_offset", "y_offset", "width", "height")
OF_OTHER_FORM = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError)
"""What reading a file of another form raises."""
_RESULTS = "results.json"
_KNOWN = (
    "Known are results.json of a run, and files of OpenCV (YAML, XML, JSON), ROS (camera_info, ost.txt), Kalibr, mrcal,"
    " COLMAP and Metavision."
)

#: Names without case and punctuation, as programs write them.
_MATRIX = ("cameramatrix", "k", "mtx", "cameramat", "intrinsicmatrix", "intrinsics", "intrinsic", "m")
_LENS = (
    "distortioncoefficients", "distortioncoeffs", "distortionvector", "distortionparams", "distortion", "distcoeffs",
    "distcoeff", "distcoefs", "dist", "d",
)  # fmt: skip
_SIZES = ("imagesize", "resolution", "imagersize", "imageresolution")
_SIDES = [
    (f"{of}{width}", f"{of}{height}")
    for of in ("image", "", "img", "imagesize")
    for width, height in (("width", "height"), ("w", "h"))
]
_MODELS = (
    "distortionmodel", "distortiontype", "lensmodel", "modeltype", "cameratype", "cameramodel", "calibrationmodel",
    "projectionmodel", "model", "fisheyemodel", "usefisheyemodel", "fisheye", "isfisheye",
)  # fmt: skip
_EQUIDISTANT = (
    "equidistant", "equi", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4", "kannalabrandt8", "kb4",
)  # fmt: skip
#: Coefficients of each lens model, by its name in any program; None: the name says nothing of the distortion.
_LENSES: Mapping[str, tuple[str, ...] | None] = {
    **dict.fromkeys(("plumbbob", "radialtangential", "lensmodelopencv5"), OPENCV[:5]),
    **dict.fromkeys(("radtan", "lensmodelopencv4"), OPENCV[:4]),
    **dict.fromkeys(("lensmodelopencv8", "pinholeradtan8"), OPENCV[:8]),
    "lensmodelopencv12": OPENCV[:12],
    **dict.fromkeys(("rationalpolynomial", "opencv", "brown", "brownconrady"), OPENCV),
    **dict.fromkeys(_EQUIDISTANT, FISHEYE),
    **dict.fromkeys(("none", "lensmodelpinhole"), ()),
    **dict.fromkeys(("pinhole", "perspective"), None),
    **dict.fromkeys(("0", "false"), OPENCV),  # of a name that asks for a fisheye
    **dict.fromkeys(("1", "true"), FISHEYE),
}
#: Names that only a program has whose cameras are not read.
_FOREIGN = {
    "value0": "Basalt or openMVG (cereal)",
    "projectionparameters": "camodocal",
    "flx": "nerfstudio or instant-ngp",
    "camerafx": "ORB-SLAM",
    "camera1fx": "ORB-SLAM",
    "xi": "OpenCV's omnidirectional camera",
    "radialdistortion": "MATLAB",
    "ppx": "RealSense",
    "cameradata": "Luxonis",
    "polymorphicname": "calib.io or openMVG",
    "sfmdataversion": "openMVG",
}
#: What a file is, in words, by its syntax or by a name that only one program has.
_KINDS = {
    "XML": "OpenCV's XML",
    "COLMAP": "COLMAP's cameras.txt",
    "INI": "ROS's ost.txt",
    "lensmodel": "mrcal's cameramodel",
    "sensortype": "EuRoC's sensor.yaml",
    "distortioncoeffs": "Kalibr's camchain",
    "distortionmodel": "ROS's camera_info",
    "nkeptviews": "Metavision's intrinsics.json",
    "type": "Metavision's camera-geometry.json",
}
_ASK = "Give --lens brown or --lens fisheye, or write `fisheye_model: 0` or `fisheye_model: 1` into the file."
_Found = tuple[str, CameraModel, Array | None, tuple[str, ...]]
_Values = Mapping[str, Any]


class NotACamera(UsageError):
    """A file does not hold one calibrated camera that can be read."""


@dataclass(frozen=True)
class CameraFile:
    """A calibrated camera as a file states it."""

    path: Path
    data: bytes
    kind: str  # What the file is, in words
    camera: CameraModel
    # (K, K) covariance in the order of `CameraModel.parameter_names`; None if the file states none.
    covariance: Array | None = None
    remarks: tuple[str, ...] = ()  # What a user must know about how the file was read, a sentence each


def read_camera_file(path: Path, name: str | None = None, lens: LensFamily | None = None) -> CameraFile:
    """Read the camera of a run folder or of a file.

    ``name`` is that of the camera if the file holds several; ``lens`` the family of the coefficients if it states none.
    """
    file = path / _RESULTS if path.is_dir() else path
    if file != path and not file.is_file():
        raise NotACamera(
            f"This folder holds no {_RESULTS}.", where=str(path), remedy="Name a run folder or a file in it."
        )
    if file.is_file() and file.stat().st_size > _MOST_BYTES:
        raise NotACamera(f"A calibration has at most {_MOST_BYTES} bytes.", where=str(file), remedy=_KNOWN)
    return parse_camera(read_bounded(file, _MOST_BYTES), file, name, lens)


def parse_camera(
    data: bytes, file: Path, name: str | None = None, lens: LensFamily | None = None
) -> CameraFile:
    """Read the camera that the bytes of a file hold, as `read_camera_file`."""
    try:
        kind, camera, covariance, remarks = _recognised(data, name, lens)
        _require_possible(camera, covariance)
    except OF_OTHER_FORM as error:
        raise NotACamera(
            (isinstance(error, OtherForm) and error.what)
            or f"This file does not hold a calibrated camera that can be read: {form_text(error)}.",
            where=str(file),
            remedy=(isinstance(error, OtherForm) and error.remedy) or _KNOWN,
        ) from error
    return CameraFile(file, data, kind, camera, covariance, (*remarks, *_remarks_about(camera)))


def form_text(error: Exception) -> str:
    """Return what one of `OF_OTHER_FORM` says of a file, as a part of a sentence."""
    if isinstance(error, KeyError):
        return f"it has no {error}"
    return str(error) if isinstance(error, OtherForm) else "a value has another form"


def _require_possible(camera: CameraModel, covariance: Array | None) -> None:
    """Raise OtherForm: If a value is not finite, a length is not positive, or the covariance is none."""
    sides = camera.image_size
    if not (np.abs(camera.values) < _LARGEST).all():
        raise OtherForm("a value of the camera is not finite")
    if not set(camera.distortion) <= {*OPENCV, SKEW} and not set(camera.distortion) <= {*FISHEYE, SKEW}:
        raise OtherForm(f"no lens has the coefficients {' '.join(camera.distortion)}")
    if min(camera.fx, camera.fy) < 1.0:
        raise OtherForm(f"focal lengths of {camera.fx:g} and {camera.fy:g} px are not possible")
    if min(sides) < 1 or sides[0] * sides[1] > _MOST_PX:
        raise OtherForm(f"an image of {sides[0]} x {sides[1]} px is not possible")
    if covariance is None:
        return
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    if not (np.abs(covariance) < _LARGEST).all() or (np.diag(covariance) < 0).any():
        raise OtherForm("a variance is not possible")
    if np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] < -_NEGATIVE * len(covariance):
        raise OtherForm("the covariance matrix is not positive")


def _remarks_about(camera: CameraModel) -> Iterator[str]:
    """Yield what is remarkable about a camera."""
    if camera.skew:
        yield f"The skew K[0,1] = {camera.skew:g} px is used; OpenCV and ROS ignore it."
    shares = np.array([camera.cx, camera.cy]) / camera.image_size
    if (np.abs(shares - 0.5) > _FAR_FROM_MIDDLE).any():
        x, y = (100.0 * shares).tolist()
        yield (
            f"The principal point ({camera.cx:.0f}, {camera.cy:.0f}) lies at {x:.0f} % of the width and {y:.0f} % of"
            " the height. Does the camera matrix belong to an image of this size, without binning and cropping?"
        )


def _recognised(data: bytes, name: str | None, lens: LensFamily | None) -> _Found:
    syntax, documents = values_of(data)
    ours = documents[0].get("calibration")
    if isinstance(ours, dict) and "camera" in ours:
        camera = camera_of(ours["camera"], ours["image_size"])
        return "the result of a run", camera, camera_covariance(cast("CameraData", ours)), ()
    found = [_chosen(_cameras(one), name) for one in documents]
    cameras = [_camera(one, lens) for one in found]
    if any(one != cameras[0] for one in cameras):
        raise OtherForm(
            f"{len(cameras)} different cameras follow one another", "Copy one of them to a file of its own."
        )
    values = found[0]
    kind = next((words for key, words in _KINDS.items() if key in (syntax, *values)), f"OpenCV's {syntax}")
    camera, covariance = _with_covariance(cameras[0], values)
    return kind, camera, covariance, tuple(_remarks_on_region(values))


def _plain(content: _Values) -> dict[str, Any]:
    """Return values by their names without case and punctuation."""
    return {re.sub(r"[^a-z0-9]", "", str(name).lower()): value for name, value in content.items()}


def _cameras(content: _Values) -> dict[str, _Values]:
    """Return the cameras of a file by name, each as values by plain names; a camera that is alone may have no name."""
    values = _plain(content)
    for key, program in _FOREIGN.items():
        if key in values:
            raise OtherForm(f"it is a file of {program}, which is not read", WRITE_OPENCV)
    if "focallength" in values and "principalpoint" in values:
        values["cameramatrix"] = [values["focallength"], values["principalpoint"]]
    if _first(values, _MATRIX) is not None:
        return {"": values}
    shared = {key: value for key, value in values.items() if not isinstance(value, Mapping | list)}
    found: dict[str, _Values] = {}
    for number in ("1", "2"):  # M1, D1, M2 and D2 of OpenCV's stereo calibration
        own = {key[:-1]: value for key, value in values.items() if key.endswith(number)}
        if _first(own, _MATRIX) is not None:
            found[number] = {**values, **own}
    for name, value in content.items():
        parts = (
            {f"{name}{at}": one for at, one in enumerate(value)} if isinstance(value, list) else {name: value}
        )
        for own_name, part in parts.items():
            if isinstance(part, Mapping):
                alone = {"": _plain(part)} if re.fullmatch(r"cam\d+", own_name) else {}
                for inner, camera in (_cameras(part) or alone).items():
                    known = f"{own_name}.{inner}" if inner in found else inner or own_name
                    found[known] = {**shared, **camera}
    return found


def _first(values: _Values, names: Sequence[str]) -> Any:
    """Return the first value of such a name that is a list or a matrix; None without one."""
    for value in map(values.get, names):
        if isinstance(value, str | list | tuple) or (isinstance(value, Mapping) and "data" in value):
            return value
    return None


def _chosen(cameras: Mapping[str, _Values], name: str | None) -> _Values:
    listed = ", ".join(one[:_LONGEST_NAME] for one in list(cameras)[:_MOST_NAMED])
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


def _camera(values: _Values, family: LensFamily | None) -> CameraModel:
    """Return the camera of one set of values."""
    matrix, beside = _matrix(values)
    lens = _first(values, _LENS)
    found = beside if lens is None else _numbers("the distortion", lens)
    model, names = _stated_lens(values)
    if lens is None and (model is None or not set(values).isdisjoint(_LENS)):
        raise OtherForm(
            "it states no distortion coefficients",
            "Add distortion_coefficients; zeros are without distortion.",
        )
    if family is not None:
        if names is not None and (names is FISHEYE) != (family == "fisheye"):
            raise OtherForm(f"its lens model is {model}, not {family}", "Leave out --lens.")
        names = names if names is not None else FISHEYE if family == "fisheye" else OPENCV
    width, height = _size(values)
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    plain = CameraModel(fx, fy, cx, cy, (width, height))
    if names is None and len(found) == len(FISHEYE) and any(found):
        _require_alike(plain, found)
    coefficients = _coefficients(found, names if names is not None else OPENCV, model or "OpenCV")
    skew = {SKEW: float(matrix[0, 1])} if abs(matrix[0, 1]) > _LEAST_SKEW_PX else {}
    return replace(plain, distortion={**coefficients, **skew})


def _stated_lens(values: _Values) -> tuple[str | None, tuple[str, ...] | None]:
    """Return the lens model as a file names it, and the names of its coefficients; None if it states none."""
    if "k" in values and values.get("type", "pinhole") != "pinhole":
        raise OtherForm(
            f"the camera geometry has the type {str(values['type'])[:_LONGEST_NAME]!r}; only `pinhole` is known: the"
            " maker does not publish how a fisheye is written",
            "Use another file of the same calibration, for example OpenCV's YAML.",
        )
    model, names = None, None
    for key in _MODELS:
        value = values.get(key)
        if value is None or isinstance(value, Mapping):
            continue
        word = re.sub(r"[^a-z0-9]", "", str(value).lower())
        if word not in _LENSES or isinstance(value, list):
            raise OtherForm(f"the lens model {str(value)[:_LONGEST_NAME]!r} is not read", WRITE_OPENCV)
        own = _LENSES[word]
        model = str(value) if model is None or own is not None else model
        if own is None:
            continue
        if names is not None and (names is FISHEYE) != (own is FISHEYE):
            raise OtherForm(
                f"it states two lens models that contradict each other, one of them {str(value)!r}"
            )
        names = own if names is None else min(names, own, key=len)
    return model, names


def _coefficients(found: Sequence[float], names: Sequence[str], model: str) -> dict[str, float]:
    """Return the coefficients by name: the one rule for their number. Those beyond the model's must be zero."""
    beyond = [at for at, value in enumerate(found) if value and at >= len(names)]
    if beyond:
        raise OtherForm(
            f"the lens model {model} has {len(names)} coefficients; the file states {len(found)}, and number"
            f" {beyond[0] + 1} is {found[beyond[0]]:g}",
            "Correct the name of the model, or the coefficients.",
        )
    if names is FISHEYE and not found:
        return dict.fromkeys(FISHEYE, 0.0)
    lengths = (len(FISHEYE),) if names is FISHEYE else (0, *OPENCV_LENGTHS)
    if min(len(found), len(names)) not in lengths:
        raise OtherForm(
            f"{len(found)} distortion coefficients are no camera's: there are {', '.join(map(str, lengths))}"
        )
    last = max((at + 1 for at, value in enumerate(found) if value), default=0)
    used = next(
        length for length in lengths if length >= min(max(last, _LEAST_NAMED), len(found), len(names))
    )
    return dict(zip(names[:used], found, strict=False))


def _require_alike(camera: CameraModel, found: Sequence[float]) -> None:
    """Refuse four coefficients without a lens model, unless both readings project alike."""
    brown, fisheye = (
        replace(camera, distortion=dict(zip(names, found, strict=False))) for names in (OPENCV, FISHEYE)
    )
    width, height = camera.image_size
    border = np.array([(x, y) for x in np.linspace(0, width - 1, 9) for y in np.linspace(0, height - 1, 9)])
    apart = np.linalg.norm(fisheye.project(brown.rays(border)) - border, axis=1)
    if not np.isfinite(apart).all() or apart.max() > _ALIKE_PX:
        most = f", up to {np.nanmax(apart):.1f} px apart" if np.isfinite(apart).any() else ""
        raise OtherForm(
            "it states four coefficients and no lens model: they are k1 k2 p1 p2, or those of a fisheye lens"
            f" (cv2.fisheye){most}",
            _ASK,
        )


def _matrix(values: _Values) -> tuple[Array, list[float]]:
    """Return the camera matrix, and the numbers beside it where a program writes both in one list."""
    stated = _first(values, _MATRIX)
    if stated is None:
        raise OtherForm("it has no camera matrix")
    found = _numbers("the camera matrix", stated)
    if len(found) >= len(PINHOLE) and (len(found) != _OF_MATRIX or "lensmodel" in values):
        fx, fy, cx, cy = found[:4]
        found, beside = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], found[4:]
    else:
        beside = []
    if len(found) != _OF_MATRIX:
        raise OtherForm(f"the camera matrix has {len(found)} numbers; 9 are needed, or fx, fy, cx, cy")
    matrix = np.array(found).reshape(3, 3)
    if not matrix[:2].any():
        raise OtherForm(
            "the camera is not calibrated: its camera matrix is zero", "Calibrate the camera first."
        )
    if not np.array_equal(matrix[2], [0.0, 0.0, 1.0]) or matrix[1, 0]:
        raise OtherForm(
            "the camera matrix is not fx 0 cx, 0 fy cy, 0 0 1, row after row",
            "MATLAB and Open3D write it column after column; MATLAB counts pixels from 1.",
        )
    return matrix, beside


def _size(values: _Values) -> tuple[int, int]:
    pairs = [[values.get(name) for name in names] for names in _SIDES]
    found = _first(values, _SIZES) or next((pair for pair in pairs if None not in pair), None)
    if found is None:
        raise OtherForm("it does not state the size of the image", "Add image_width and image_height, px.")
    sides = _numbers("the size of the image", found)
    if len(sides) != 2 or any(side != int(side) for side in sides):
        raise OtherForm("the size of the image is not a width and a height")
    return int(sides[0]), int(sides[1])


def _numbers(what: str, value: Any) -> list[float]:
    try:
        found = numbers(value)
    except OF_OTHER_FORM:
        raise OtherForm(f"{what} is no list of numbers") from None
    if not (np.abs(found) < _LARGEST).all():
        raise OtherForm(f"{what} has a value that is not finite")
    return found


def _remarks_on_region(values: _Values) -> Iterator[str]:
    """Yield that the images of a ROS camera are of a part of the sensor, or binned; the camera is of the whole one."""
    binning = [float(values.get(key) or 0) for key in ("binningx", "binningy")]
    if max(binning) > 1:
        yield f"Its images are binned by {binning[0]:g} x {binning[1]:g}; this camera is that of the whole image."
    region = values.get("roi")
    parts = [float(region.get(key) or 0) for key in _REGION] if isinstance(region, Mapping) else [0.0]
    if any(parts[:2]) or (any(parts) and (parts[2], parts[3]) != tuple(_size(values))):
        yield "Its images are of a region of interest; this camera is that of the whole image."


def _with_covariance(camera: CameraModel, values: _Values) -> tuple[CameraModel, Array | None]:
    """Take the rows of the camera's values; a coefficient of zero that was not estimated is left out."""
    stated, names = values.get("parametercovariance"), values.get("parameternames")
    if stated is None or names is None:
        return camera, None
    names = names.split() if isinstance(names, str) else list(map(str, names))
    found = _numbers("the covariance", stated)
    if len(found) != len(names) ** 2:
        raise OtherForm("the covariance has another size than its names")
    estimated = replace(camera, distortion={k: v for k, v in camera.distortion.items() if k in names})
    if not set(estimated.parameter_names) <= set(names):
        raise OtherForm("the covariance lacks a value of the camera")
    at = [names.index(name) for name in estimated.parameter_names]
    return estimated, np.reshape(found, (len(names), len(names)))[np.ix_(at, at)]
