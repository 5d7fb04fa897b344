"""The forms of camera files: a model for each, with every name that its program writes.

Names are compared without case and punctuation, as OpenCV changed them between versions. A name is used or known to be
harmless; a file with another name has another form.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
from pydantic import AliasChoices, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from bench.camera_files.texts import OtherForm
from calib.model.lens import FISHEYE, OPENCV

LARGEST: Final = 1e15
"""Of any value: a lens of long focal length has coefficients of 1e9."""
LONGEST_NAME: Final = 40
"""Characters of a name that a message shows; a longer one hides the rest of the sentence."""
_MOST_NAMED = 20
"""Names that a message shows: some lines of a terminal."""
_KALIBR = re.compile(r"cam\d+")
_OF_PAIR = frozenset(("R", "T", "E", "F", "R1", "R2", "P1", "P2", "Q", "pose_covariance"))
"""What OpenCV's stereo sample writes beside M1, D1, M2 and D2, and Starbench beside that: poses and rectification."""
_POSE = "T_"
"""Begin of the name of a pose, such as T_cam_imu and T_cn_cnm1."""
_FIRST_PIXEL = 0.5
"""Coordinate of the centre of COLMAP's first pixel."""
#: Numbers of focal lengths and of coefficients of COLMAP's models; the coefficients are in OpenCV's order.
_COLMAP_MODELS = {
    "SIMPLE_PINHOLE": (1, 0), "PINHOLE": (2, 0), "SIMPLE_RADIAL": (1, 1), "RADIAL": (1, 2), "OPENCV": (2, 4),
    "FULL_OPENCV": (2, 8), "SIMPLE_RADIAL_FISHEYE": (1, 1), "RADIAL_FISHEYE": (1, 2), "OPENCV_FISHEYE": (2, 4),
    "SIMPLE_FISHEYE": (1, 0), "FISHEYE": (2, 0),
}  # fmt: skip

Values = Mapping[str, Any]
Lens = tuple[str, ...]
"""Names of the coefficients that a lens model has, in the order of its lists."""


def numbers(value: Any) -> list[float]:
    """Return the finite numbers of a matrix or a list in any form, row after row; else ValueError."""
    listed = list(_numbers(value))
    if not (np.abs(listed) < LARGEST).all():
        raise ValueError("has a value that is not finite")
    if isinstance(value, Mapping) and {"rows", "cols"} <= value.keys():
        sides = numbers([value["rows"], value["cols"]])
        if np.prod(sides) != len(listed):
            said = " x ".join(f"{side:g}" for side in sides)
            raise ValueError(
                f"says {said} but holds {len(listed)} numbers (a decimal comma makes two of one)"
            )
    return listed


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, Mapping) and "data" in value:
        yield from _numbers(value["data"])
    elif isinstance(value, list | tuple):
        for element in value:
            yield from _numbers(element)
    else:
        try:
            yield from map(float, str(value).replace(",", " ").split())
        except ValueError:
            raise ValueError("is no list of numbers") from None


def _words(value: str | Iterable[str]) -> tuple[str, ...]:
    return tuple(value.split() if isinstance(value, str) else value)


Numbers = Annotated[list[float], BeforeValidator(numbers)]
Words = Annotated[tuple[str, ...], BeforeValidator(_words)]


def _named(*names: str, **default: Any) -> Any:
    return Field(validation_alias=AliasChoices(*names), **default)


class CameraForm(BaseModel):
    """One camera as a program writes it, in px, with OpenCV's pixel centres."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    kind: ClassVar[str]  # What the file is, in words; {} is its syntax
    harmless: ClassVar[tuple[str, ...]] = ()
    # By the model; None: it does not state the lens
    lenses: ClassVar[Mapping[Any, Lens | None]] = {None: None}
    matrix: Numbers  # 3 x 3, row after row, or fx fy cx cy
    coefficients: Numbers
    size: Numbers | None = _named("imagesize", "imagersize", "resolution", "cameraresolution", default=None)
    width: int | None = _named("imagewidth", "width", default=None)
    height: int | None = _named("imageheight", "height", default=None)
    model: str | bool | None = None

    @property
    def lens(self) -> Lens | None:
        """Names of the coefficients; None if the file does not state the lens model."""
        if self.model not in self.lenses:
            raise OtherForm(
                f"its lens model {str(self.model)[:LONGEST_NAME]!r} is not read",
                f"Calibrate with one of {', '.join(filter(None, self.lenses))}.",
            )
        return self.lenses[self.model]

    @property
    def remarks(self) -> list[str]:
        """What a user must know about the images, a sentence each."""
        return []

    def image_size(self) -> tuple[int, int] | None:
        """Return width and height, px; None if the file does not state them."""
        sides = [side for side in (self.width, self.height) if side is not None]
        first, *others = [size for size in (self.size, sides) if size] or [[]]
        if any(other != first for other in others):
            raise OtherForm("it states two sizes of the image")
        if first and (len(first) != 2 or any(side != int(side) for side in first)):
            raise OtherForm("the size of the image is not a width and a height")
        return (int(first[0]), int(first[1])) if first else None


class OpenCv(CameraForm):
    """OpenCV's samples, interactive-calibration and tutorial, and Starbench's export."""

    kind = "OpenCV's {}"
    harmless = _words(
        "cameraname calibrationtime calibrationdate nframes nrofframes framescount boardwidth boardheight squaresize"
        " markersize aspectratio fixaspectratio fixedaspectratio flags flagvalue avgreprojectionerror"
        " perviewreprojectionerrors extrinsicparameters imagepoints gridpoints cameramatrixstddev distcoeffsstddev"
        " ret rms rvecs tvecs objpoints imgpoints"
    )
    matrix: Numbers = _named("cameramatrix", "mtx", "k", "m")
    coefficients: Numbers = _named("distortioncoefficients", "distcoeffs", "distcoeff", "dist", "d")
    lenses: ClassVar[Mapping[Any, Lens | None]] = {None: None, False: OPENCV, True: FISHEYE}
    model: bool | None = _named("fisheyemodel", default=None)
    names: Words | None = _named("parameternames", default=None)
    covariance: Numbers | None = _named("parametercovariance", default=None)


class Ros(CameraForm):
    """ROS's camera_info, as a file and as `topic echo` prints its message."""

    kind = "ROS's camera_info"
    harmless = _words("header cameraname rectificationmatrix projectionmatrix r p")
    lenses: ClassVar[Mapping[Any, Lens | None]] = {
        "": None, None: None, "plumb_bob": OPENCV[:5], "rational_polynomial": OPENCV, "equidistant": FISHEYE,
    }  # fmt: skip
    matrix: Numbers = _named("cameramatrix", "k")
    coefficients: Numbers = _named("distortioncoefficients", "d")
    model: str | None = _named("distortionmodel", default=None)
    binning_x: int = _named("binningx", default=0)
    binning_y: int = _named("binningy", default=0)
    roi: dict[str, int | bool] = {}

    @property
    def remarks(self) -> list[str]:
        """See `CameraForm`: whether the images are binned, or of a part of the sensor."""
        x, y, width, height = (self.roi.get(name, 0) for name in ("x_offset", "y_offset", "width", "height"))
        is_whole = (x, y) == (0, 0) and (width, height) in ((0, 0), (self.width, self.height))
        if is_whole and max(self.binning_x, self.binning_y) <= 1:
            return []
        return ["Its images are binned or of a region of interest; this camera is that of the whole image."]


class Kalibr(CameraForm):
    """A camera of Kalibr's camchain."""

    kind = "Kalibr's camchain"
    harmless = _words("rostopic camoverlaps timeshiftcamimu linedelay")
    lenses: ClassVar[Mapping[Any, Lens | None]] = {"radtan": OPENCV[:4], "equidistant": FISHEYE, "none": ()}
    matrix: Numbers = _named("intrinsics")
    coefficients: Numbers = _named("distortioncoeffs")
    model: str = _named("distortionmodel")
    camera: Literal["pinhole"] = _named("cameramodel")


class Metavision(CameraForm):
    """The intrinsics.json of Metavision SDK 4, which does not state whether the lens is a fisheye."""

    kind = "Metavision's intrinsics.json"
    harmless = _words(
        "cameraname pattern selectedviews overallrmsreprojectionerror perviewrmsreprojectionerrors rvecs tvecs"
    )
    matrix: Numbers = _named("cameramatrix")
    coefficients: Numbers = _named("distortioncoefficients")
    views: int = _named("nkeptviews")


class CameraGeometry(CameraForm):
    """The camera-geometry.json of Metavision SDK 5. The maker does not publish how a fisheye is written."""

    kind = "Metavision's camera-geometry.json"
    matrix: Numbers = _named("k")
    coefficients: Numbers = _named("d")
    lenses: ClassVar[Mapping[Any, Lens | None]] = {"pinhole": OPENCV}
    model: str = _named("type")


class Mrcal(CameraForm):
    """mrcal's cameramodel."""

    kind = "mrcal's cameramodel"
    harmless = _words("extrinsics rtcamref icamintrinsics optimizationinputs validintrinsicsregion")
    lenses: ClassVar[Mapping[Any, Lens | None]] = {
        "LENSMODEL_PINHOLE": (),
        **{f"LENSMODEL_OPENCV{count}": OPENCV[:count] for count in (4, 5, 8, 12)},
    }
    model: str = _named("lensmodel")


class Colmap(OpenCv):
    """A camera of COLMAP's cameras.txt."""

    kind = "COLMAP's cameras"


_FORMS: Sequence[type[CameraForm]] = (OpenCv, Ros, Kalibr, Metavision, CameraGeometry)
_FORM_OF_SYNTAX: Mapping[str, type[CameraForm]] = {"Python": Mrcal, "COLMAP": Colmap}


def cameras_of(syntax: str, content: Values) -> Mapping[str, Values]:
    """Return the cameras of a file by name; one that is alone has none."""
    if syntax == "Python":
        return {"": _of_mrcal(content)}
    if syntax == "COLMAP":
        return {number: _of_colmap(**camera) for number, camera in content.items()}
    if content and all(map(_KALIBR.fullmatch, content)):
        return {name: camera if isinstance(camera, Mapping) else {} for name, camera in content.items()}
    if "M1" in content and "M2" in content:
        pair = {number: {f"M{number}": "M", f"D{number}": "D"} for number in "12"}
        left_out = {*_OF_PAIR, *pair["1"], *pair["2"]}
        common = {name: value for name, value in content.items() if name not in left_out}
        return {
            number: common | {name: content[stated] for stated, name in own.items() if stated in content}
            for number, own in pair.items()
        }
    return {"": content}


def _of_mrcal(content: Values) -> Values:
    """Take mrcal's ``intrinsics`` apart: fx fy cx cy, and the coefficients."""
    if "intrinsics" not in content:
        return content
    listed = _numbers_of("intrinsics", content["intrinsics"])
    others = {name: value for name, value in content.items() if name != "intrinsics"}
    return {**others, "matrix": listed[:4], "coefficients": listed[4:]}


def _of_colmap(*, number: str, model: str, width: str, height: str, params: str) -> Values:
    """Return a camera of COLMAP by OpenCV's names: the first pixel has its centre at (0.5, 0.5) there."""
    if model not in _COLMAP_MODELS:
        raise OtherForm(
            f"COLMAP's model {model[:LONGEST_NAME]} is not read",
            "Reconstruct with its model OPENCV or OPENCV_FISHEYE.",
        )
    focal, count = _COLMAP_MODELS[model]
    values = _numbers_of(model, params)
    if len(values) != focal + 2 + count:
        raise OtherForm(
            f"COLMAP's model {model} has {focal + 2 + count} values; camera {number} has {len(values)}"
        )
    lengths, (cx, cy), lens = values[:focal], values[focal : focal + 2], values[focal + 2 :]
    return {
        "camera_matrix": [lengths[0], lengths[-1], cx - _FIRST_PIXEL, cy - _FIRST_PIXEL],
        "distortion_coefficients": [*lens, *[0.0] * (4 - count)],
        "fisheye_model": "FISHEYE" in model,
        "width": width,
        "height": height,
    }


def _numbers_of(name: str, value: Any) -> list[float]:
    try:
        return numbers(value)
    except ValueError as error:
        raise OtherForm(f"{name} {error}") from None


def form_of(syntax: str, values: Values) -> CameraForm:
    """Return the camera by the one form that has all its names; or raise OtherForm."""
    names = {plain_name(name): name for name in values if not name.startswith(_POSE)}
    if double := [name for name in values if names.get(plain_name(name), name) != name]:
        raise OtherForm(f"it states {double[0][:LONGEST_NAME]!r} twice")
    unknown: list[str] = []
    for form in (_FORM_OF_SYNTAX[syntax],) if syntax in _FORM_OF_SYNTAX else _FORMS:
        used = {plain: values[name] for plain, name in names.items() if plain not in form.harmless}
        try:
            return form.model_validate(used)
        except ValidationError as error:
            faults = error.errors(include_url=False)
        kinds = {fault["type"] for fault in faults}
        if not kinds & {"missing", "extra_forbidden"}:
            raise OtherForm(_words_of(faults[0], names)) from None
        if "missing" not in kinds:
            extra = [names[str(fault["loc"][0])] for fault in faults if fault["type"] == "extra_forbidden"]
            unknown.append(f"{form.kind.format(syntax)} does not have {_listed(extra)}; ")
    why = (unknown or ["it has none of the forms that are read; "])[0]
    raise OtherForm(f"{why}it holds {_listed(values)}")


def _words_of(fault: ErrorDetails, names: Mapping[str, str]) -> str:
    """Return in words what is wrong with a value."""
    place = str(fault["loc"][0])
    what = {
        "value_error": fault["msg"].removeprefix("Value error, "),
        "literal_error": f"is {fault['input']!r:.40}",
    }
    return f"{names.get(place, place)} {what.get(fault['type'], 'has another form')}"


def _listed(names: Iterable[str]) -> str:
    """Return names in words; of many or of long ones, the beginning."""
    named = [name[:LONGEST_NAME] for name in names]
    more = f" and {len(named) - _MOST_NAMED} more" if len(named) > _MOST_NAMED else ""
    return f"{', '.join(named[:_MOST_NAMED])}{more}" if named else "no names"


def plain_name(name: str) -> str:
    """Return a name without case and punctuation."""
    return re.sub(r"[^a-z0-9]", "", name.lower())
