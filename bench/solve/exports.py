"""Export of the calibrated camera to the file formats of other programs.

Each writer handles one format: its field names, its conventions, and the lens models that it can represent. If a format
cannot represent the lens model, the export is refused; coefficients are never dropped. Writers change conventions only.
Kalibr's radtan has no k3: it gets the coefficients that project the same within 0.05 px, or nothing.

====================  ========================================================================
file                  read by
====================  ========================================================================
opencv.yaml           ``cv::FileStorage``
ros_camera_info.yaml  ROS camera_info_manager, camera_calibration_parsers
kalibr_camchain.yaml  Kalibr (radtan: k3 is fitted into the others)
mrcal.cameramodel     mrcal (no fisheye of this kind)
colmap_cameras.txt    COLMAP (pixel centres at half integers there: principal point + 0.5)
metavision.json       Metavision SDK 4 (intrinsics.json; no fisheye)
camera-geometry.json  Metavision SDK 5 (no fisheye)
boresight.yaml        ROS static_transform_publisher, as a quaternion
====================  ========================================================================

A fisheye lens (kb1 to kb4; Kannala and Brandt, 2006) has the same four coefficients everywhere: OpenCV's
``cv::fisheye``, ROS's and Kalibr's ``equidistant``, COLMAP's ``OPENCV_FISHEYE``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import cv2
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from bench.base.errors import BenchError
from calib.boards.board import Board
from calib.calibration import Calibration
from calib.model.camera import SKEW, CameraModel, nearest_lens
from calib.model.lens import BROWN, FISHEYE, OPENCV, PRISM
from calib.model.result_parts import Boresight
from calib.target import StarTarget

PLUMB_BOB = BROWN[:5]
"""The coefficients of ROS's model plumb_bob, and of OpenCV with five coefficients."""
_RADTAN = BROWN[:4]
_MOST_CHANGE_PX = 0.05  # By which radtan, without k3, may project otherwise
#: ROS's names of the distortion models, by number of coefficients.
_ROS_MODELS = {4: "equidistant", 5: "plumb_bob", 8: "rational_polynomial"}

NOT_WRITTEN = "not-written.txt"
"""File that lists the formats that cannot represent the lens model or the targets, with the reason."""

CAMERA_INFO = "camera_info.yaml"

Writer = Callable[[Calibration, str], bytes]


class FormatCannotCarry(BenchError):
    """The file format cannot represent this lens model, or these targets."""


def refuse_beyond(names: Sequence[str], camera: CameraModel, what: str) -> None:
    """Refuse a lens with other coefficients, or a skew, than a format has: programs ignore what they do not know."""
    further = [name for name in camera.distortion if name not in names]
    if further:
        lens = "a fisheye lens" if camera.is_fisheye and FISHEYE[0] in further else ", ".join(further)
        raise FormatCannotCarry(
            f"{what} cannot represent {lens}.",
            remedy=f"For this format, calibrate with no other coefficients than {' '.join(names)}.",
        )


def opencv_coefficients(camera: CameraModel) -> np.ndarray:
    """Return OpenCV's coefficients: (4,) of a fisheye lens, (5,) k1 k2 p1 p2 k3, (8,), (12,) or (14,)."""
    if camera.is_fisheye:
        return camera.fisheye_coefficients
    further = set(camera.distortion) - {*PLUMB_BOB, SKEW}
    return camera.coefficients if further else camera.coefficients[: len(PLUMB_BOB)]


def target_poses(calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses camera <- target: (n, 3) rotation vectors, rad, and (n, 3) translations, mm."""
    rotations = calibration.rotations
    vectors = np.array([cv2.Rodrigues(rotation)[0].ravel() for rotation in rotations])
    return vectors, -np.einsum("nij,nj->ni", rotations, calibration.centres)


def image_size_fields(camera: CameraModel) -> dict[str, int]:
    """Return the size of the image as ROS and OpenCV name it: ``image_width`` and ``image_height``, px."""
    return {"image_width": camera.image_size[0], "image_height": camera.image_size[1]}


def ros_matrix(matrix: np.ndarray) -> dict[str, Any]:
    """Return an (m, n) matrix as ROS writes it: ``rows``, ``cols`` and ``data``, row after row."""
    return {"rows": matrix.shape[0], "cols": matrix.shape[1], "data": matrix.ravel().tolist()}


def yaml_bytes(content: Mapping[str, Any]) -> bytes:
    """Return a YAML file, UTF-8, with its keys in the given order."""
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=10_000).encode()


def file_storage_bytes(extension: str, content: Mapping[str, Any]) -> bytes:
    """Return a ``.yaml`` or ``.json`` file of ``cv::FileStorage``, the same with OpenCV 4 and 5."""
    storage = cv2.FileStorage(extension, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in content.items():
        _store(storage, name, value)
    text = storage.releaseAndGetString()
    # OpenCV 4 and 5 write different first lines; both, and OpenCV 3, read this one.
    return text.replace("%YAML 1.2", "%YAML:1.0", 1).encode()


def _store(storage: cv2.FileStorage, name: str, value: Any) -> None:
    if isinstance(value, Mapping):
        storage.startWriteStruct(name, cv2.FILE_NODE_MAP)
        for key, item in value.items():
            _store(storage, key, item)
        storage.endWriteStruct()
    elif isinstance(value, list):
        storage.startWriteStruct(name, cv2.FILE_NODE_SEQ)
        for item in value:
            _store(storage, "", item)
        storage.endWriteStruct()
    else:
        storage.write(name, value if isinstance(value, int | str | float) else np.ascontiguousarray(value))


def exports(
    calibration: Calibration,
    *,
    camera_name: str,
    target: StarTarget | Board | None = StarTarget(),  # noqa: B008 - immutable
) -> dict[str, bytes]:
    """Write a calibration in every format that can represent it, as content by file name.

    ``target`` None if the views show several. ``not-written.txt`` lists formats that cannot represent lens or targets,
    with the reason.
    """
    files: dict[str, bytes] = {}
    refused: list[str] = []
    camera_name = re.sub(r"[^A-Za-z0-9_]", "_", camera_name)
    described = partial(metavision_json, target=target)
    writers: dict[str, Writer] = {**WRITERS, "metavision.json": described}
    for name, write in writers.items():
        try:
            files[name] = write(calibration, camera_name)
        except FormatCannotCarry as refusal:
            refused.append(f"{name}: {refusal}\n")
    if calibration.boresight is not None:
        files["boresight.yaml"] = boresight_yaml(calibration.boresight, camera_name)
    if refused:
        files[NOT_WRITTEN] = "".join(refused).encode()
    return files


def opencv_yaml(calibration: Calibration, camera_name: str) -> bytes:
    """Write OpenCV's FileStorage YAML, as its calibration sample does, with covariance, poses (mm) and fisheye flag."""
    refuse_beyond((*OPENCV, *FISHEYE), calibration.camera, "OpenCV's YAML")
    return file_storage_bytes(
        ".yml",
        {
            "camera_name": camera_name,
            "nframes": len(calibration.views),
            **image_size_fields(calibration.camera),
            "fisheye_model": int(calibration.camera.is_fisheye),
            "camera_matrix": calibration.camera.matrix,
            "distortion_coefficients": opencv_coefficients(calibration.camera)[None],
            "avg_reprojection_error": calibration.rms_px,
            "per_view_reprojection_errors": np.array([[view.rms_px] for view in calibration.views]),
            "extrinsic_parameters": np.hstack(target_poses(calibration)),
            "parameter_names": list(calibration.parameter_names),
            "parameter_covariance": calibration.covariance,
        },
    )


def ros_camera_info(calibration: Calibration, camera_name: str) -> bytes:
    """Write a ROS camera_info YAML with ``plumb_bob``, ``rational_polynomial`` or ``equidistant`` distortion."""
    return camera_info(calibration.camera, camera_name, calibration.camera.matrix)


def camera_info(
    camera: CameraModel, camera_name: str, projection: np.ndarray, rectification: np.ndarray | None = None
) -> bytes:
    """Write a ROS camera_info YAML; ``projection`` is (3, 3), of a pair (3, 4), ``rectification`` (3, 3) or None.

    FormatCannotCarry: the camera has a skew, a thin prism or a tilted sensor.
    """
    refuse_beyond(FISHEYE if camera.is_fisheye else BROWN, camera, CAMERA_INFO)
    coefficients = opencv_coefficients(camera)
    whole = np.zeros((3, 4))
    whole[:, : projection.shape[1]] = projection
    return yaml_bytes(
        {
            **image_size_fields(camera),
            "camera_name": camera_name,
            "camera_matrix": ros_matrix(camera.matrix),
            "distortion_model": _ROS_MODELS[len(coefficients)],
            "distortion_coefficients": ros_matrix(coefficients[None]),
            "rectification_matrix": ros_matrix(np.eye(3) if rectification is None else rectification),
            "projection_matrix": ros_matrix(whole),
        }
    )


def kalibr_camchain(calibration: Calibration, camera_name: str) -> bytes:
    """Write a Kalibr camchain; `FormatCannotCarry` if its coefficients do not project as the lens does."""
    remark, content = kalibr_camera(calibration.camera, camera_name)
    return remark + yaml_bytes({"cam0": content})


def kalibr_camera(camera: CameraModel, camera_name: str) -> tuple[bytes, dict[str, Any]]:
    """Return a remark and the content of one camera of a camchain, as `kalibr_camchain` writes it."""
    refuse_beyond((*OPENCV, *FISHEYE), camera, "Kalibr's camchain")
    whole, remark = camera, b""
    if not camera.is_fisheye and set(camera.distortion) - set(_RADTAN):
        camera, change_px = nearest_lens(camera, _RADTAN)
        if not change_px <= _MOST_CHANGE_PX:
            refuse_beyond(_RADTAN, whole, "Kalibr's radtan")
        remark = (
            f"# Kalibr's radtan has no k3. These values were fitted to those of results.json: they project the same"
            f" within {change_px:.1g} px.\n"
        ).encode()
    values = (camera.fx, camera.fy, camera.cx, camera.cy, *opencv_coefficients(camera)[:4].tolist())
    # The last digits of fitted values are others on other processors.
    numbers = [float(f"{value:.{12 if remark else 17}g}") for value in values]
    return remark, {
        "camera_model": "pinhole",
        "intrinsics": numbers[:4],
        "distortion_model": "equidistant" if camera.is_fisheye else "radtan",
        "distortion_coeffs": numbers[4:],
        "resolution": list(camera.image_size),
        "rostopic": f"/{camera_name}/events",
        "cam_overlaps": [],
    }


def mrcal_cameramodel(calibration: Calibration, camera_name: str) -> bytes:
    """Write a mrcal cameramodel: LENSMODEL_OPENCV5 or 8, not a fisheye lens, with the camera at the origin."""
    camera = calibration.camera
    refuse_beyond((*BROWN, *PRISM), camera, "mrcal's cameramodel")
    coefficients = opencv_coefficients(camera)
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy, *coefficients.tolist()]
    return (
        f"# {camera_name}\n{{\n"
        f"    'lensmodel':  'LENSMODEL_OPENCV{len(coefficients)}',\n"
        f"    'intrinsics': {numbers!r},\n"
        f"    'extrinsics': {[0.0] * 6!r},\n"
        f"    'imagersize': {list(camera.image_size)!r}\n}}\n"
    ).encode()


def colmap_cameras(calibration: Calibration, camera_name: str) -> bytes:
    """Write COLMAP's cameras.txt: OPENCV, FULL_OPENCV or OPENCV_FISHEYE; the principal point is shifted by 0.5 px."""
    camera = calibration.camera
    refuse_beyond((*BROWN, *FISHEYE), camera, "COLMAP's cameras.txt")
    if camera.is_fisheye:
        model, coefficients = "OPENCV_FISHEYE", camera.fisheye_coefficients
    elif set(camera.distortion) - set(_RADTAN):
        model, coefficients = "FULL_OPENCV", camera.coefficients
    else:
        model, coefficients = "OPENCV", camera.coefficients[:4]
    numbers = [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5, *coefficients.tolist()]
    size = " ".join(str(side) for side in camera.image_size)
    text = " ".join(repr(number) for number in numbers)
    return f"# {camera_name}\n# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {model} {size} {text}\n".encode()


def metavision_json(
    calibration: Calibration,
    camera_name: str,
    target: StarTarget | Board | None = StarTarget(),  # noqa: B008 - immutable
) -> bytes:
    """Write Metavision SDK 4's intrinsics.json, in m; a fisheye lens or several targets: `FormatCannotCarry`.

    ``pattern`` describes the squares of the star target, because the format has no stars, or the points of a board.
    """
    refuse_beyond(OPENCV, calibration.camera, "Metavision's intrinsics.json")
    if target is None:
        raise FormatCannotCarry(
            "Metavision's intrinsics.json describes one target; the views show several.",
            remedy="For this format, calibrate only with views of one target.",
        )
    rotations, translations = target_poses(calibration)
    if isinstance(target, Board):
        columns, rows = target.columns, target.rows
    else:
        columns, rows = target.squares_x, target.squares_y
    text = file_storage_bytes(
        ".json",
        {
            "camera_name": camera_name,
            "n_kept_views": len(calibration.views),
            "image_size": list(calibration.camera.image_size),
            "pattern": {
                "n_rows": rows,
                "n_cols": columns,
                "square_height": target.pitch_mm / 1000,
                "square_width": target.pitch_mm / 1000,
            },
            "camera_matrix": calibration.camera.matrix,
            "distortion_coefficients": opencv_coefficients(calibration.camera)[None],
            "selected_views": [1] * len(calibration.views),
            "overall_rms_reprojection_error": calibration.rms_px,
            "per_view_rms_reprojection_errors": [view.rms_px for view in calibration.views],
            "rvecs": list(rotations[:, None]),
            "tvecs": list(translations[:, None] / 1000),
        },
    )
    json.loads(text)  # OpenCV is lenient about JSON; other readers are not
    return text


def camera_geometry_json(calibration: Calibration, camera_name: str) -> bytes:
    """Write Metavision SDK 5's camera-geometry.json, K by rows, D k1 k2 p1 p2 k3; or raise `FormatCannotCarry`."""
    del camera_name
    camera = calibration.camera
    refuse_beyond(PLUMB_BOB, camera, "Metavision's camera-geometry.json")
    width, height = camera.image_size
    content = {
        "type": "pinhole",
        "width": width,
        "height": height,
        "K": camera.matrix.ravel().tolist(),
        "D": opencv_coefficients(camera).tolist(),
    }
    return (json.dumps(content, indent=2) + "\n").encode()


def boresight_yaml(boresight: Boresight, camera_name: str) -> bytes:
    """Write flange to camera with the names of ROS's static_transform_publisher; the translation is not measured."""
    x, y, z, w = Rotation.from_matrix(boresight.rotation.T).as_quat().tolist()
    return yaml_bytes(
        {
            "frame_id": "flange",
            "child_frame_id": f"{camera_name}_optical_frame",
            "rotation": {"x": x, "y": y, "z": z, "w": w},
            "camera_from_flange": ros_matrix(boresight.rotation),
            "covariance_rad2": ros_matrix(boresight.covariance),
            "expanded_deg": boresight.expanded_deg.tolist(),
        }
    )


WRITERS: Mapping[str, Writer] = {
    "opencv.yaml": opencv_yaml,
    "ros_camera_info.yaml": ros_camera_info,
    "kalibr_camchain.yaml": kalibr_camchain,
    "mrcal.cameramodel": mrcal_cameramodel,
    "colmap_cameras.txt": colmap_cameras,
    "metavision.json": metavision_json,
    "camera-geometry.json": camera_geometry_json,
}
"""Writer of each file."""
