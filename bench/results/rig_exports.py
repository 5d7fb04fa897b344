"""Export of a rig of two cameras: Kalibr, ROS with rectification, OpenCV, and the extrinsics of Metavision SDK 5.

Conventions: X_second = R X_first + t, with t in metres in files of Kalibr, ROS and Metavision, and in mm in OpenCV's.
The first camera is cam0, the second cam1.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.results.exports import (
    NOT_WRITTEN,
    FormatCannotCarry,
    camera_info,
    file_storage_bytes,
    kalibr_camera,
    opencv_coefficients,
    refuse_skew,
    yaml_bytes,
)
from calib.model.rotation import log_map
from calib.studies.rig import Rig

Array = NDArray[np.float64]

_NAMES = ("cam0", "cam1")


def rig_exports(rig: Rig, content: Mapping[str, Any]) -> dict[str, bytes]:
    """Return file name to content, for a rig with a translation; ``not-written.txt`` says what is missing and why."""
    files = {
        "rig.json": (json.dumps(content, indent=2, allow_nan=False) + "\n").encode(),
        "extrinsics.json": _extrinsics(rig),
    }
    refused = []
    for name, write in {"kalibr_camchain.yaml": _camchain, "stereo": _stereo}.items():
        try:
            for camera in (rig.first, rig.second):
                refuse_skew(camera, name)
            files |= write(rig)
        except FormatCannotCarry as refusal:
            refused.append(f"{name}: {refusal}\n")
    if refused:
        files[NOT_WRITTEN] = "".join(refused).encode()
    return files


def _metres(rig: Rig) -> Array:
    assert rig.translation_mm is not None
    return rig.translation_mm / 1000.0


def _extrinsics(rig: Rig) -> bytes:
    """Write the extrinsics.json of Metavision SDK 5: the slave's pose for a point of the master."""
    one = {
        "camera": _NAMES[1],
        "rvec": log_map(rig.rotation[None])[0].tolist(),
        "tvec": _metres(rig).tolist(),
    }
    return (json.dumps({"T_slave_master": [one]}, indent=4) + "\n").encode()


def _camchain(rig: Rig) -> dict[str, bytes]:
    """Write Kalibr's camchain; ``T_cn_cnm1`` takes points of the camera before to this one."""
    told, chain = b"", {}
    for name, camera in zip(_NAMES, (rig.first, rig.second), strict=True):
        remark, chain[name] = kalibr_camera(camera, name)
        told += remark
        chain[name]["cam_overlaps"] = [1 - _NAMES.index(name)]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rig.rotation, _metres(rig)
    chain[_NAMES[1]]["T_cn_cnm1"] = pose.tolist()
    return {"kalibr_camchain.yaml": told + yaml_bytes(chain)}


def _stereo(rig: Rig) -> dict[str, bytes]:
    """Write the pair of ROS's camera_info, and OpenCV's stereo file, with the rectification that both share."""
    first, second = rig.first, rig.second
    if first.image_size != second.image_size or first.is_fisheye != second.is_fisheye:
        raise FormatCannotCarry(
            "A rectified pair needs two cameras with images of one size and lenses of one family.",
            remedy="Use kalibr_camchain.yaml or extrinsics.json.",
        )
    lenses = [opencv_coefficients(camera) for camera in (first, second)]
    inputs = (first.matrix, lenses[0], second.matrix, lenses[1], first.image_size, rig.rotation)
    place = 1000.0 * _metres(rig)[:, None]
    if first.is_fisheye:
        r1, r2, p1, p2, q = cv2.fisheye.stereoRectify(*inputs, place, cv2.CALIB_ZERO_DISPARITY)
    else:
        r1, r2, p1, p2, q, *_ = cv2.stereoRectify(*inputs, place, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1)
    metres = np.diag([1.0, 1.0, 1.0, 1e-3])
    pair = zip(_NAMES, (first, second), (r1, r2), (p1 @ metres, p2 @ metres), strict=True)
    files = {
        f"{name}_camera_info.yaml": camera_info(camera, name, projection, turn)
        for name, camera, turn, projection in pair
    }
    content = {
        "image_width": first.image_size[0],
        "image_height": first.image_size[1],
        "fisheye_model": int(first.is_fisheye),
        "M1": first.matrix,
        "D1": lenses[0][None],
        "M2": second.matrix,
        "D2": lenses[1][None],
        "R": rig.rotation,
        "T": place,
        "R1": r1,
        "R2": r2,
        "P1": p1,
        "P2": p2,
        "Q": q,
        "pose_covariance": rig.pose_covariance,
    }
    return {**files, "opencv_stereo.yaml": file_storage_bytes(".yml", content)}
