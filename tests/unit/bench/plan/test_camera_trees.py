"""Cameras that lie deep in files of DepthAI, calib.io, openMVG and eKalibr, and in COLMAP's binary file: rays as the programs'.

Each file is written here, as the program's documentation or source has it.
"""

import json
import struct
from pathlib import Path

import pytest
from camera_oracle import D5, D14, FISHEYE, FOCAL_AND_CENTRE, SIZE, K, off_px

from bench.plan.camera_files import NotACamera, parse_camera

FX, FY, CX, CY = FOCAL_AND_CENTRE
K1, K2, P1, P2, K3 = D5
SQUARE = [[FX, 0.0, CX], [0.0, FX, CY], [0.0, 0.0, 1.0]]
SIDES = {"width": SIZE[0], "height": SIZE[1]}
NAMES = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tauX", "tauY"]


def parse(content, name=None):
    data = content if isinstance(content, bytes) else json.dumps(content).encode()
    return parse_camera(data, Path("f"), name)


def depthai(*cameras):
    """depthai-core, EepromData: sockets with their cameras."""
    listed = [
        [socket, {
            "cameraType": lens, "distortionCoeff": coefficients, **SIDES, "intrinsicMatrix": K, "lensPosition": 0,
            "specHfovDeg": 68.8, "extrinsics": {"toCameraSocket": -1, "translation": {"x": 0.0, "y": 0.0, "z": 0.0}},
        }]
        for socket, lens, coefficients in cameras
    ]  # fmt: skip
    return {"boardName": "OAK-D", "boardRev": "R1", "cameraData": listed, "version": 7}


def calibio(*cameras, model="libCalib::CameraModelOpenCV"):
    """calib.io's camera calibrator, JSON of a project; cereal names a class once."""
    values = {"f": FX, "ar": FY / FX, "cx": CX, "cy": CY}
    listed = []
    for at, coefficients in enumerate(cameras):
        stated = {**values, **dict(zip(NAMES, coefficients, strict=True))}
        data = {
            "parameters": {name: {"state": 2, "val": value} for name, value in stated.items()},
            "CameraModelCRT": {"CameraModelBase": {"imageSize": SIDES}},
        }
        named = (
            {"polymorphic_id": (1 << 31) + 1, "polymorphic_name": model} if not at else {"polymorphic_id": 1}
        )
        listed.append({"model": {**named, "ptr_wrapper": {"id": 7 + at, "data": data}}, "transform": {}})
    return {"Calibration": {"cameras": listed, "boards": []}}


def openmvg(*cameras, inner=True):
    """openMVG, sfm_data.json; with and without a level for the base class, as its versions write it."""
    own = {**SIDES, "focal_length": FX, "principal_point": [CX, CY]}
    listed = [
        {"key": key, "value": {
            "polymorphic_id": 3, **({} if key else {"polymorphic_name": "pinhole_radial_k3"}),
            "ptr_wrapper": {"id": 9, "data": {**({"value0": own} if inner else own), **lens}},
        }}
        for key, lens in enumerate(cameras)
    ]  # fmt: skip
    return {"sfm_data_version": "0.3", "root_path": "", "views": [], "intrinsics": listed, "extrinsics": []}


def veta(kind, coefficients, number=(1 << 31) + 1):
    """veta, the library of iKalibr and eKalibr: config/cam-intri-pinhole-brown.yaml; cereal names a class once."""
    data = {"img_width": 1280, "img_height": 720, "focal_length": [FX, FY], "principal_point": [CX, CY]}
    data |= {"disto_param": coefficients} if coefficients else {}
    named = {"polymorphic_name": kind} if number > 1 << 31 else {}
    return {"polymorphic_id": number, **named, "ptr_wrapper": {"id": 1, "data": data}}


def ekalibr(*cameras):
    """eKalibr, calib_param_mgr.cpp: its result, cameras by their topics."""
    listed = [{"key": f"/dvs{at}/events", "value": camera} for at, camera in enumerate(cameras)]
    return {"CalibParam": {"EXTRI": {}, "INTRI": {"IMU": [], "Camera": listed}}}


def colmap(*cameras):
    """COLMAP, src/colmap/scene/reconstruction_io_binary.cc; the pixel centres lie at half integers."""
    data = struct.pack("<Q", len(cameras))
    for number, (model, coefficients) in enumerate(cameras, start=1):
        values = [FX, FY, CX + 0.5, CY + 0.5, *coefficients]
        data += struct.pack(f"<iiQQ{len(values)}d", number, model, *SIZE, *values)
    return data


READ = {
    "DepthAI, 14 coefficients": (depthai((0, 0, D14)), D14, K),
    "DepthAI without any": (depthai((1, 0, [])), [], K),
    "calib.io": (calibio(D14), D14, K),
    "openMVG, radial": (openmvg({"disto_k3": [K1, K2, K3]}), [K1, K2, 0.0, 0.0, K3], SQUARE),
    "openMVG, one coefficient": (openmvg({"disto_k1": [K1]}, inner=False), [K1], SQUARE),
    "openMVG, Brown": (openmvg({"disto_t2": [K1, K2, K3, P1, P2]}), D5, SQUARE),
    "openMVG, pinhole": (openmvg({}), [], SQUARE),
    "iKalibr": ({"Intrinsics": veta("pinhole_brown_t2", [K1, K2, K3, P1, P2])}, D5, K),
    "iKalibr, pinhole": ({"Intrinsics": veta("pinhole", [])}, [], K),
    "eKalibr": (ekalibr(veta("pinhole_brown_t2", [K1, K2, K3, P1, P2])), D5, K),
    "COLMAP OPENCV": (colmap((4, D5[:4])), D5[:4], K),
    "COLMAP FULL_OPENCV": (colmap((6, D14[:8])), D14[:8], K),
}


@pytest.mark.parametrize(("content", "coefficients", "matrix"), READ.values(), ids=READ)
def test_the_rays_of_a_camera_are_those_of_opencv(content, coefficients, matrix):
    camera = parse(content).camera
    assert camera.image_size == SIZE
    stated = coefficients if len(coefficients) > 1 else [*coefficients, 0.0, 0.0, 0.0, 0.0][:5]
    assert off_px(camera, stated, matrix=matrix) < 1e-6


FISHEYES = {
    "DepthAI": (depthai((2, 1, FISHEYE + [0.0] * 10)), K),
    "openMVG": (openmvg({"fisheye": FISHEYE}), SQUARE),
    "iKalibr": ({"Intrinsics": veta("pinhole_fisheye", FISHEYE)}, K),
    "COLMAP": (colmap((5, FISHEYE)), K),
}


@pytest.mark.parametrize(("content", "matrix"), FISHEYES.values(), ids=FISHEYES)
def test_the_rays_of_a_fisheye_are_those_of_opencv(content, matrix):
    assert off_px(parse(content).camera, FISHEYE, fisheye=True, matrix=matrix) < 1e-6


SEVERAL = {
    "DepthAI": (depthai((0, 0, D14), (2, 0, D5)), "CAM_A, CAM_C", "CAM_C"),
    "calib.io": (calibio(D14, [*D5, *[0.0] * 9]), "camera0, camera1", "camera1"),
    "openMVG": (openmvg({"disto_k1": [K1]}, {"disto_k3": [K1, K2, K3]}), "camera0, camera1", "camera1"),
    "eKalibr": (
        ekalibr(veta("pinhole_brown_t2", [K1, K2, 0.0, P1, P2]), veta("", [K1, K2, K3, P1, P2], 1)),
        "/dvs0/events, /dvs1/events",
        "/dvs1/events",
    ),
    "COLMAP": (colmap((1, []), (4, D5[:4])), "1, 2", "2"),
}


@pytest.mark.parametrize(("content", "listed", "name"), SEVERAL.values(), ids=SEVERAL)
def test_one_of_several_cameras_is_named(content, listed, name):
    with pytest.raises(NotACamera) as error:
        parse(content)
    assert listed in error.value.what
    assert parse(content, name).camera.distortion["k2"] == K2


REFUSED = {
    "DepthAI, another lens": (depthai((0, 3, D5)), "camera of type 3"),
    "calib.io, another model": (calibio(D14, model="libCalib::CameraModelDivision"), "CameraModelDivision"),
    "iKalibr, an inertial unit": ({"Intrinsics": {"ptr_wrapper": {"id": 1, "data": {"ACCE": {}}}}}, "no camera matrix"),
    "veta, another lens": ({"Intrinsics": veta("pinhole_division", [0.1])}, "'pinhole_division'"),
    "openMVG, another lens": (openmvg({"thin_prism": FISHEYE}), "'thin_prism'"),
    "openMVG, spherical": (
        {"sfm_data_version": "0.3", "intrinsics": [{"key": 0, "value": {"ptr_wrapper": {"data": dict(SIDES)}}}]},
        "it has no 'focal_length'",
    ),
    "COLMAP, another model": (colmap((10, [0.0] * 8)), "THIN_PRISM_FISHEYE is not read"),
    "COLMAP, EUCM": (colmap((16, [0.6, 1.1])), "EUCM is not read"),
    "COLMAP, FOV": (colmap((7, [0.9])), "FOV is not read"),
    "COLMAP, a value too few": (colmap((4, D5[:3])), "has 8 values; camera 1 has 7"),
    "COLMAP, cut": (colmap((4, D5[:4]), (4, D5[:4]))[: 8 + 24 + 64 + 10], "ends before its last camera"),
    "COLMAP, more": (colmap((4, D5[:4])) + b"more", "more bytes follow"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "why"), REFUSED.values(), ids=REFUSED)
def test_what_is_not_read_is_named(content, why):
    with pytest.raises(NotACamera) as error:
        parse(content)
    assert why in error.value.what
