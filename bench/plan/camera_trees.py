"""Cameras that lie deep in a file: DepthAI's calibration, calib.io's project, openMVG's scene, iKalibr's and eKalibr's.

Each becomes values with OpenCV's names. Its fields are as the programs publish them; their pixel centres are OpenCV's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from bench.plan.camera_text import OtherForm
from bench.plan.camera_values import CALIBRATE_ANEW, LONGEST_NAME, plain_name
from bench.plan.stated_values import Values, numbers_of
from calib.model.lens import OPENCV

_FIRST_OF_A_NAME: Final = 1 << 31
"""Added to the number of a class where cereal, the library of calib.io and openMVG, writes its name beside it."""
_CALIBIO = "libCalib::CameraModelOpenCV"
#: DepthAI's `CameraModel`, of which the first two are OpenCV's lenses.
_DEPTHAI_LENSES = ("opencv", "fisheye")
#: openMVG's coefficients, by the name of their list.
_OPENMVG_LENSES: Mapping[str, tuple[str, ...]] = {
    "disto_k1": ("k1",),
    "disto_k3": ("k1", "k2", "k3"),
    "disto_t2": ("k1", "k2", "k3", "p1", "p2"),
}
#: The same by the class of a camera in veta, the library of iKalibr and eKalibr.
_VETA_LENSES: Mapping[str, tuple[str, ...]] = {
    "pinhole": (),
    "pinhole_radial_k1": _OPENMVG_LENSES["disto_k1"],
    "pinhole_radial_k3": _OPENMVG_LENSES["disto_k3"],
    "pinhole_brown_t2": _OPENMVG_LENSES["disto_t2"],
}
_OPENMVG_WITHOUT = {"width", "height", "focal_length", "principal_point", "value0"}


def cameras_in_tree(content: Values) -> dict[str, Values]:
    """Return the cameras of a file of these programs by name; none of any other file."""
    if isinstance(content.get("cameraData"), list):
        return dict(_of_depthai(content["cameraData"]))
    calibration = content.get("Calibration")
    if isinstance(calibration, Mapping) and isinstance(calibration.get("cameras"), list):
        return dict(_of_calibio(calibration["cameras"]))
    if isinstance(content.get("intrinsics"), list) and "sfm_data_version" in content:
        return dict(_of_openmvg(content["intrinsics"]))
    return dict(_of_veta(_veta_cameras(content)))


def _of_depthai(stated: Sequence[Any]) -> Iterator[tuple[str, Values]]:
    """Yield the cameras of a DepthAI device by their sockets, such as CAM_A."""
    for socket, camera in stated:
        lens = int(camera["cameraType"])
        if lens not in range(len(_DEPTHAI_LENSES)):
            raise OtherForm(f"its camera of type {lens} is not read", CALIBRATE_ANEW)
        coefficients = numbers_of("the distortion", camera["distortionCoeff"])
        yield (
            f"CAM_{chr(ord('A') + int(socket))}",
            {
                "cameramatrix": camera["intrinsicMatrix"],
                "distortioncoefficients": coefficients,
                "distortionmodel": _DEPTHAI_LENSES[lens],
                "imagesize": [camera["width"], camera["height"]],
                "program": "DepthAI",
            },
        )


def _of_calibio(stated: Sequence[Any]) -> Iterator[tuple[str, Values]]:
    """Yield the cameras of calib.io's calibrator, whose fy is the ratio `ar` times f."""
    for at, (model, data) in enumerate(_classes(camera["model"] for camera in stated)):
        if model != _CALIBIO:
            raise OtherForm(f"calib.io's model {model[:LONGEST_NAME]!r} is not read", CALIBRATE_ANEW)
        value = {plain_name(name): stated["val"] for name, stated in data["parameters"].items()}
        size = data["CameraModelCRT"]["CameraModelBase"]["imageSize"]
        f, ratio = numbers_of("f and ar", [value["f"], value["ar"]])
        yield (
            f"camera{at}",
            {
                "intrinsics": [f, f * ratio, value["cx"], value["cy"]],
                "distortioncoefficients": [value.get(plain_name(name), 0.0) for name in OPENCV],
                "distortionmodel": "opencv",
                "imagesize": [size["width"], size["height"]],
                "program": "calib.io",
            },
        )


def _of_openmvg(stated: Sequence[Any]) -> Iterator[tuple[str, Values]]:
    """Yield the cameras of an openMVG scene by their keys; what its lens is, the name of its coefficients says."""
    for camera, (_, data) in zip(stated, _classes(each["value"] for each in stated), strict=True):
        own = data.get("value0", data)
        f = own["focal_length"]
        lens: dict[str, Any] = {"distortioncoefficients": [], "distortionmodel": "opencv"}
        for name in sorted(data.keys() - _OPENMVG_WITHOUT):
            if name in _OPENMVG_LENSES:
                terms = dict(zip(_OPENMVG_LENSES[name], data[name], strict=True))
                lens["distortioncoefficients"] = [terms.get(term, 0.0) for term in OPENCV[:5]]
            elif name == "fisheye":
                lens = {"distortioncoefficients": data[name], "distortionmodel": "fisheye"}
            elif isinstance(data[name], list):
                raise OtherForm(f"openMVG's lens {name[:LONGEST_NAME]!r} is not read", CALIBRATE_ANEW)
        yield (
            f"camera{camera['key']}",
            {
                "intrinsics": [f, f, *own["principal_point"]],
                "imagesize": [own["width"], own["height"]],
                "program": "openMVG",
                **lens,
            },
        )


def _veta_cameras(content: Values) -> dict[str, Any]:
    """Return what iKalibr or eKalibr wrote of each camera, by its topic; a camera alone has no name."""
    alone = content.get("Intrinsics")
    if isinstance(alone, Mapping) and "polymorphic_name" in alone:  # those of an inertial unit have no class
        return {"": alone}
    result = content.get("CalibParam")
    inner = result.get("INTRI") if isinstance(result, Mapping) else None
    listed = inner.get("Camera") if isinstance(inner, Mapping) else None
    return {str(camera["key"]): camera["value"] for camera in listed} if isinstance(listed, list) else {}


def _of_veta(cameras: Mapping[str, Any]) -> Iterator[tuple[str, Values]]:
    """Yield the cameras of iKalibr and eKalibr, whose order of Brown's coefficients is k1 k2 k3 p1 p2."""
    for name, (kind, data) in zip(cameras, _classes(iter(cameras.values())), strict=True):
        stated = numbers_of("the distortion", data.get("disto_param", []))
        is_fisheye = kind == "pinhole_fisheye"
        if not is_fisheye and kind not in _VETA_LENSES:
            raise OtherForm(f"veta's camera {kind[:LONGEST_NAME]!r} is not read", CALIBRATE_ANEW)
        terms = {} if is_fisheye else dict(zip(_VETA_LENSES[kind], stated, strict=True))
        yield (
            name,
            {
                "cameramatrix": [data["focal_length"], data["principal_point"]],
                "imagesize": [data["img_width"], data["img_height"]],
                "distortioncoefficients": stated if is_fisheye else [terms.get(k, 0.0) for k in OPENCV[:5]],
                "distortionmodel": "fisheye" if is_fisheye else "opencv",
                "program": "iKalibr or eKalibr",
            },
        )


def _classes(stated: Iterator[Any]) -> Iterator[tuple[str, Any]]:
    """Yield class and data of what cereal wrote: it names a class once, and its number alone after that."""
    names: dict[int, str] = {}
    for wrapped in stated:
        number = int(wrapped.get("polymorphic_id", 0)) % _FIRST_OF_A_NAME
        name = names.setdefault(number, str(wrapped.get("polymorphic_name", "")))
        yield name, wrapped["ptr_wrapper"]["data"]
