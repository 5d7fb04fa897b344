"""Cameras as programs lay them out: the rays are those of the program's own formula, or the doubt is named.

Each text is written here, as the program's documentation or source has it.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from camera_oracle import D5, FISHEYE, FLAT_K, FOCAL_AND_CENTRE, POINTS, SIZE, K, off_px

from bench.plan.camera_files import NotACamera, parse_camera

FX, FY, CX, CY = FOCAL_AND_CENTRE
K1, K2, P1, P2, K3 = D5
D8 = [*D5, 0.2, 0.1, 0.01]
NAMED = {"k1": K1, "k2": K2, "p1": P1, "p2": P2, "k3": K3}
FOUR = {"fx": FX, "fy": FY, "cx": CX, "cy": CY}
LISTS = {"camera_matrix": K, "image_size": SIZE}
YAML = "%YAML:1.0\n---\n"


def parse(text, name=None, lens=None):
    return parse_camera(
        text.encode() if isinstance(text, str) else json.dumps(text).encode(), Path("f"), name, lens
    )


def lines(values, before="", sign=":"):
    return "".join(f"{before}{name}{sign} {value}\n" for name, value in values.items())


def xml(values):
    return (
        f"<calibration>{''.join(f'<{name}>{value}</{name}>' for name, value in values.items())}</calibration>"
    )


def basalt(camera_type, intrinsics):
    """Basalt's calibration.json (basalt-headers, cereal), as TUM-VIE publishes it."""
    model = {"camera_type": camera_type, "intrinsics": {**FOUR, **intrinsics}}
    return {
        "value0": {
            "T_imu_cam": [{"px": 0.0, "qw": 1.0}],
            "intrinsics": [model],
            "resolution": [SIZE],
        }
    }


def okvis(lens, coefficients):
    """OKVIS and OKVIS 2, config/*.yaml: a list of cameras in braces, with a kind of picture as ``camera_type``."""
    return (
        f"{YAML}cameras:\n     - {{T_SC:\n        [1.0, 0.0, 0.0, 0.0],\n        image_dimension: [1280, 720],\n"
        f"        distortion_coefficients: {coefficients},\n        distortion_type: {lens},\n"
        f"        focal_length: [{FX}, {FY}],\n        principal_point: [{CX}, {CY}],\n"
        "        camera_type: gray, #gray, rgb, gray+depth\n        slam_use: okvis}\n"
    )


#: ORB-SLAM3, Examples/Monocular/EuRoC.yaml; with `Camera.` of ORB-SLAM2.
ORB_SLAM = {**FOUR, **NAMED}
SIDES = {"width": SIZE[0], "height": SIZE[1]}
#: camodocal and VINS-Fusion, config/euroc/cam0_pinhole.yaml.
VINS = (
    f"{YAML}model_type: PINHOLE\ncamera_name: camera\nimage_width: 1280\nimage_height: 720\n"
    f"distortion_parameters:\n{lines({'k1': K1, 'k2': K2, 'p1': P1, 'p2': P2}, '   ')}"
    f"projection_parameters:\n{lines(FOUR, '   ')}"
)
#: vikit_common, camera_loader.h; used by FAST-LIVO and SVO.
VIKIT = lines({"model": "Pinhole", **SIDES, **FOUR, "d0": K1, "d1": K2, "d2": P1, "d3": P2}, "cam_")
#: librealsense's rs2_intrinsics, as scripts dump it.
REALSENSE = {
    **SIDES, "ppx": CX, "ppy": CY, "fx": FX, "fy": FY, "model": "distortion.brown_conrady", "coeffs": D5,
}  # fmt: skip
#: nerfstudio, transforms.json: the centre of the first pixel is (0.5, 0.5) there (nerfstudio#3048).
NERFSTUDIO = {
    "fl_x": FX, "fl_y": FY, "cx": CX + 0.5, "cy": CY + 0.5, "w": 1280, "h": 720, "camera_model": "OPENCV",
    **NAMED, "k4": 0.0, "frames": [{"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}],
}  # fmt: skip
#: MATLAB, jsonencode(toStruct(cameraParameters)): the centre of the first pixel is (1, 1), the height comes first.
MATLAB_K = [[FX, 0.0, CX + 1], [0.0, FY, CY + 1], [0.0, 0.0, 1.0]]
MATLAB = {
    "RadialDistortion": [K1, K2, K3], "TangentialDistortion": [P1, P2], "ImageSize": [720, 1280], "Skew": 0,
    "NumRadialDistortionCoefficients": 3, "EstimateSkew": False, "WorldUnits": "mm",
}  # fmt: skip
#: Camera Calibration Toolbox for MATLAB, Calib_Results.m.
TOOLBOX = (
    f"% Intrinsic and Extrinsic Camera Parameters\n\n%-- Focal length:\nfc = [ {FX} ; {FY} ];\n\n"
    f"%-- Principal point:\ncc = [ {CX} ; {CY} ];\n\n%-- Skew coefficient:\nalpha_c = 0.000000000000000;\n\n"
    f"%-- Distortion coefficients:\nkc = [ {' ; '.join(map(str, D5))} ];\n\n"
    "%-- Focal length uncertainty:\nfc_error = [ 0.5 ; 0.6 ];\n\n%-- Image size:\nnx = 1280;\nny = 720;\n"
)
#: Metashape, the XML of one calibration.
METASHAPE = {"projection": "frame", **SIDES, "f": FY, "cx": 4.7, "cy": -1.6}
#: BoofCV, CalibrationIO: t1 and t2 are OpenCV's p1 and p2.
BOOFCV = {"model": "pinhole_radial_tangential", "pinhole": {**FOUR, **SIDES, "skew": 0.0}}
#: aniposelib, calibration.toml.
ANIPOSE = (
    f'[cam_0]\nname = "A"\nsize = [ 1280, 720,]\nmatrix = {K}\ndistortions = {D5}\nrotation = [ 0.0, 0.0, 0.0,]\n\n'
    "[metadata]\nadjusted = false\n"
)
#: rpg_svo_pro and ze_oss, calibration of a rig.
RPG = (
    "cameras:\n- camera:\n    distortion:\n      parameters:\n        cols: 1\n        rows: 4\n"
    f"        data: {D5[:4]}\n      type: radial-tangential\n    image_height: 720\n    image_width: 1280\n"
    f"    intrinsics:\n      cols: 1\n      rows: 4\n      data: {FOCAL_AND_CENTRE}\n    label: cam0\n"
    "    line-delay-nanoseconds: 0\n    type: pinhole\n  T_B_C:\n    cols: 4\n    rows: 4\n    data: [1.0, 0.0]\nlabel: rig\n"
)
#: dv-processing, CameraCalibration.
DV = {
    "name": "DVXplorer", "position": "left", "resolution": SIZE, "focalLength": [FX, FY], "principalPoint": [CX, CY],
    "distortion": D5, "distortionModel": "radialTangential", "transformationToC0": [1.0, 0.0],
}  # fmt: skip

BROWN = {
    "ORB-SLAM2": (YAML + lines({**ORB_SLAM, **SIDES, "fps": 20.0}, "Camera."), D5),
    "ORB-SLAM2, a line without a blank": (
        YAML.replace("---\n", "") + lines({**ORB_SLAM, **SIDES}, "Camera.") + "Viewer.PointSize:2\n", D5,
    ),
    "stella_vslam": (
        f'Camera:\n  model: "perspective"\n{lines({**ORB_SLAM, "cols": 1280, "rows": 720}, "  ")}\nMapping:\n  ratio: 1.0\n', D5,
    ),
    "DSEC, rectified": (
        (f"intrinsics:\n  camRect0:\n    is_rectified: true\n    camera_model: pinhole\n    camera_matrix: {FOCAL_AND_CENTRE}\n"
        "    resolution: [1280, 720]\n"), [],
    ),
    "ORB-SLAM3": (
        f'{YAML}File.version: "1.0"\nCamera.type: "PinHole"\n{lines(SIDES, "Camera.")}{lines(ORB_SLAM, "Camera1.")}',
        D5,
    ),
    "VINS": (VINS, D5[:4]),
    "vikit": (VIKIT, D5[:4]),
    "vikit of SVO": (f"cam0:\n{VIKIT.replace('cam_', '  cam_').replace('Pinhole', 'PinholeRadialTangential')}", D5[:4]),
    "vikit without distortion": (lines({"model": "PinholeNoDistortion", **SIDES, **FOUR}, "cam_"), []),
    "rpg_svo_pro": (RPG, D5[:4]),
    "Basalt radtan8": (basalt("pinhole-radtan8", {**NAMED, "k4": 0.0, "k5": 0.0, "k6": 0.0, "rpmax": 2.7}), D5),
    "Basalt pinhole": (basalt("pinhole", {}), []),
    "RealSense": (REALSENSE, D5),
    "RealSense, the model as distortion": (
        {**{name: value for name, value in REALSENSE.items() if name != "model"}, "distortion": REALSENSE["model"]}, D5,
    ),
    "RealSense, inverse model of zeros": (
        {**REALSENSE, "model": "distortion.inverse_brown_conrady", "coeffs": [0.0] * 5}, [],
    ),
    "nerfstudio": (NERFSTUDIO, D5),
    "MATLAB": ({**MATLAB, "FocalLength": [FX, FY], "PrincipalPoint": [CX + 1, CY + 1], "K": MATLAB_K}, D5),
    "MATLAB, K alone": ({**MATLAB, "K": MATLAB_K}, D5),
    "MATLAB, IntrinsicMatrix": ({**MATLAB, "IntrinsicMatrix": np.array(MATLAB_K).T.tolist()}, D5),
    "MATLAB, two coefficients": ({**MATLAB, "RadialDistortion": [K1, K2], "K": MATLAB_K}, D5[:4]),
    "toolbox for MATLAB": (TOOLBOX, D5),
    # VSLAM-LAB
    "radtan5": ({"distortion_type": "radtan5", "focal_length": [FX, FY], "principal_point": [CX, CY], "image_dimension": SIZE, "D": D5}, D5),
    # CannyEVIT and others of VECtor's
    "distortion_factors": ({"Event": {"img_width": 1280, "img_height": 720, "intrinsic": {"rows": 3, "cols": 3, "data": FLAT_K}, "distortion_factors": D5}}, D5),
    "a tab behind a name": (lines({"camera_matrix": K, "image_size": [*SIZE], "D": D5}).replace(": ", ":\t"), D5),
    # mrpt::img::TCamera
    "MRPT": (f"[CAMERA_PARAMS]\nresolution=[1280 720]\n{lines(FOUR, sign='=')}dist=[{' '.join(map(str, D5))}]\n", D5),
    "coefficients beside the camera": ({"color": {**FOUR, **SIDES, "ppx": CX, "ppy": CY}, "distortion_coeffs": D5}, D5),
    # Coco-LIC, config/r3live/camera.yaml
    "vikit with five coefficients": (
        f"{YAML}image_width: 1280\nimage_height: 720\n" + lines({**FOUR, **{f"d{at}": value for at, value in enumerate(D5)}}, "cam_"), D5,
    ),
    # R3LIVE, config/r3live_config.yaml: another size stands above
    "R3LIVE": ({"image_width": 640, "r3live_vio": {"image_width": 1280, "image_height": 720, "camera_intrinsic": FLAT_K, "camera_dist_coeffs": D5}}, D5),
    # SensorsCalibration of OpenCalib, center_camera-intrinsic.json: the size is that of the distorted image
    "OpenCalib": ({"center_camera": {"sensor_name": "c", "param": {"img_dist_w": 1280, "img_dist_h": 720, "cam_K": {"rows": 3, "cols": 3, "data": K}, "cam_dist": {"rows": 1, "cols": 5, "data": [D5]}}}}, D5),
    # LARVIO, config/euroc.yaml
    "LARVIO": ({"resolution_width": 1280, "resolution_height": 720, "distortion_model": "radtan", "intrinsics": FOUR, "distortion_coeffs": dict(zip(("k1", "k2", "p1", "p2"), D5, strict=False))}, D5[:4]),
    "VINS with a mask": (VINS + "fisheye: 1\n", D5[:4]),
    "OKVIS": (okvis("radialtangential", D5[:4]), D5[:4]),
    "OKVIS, 8 coefficients": (okvis("radialtangential8", D8), D8),
    "OpenCV's interactive-calibration": (
        {"cameraResolution": SIZE, "cameraMatrix": K, "dist_coeffs": D5, "dist_coeffs_std_dev": [0.1] * 5}, D5,
    ),
    "aniposelib": (ANIPOSE, D5),
    "CalibDB": ({**LISTS, "distortion_coefficients": D5, "distortion_model": "rectilinear"}, D5),
    "multical": ({"cameras": {"cam1": {"model": "standard", "image_size": SIZE, "K": K, "dist": [D5]}}}, D5),
    "DV": ({"cameras": [DV], "version": "2.0"}, D5),
    "RPG's four and five in one list": ({"intrinsics": [*FOCAL_AND_CENTRE, *D5], "resolution": SIZE}, D5),
    "a list of cameras": ([{"K": K, "D": D5, "resolution": "1280x720"}], D5),
    "a matrix with a fourth column and row": (
        {**LISTS, "camera_matrix": [[*K[0], 0], [*K[1], 0], [*K[2], 0], [0, 0, 0, 1]], "dist": D5}, D5,
    ),
    "names in groups": ({"intrinsic": FOUR, "distortion": NAMED, "image_size": {"width": 1280, "height": 720}}, D5),
    # multicam_imu_calib (ros-misc-utilities), config/example_config.yaml
    "multicam_imu_calib": (
        {"cameras": [{"name": "c", "intrinsics": FOUR, "distortion_model": {"type": "radtan", "coefficients": D5[:4]}, "resolution": SIZE}]}, D5[:4],
    ),
    # MATLAB's mat2str
    "rows that end in a semicolon": (
        {**LISTS, "camera_matrix": "; ".join(" ".join(map(str, row)) for row in K), "dist": "; ".join(map(str, D5))}, D5,
    ),
    # pycolmap, Camera.todict: the values of a line of cameras.txt
    "pycolmap": (
        {"camera_id": 1, "model": "OPENCV", **SIDES, "params": [FX, FY, CX + 0.5, CY + 0.5, *D5[:4]], "has_prior_focal_length": False}, D5[:4],
    ),
    "numpy's print of an array": ({**LISTS, "dist": "[[-1.2e-01  8.0e-02  5.0e-04 -7.0e-04 -2.0e-02]]"}, D5),
    "P1 of OpenCV's stereo beside": (
        f"image_size: [1280, 720]\nM1: {FLAT_K}\nD1: {D5}\nP1: {[*FLAT_K, 0.0, 0.0, 0.0]}\n", D5,
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "coefficients"), BROWN.values(), ids=BROWN)
def test_the_rays_of_a_layout_are_those_of_opencv(text, coefficients):
    camera = parse(text).camera
    assert camera.image_size == SIZE
    assert off_px(camera, coefficients) < 1e-6


KANNALA_BRANDT = dict(zip(("k1", "k2", "k3", "k4"), FISHEYE, strict=True))
FISHEYES = {
    "ORB-SLAM3": f'{YAML}Camera.type: "KannalaBrandt8"\n{lines({**FOUR, **KANNALA_BRANDT, **SIDES}, "Camera.")}',
    "VINS: names one power higher": (
        f"{YAML}model_type: KANNALA_BRANDT\nimage_width: 1280\nimage_height: 720\nprojection_parameters:\n"
        + lines({f"k{at}": value for at, value in enumerate(FISHEYE, 2)} | dict(zip(("mu", "mv", "u0", "v0"), FOCAL_AND_CENTRE, strict=True)), "   ")
    ),
    # VINS-Mono, config/cla/cla_config.yaml: `fisheye` asks for a round mask
    "VINS: no mask": (
        f"{YAML}model_type: KANNALA_BRANDT\nimage_width: 1280\nimage_height: 720\nfisheye: 0\nprojection_parameters:\n"
        + lines({f"k{at}": value for at, value in enumerate(FISHEYE, 2)} | dict(zip(("mu", "mv", "u0", "v0"), FOCAL_AND_CENTRE, strict=True)), "   ")
    ),
    "DSEC with a kind of picture": {"camera_matrix": FOCAL_AND_CENTRE, "camera_type": "event", "distortion_model": "equidistant", "distortion_coeffs": FISHEYE, "resolution": SIZE},
    "vikit of SVO": lines(
        {"model": "PinholeEquidistant", **SIDES, **FOUR, **dict(zip(("d0", "d1", "d2", "d3"), FISHEYE, strict=True))}, "cam_"
    ),
    "vikit of FAST-LIVO": lines({"model": "EquidistantCamera", **SIDES, **FOUR}, "cam_") + lines(KANNALA_BRANDT),
    "type alone": {"type": "fisheye", "matrix": 0, "intrinsics": FOCAL_AND_CENTRE, "D": FISHEYE, "resolution": SIZE},
    "rpg_svo_pro": RPG.replace("radial-tangential", "equidistant").replace(str(D5[:4]), str(FISHEYE)),
    "Basalt": basalt("kb4", KANNALA_BRANDT),
    "OKVIS 2": okvis("equidistant", FISHEYE),
    "nerfstudio": {**{name: value for name, value in NERFSTUDIO.items() if name not in NAMED}, **KANNALA_BRANDT, "camera_model": "OPENCV_FISHEYE"},
    "aniposelib": ANIPOSE.replace(str(D5), str(FISHEYE)).replace("rotation", "fisheye = true\nrotation"),
    "yes": {**LISTS, "D": FISHEYE, "fisheye": "yes"},
    # cameraIntrinsicsKB
    "MATLAB": {"FocalLength": [FX, FY], "PrincipalPoint": [CX + 1, CY + 1], "K": MATLAB_K, "DistortionCoefficients": FISHEYE, "ImageSize": [720, 1280]},
    # scripts around cv2.fisheye
    "DIM": {"DIM": SIZE, "K": K, "D": [[value] for value in FISHEYE], "model": "fisheye"},
}  # fmt: skip


@pytest.mark.parametrize("text", FISHEYES.values(), ids=FISHEYES)
def test_the_rays_of_a_fisheye_layout_are_those_of_opencv(text):
    assert off_px(parse(text).camera, FISHEYE, fisheye=True) < 1e-6


def test_the_rays_of_metashape_are_those_of_its_manual():
    """Metashape Professional manual, appendix C: p1 along x, u = w / 2 + cx + x' f + x' b1 + y' b2; first pixel at 0.5."""
    f, cx, cy, b1, b2 = 1049.1, 4.7, -1.6, 1.2, -0.8
    stated = {
        "projection": "frame", **SIDES, "f": f, "cx": cx, "cy": cy, "b1": b1, "b2": b2, "k1": K1, "k2": K2, "k3": K3,
        "p1": 3e-4, "p2": -9e-4, "date": "2026-01-01T00:00:00Z",
    }  # fmt: skip
    text = "".join(f"  <{name}>{value}</{name}>\n" for name, value in stated.items())
    camera_file = parse(f'<?xml version="1.0" encoding="UTF-8"?>\n<calibration>\n{text}</calibration>\n')
    x, y = (camera_file.camera.rays(POINTS)[:, :2] / camera_file.camera.rays(POINTS)[:, 2:]).T
    r2 = x**2 + y**2
    radial = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
    bent_x = x * radial + 3e-4 * (r2 + 2 * x**2) + 2 * -9e-4 * x * y
    bent_y = y * radial + -9e-4 * (r2 + 2 * y**2) + 2 * 3e-4 * x * y
    u, v = 640 + cx + bent_x * f + bent_x * b1 + bent_y * b2, 360 + cy + bent_y * f
    assert np.abs(np.column_stack([u, v]) - 0.5 - POINTS).max() < 1e-6
    assert "Metashape" in camera_file.kind


def test_the_cameras_of_an_orb_slam_stereo_file_are_named():
    text = (
        YAML
        + lines(SIDES, "Camera.")
        + lines(ORB_SLAM, "Camera1.")
        + lines({**ORB_SLAM, "fx": 900.0}, "Camera2.")
    )
    assert off_px(parse(text, "camera1").camera, D5) < 1e-6
    assert parse(text, "camera2").camera.fx == 900.0
    with pytest.raises(NotACamera, match="2 cameras: camera1, camera2"):
        parse(text)


def matrices(**stated):
    return "".join(
        f"{name}: !!opencv-matrix\n   rows: {1 if len(numbers) == 5 else 3}\n   cols: {len(numbers)}\n   dt: d\n"
        f"   data:{numbers}\n"
        for name, numbers in stated.items()
    )


def test_a_rectified_camera_is_not_taken_for_those_that_it_was_made_from():
    """ORB-SLAM2, Examples/Stereo/EuRoC.yaml: ``Camera.`` is of the rectified images, ``LEFT.`` of those that were taken."""
    rectified = {**FOUR, "fx": 900.0, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}
    sides = "".join(
        f"{side}.height: 720\n{side}.width: 1280\n{matrices(**{f'{side}.D': D5, f'{side}.K': matrix})}"
        for side, matrix in (("LEFT", FLAT_K), ("RIGHT", [900.0, *FLAT_K[1:]]))
    )
    text = f"%YAML:1.0\n{lines({**rectified, **SIDES}, 'Camera.')}{sides}"
    with pytest.raises(NotACamera, match="3 cameras: left, right, camera"):
        parse(text)
    assert off_px(parse(text, "left").camera, D5) < 1e-6
    assert parse(text, "right").camera.fx == 900.0
    assert parse(text, "camera").camera.distortion["k1"] == 0.0


@pytest.mark.parametrize(
    "names", [("mtxL", "distL", "mtxR", "distR"), ("K_left", "D_left", "K_right", "D_right")]
)
def test_a_pair_of_cameras_in_one_file_is_told_apart(names):
    """Scripts of OpenCV's stereo calibration; stella_vslam, example/euroc/EuRoC_stereo.yaml."""
    other = [[900.0, 0.0, CX], *K[1:]]
    text = {**dict(zip(names, (K, [D5], other, [D5]), strict=True)), "image_size": SIZE}
    with pytest.raises(NotACamera, match="2 cameras"):
        parse(text)
    left, right = ("l", "r") if "L" in names[0] else ("left", "right")
    assert off_px(parse(text, left).camera, D5) < 1e-6
    assert parse(text, right).camera.fx == 900.0


@pytest.mark.parametrize("numbers", [("0", "1"), ("_01", "_02"), ("1", "2", "3")])
def test_cameras_with_numbers_are_all_found(numbers):
    """Scripts of OpenCV's stereo calibration count from 0 or 1; EasyMocap, intri.yml, writes K_01 and dist_01."""
    text = {"image_size": SIZE}
    for at, number in enumerate(numbers):
        text |= {f"K{number}": [[FX + at, 0.0, CX], *K[1:]], f"dist{number}": [D5]}
    with pytest.raises(NotACamera, match=f"{len(numbers)} cameras"):
        parse(text)
    assert parse(text, numbers[-1].lstrip("_")).camera.fx == FX + len(numbers) - 1


def test_the_cameras_of_a_list_are_named_by_their_place():
    rig = RPG.replace("label: rig\n", "") + RPG.partition("cameras:\n")[2].replace(str(FX), "900.0")
    assert parse(rig, "cameras1").camera.fx == 900.0
    with pytest.raises(NotACamera, match="cameras0, cameras1"):
        parse(rig)


def yarp(name, more=""):
    """event-driven, cpp_tools/calibration/calibrate.cpp; with ``projection``, iCub's camCalib and stereoCalib."""
    named = {"w": 1280, "h": 720, **FOUR, **dict(zip(("k1", "k2", "p1", "p2"), D5, strict=False))}
    return f"[{name}]\n\n{more}{lines(named, sign='')}\n"


def test_coefficients_of_event_driven_may_be_those_of_a_fisheye():
    with pytest.raises(NotACamera, match="no lens model"):
        parse(yarp("CAMERA_CALIBRATION"))
    assert off_px(parse(yarp("CAMERA_CALIBRATION"), lens="brown").camera, D5[:4]) < 1e-6
    assert off_px(parse(yarp("CAMERA_CALIBRATION"), lens="fisheye").camera, D5[:4], fisheye=True) < 1e-6


def test_the_two_cameras_of_icub_are_read():
    sides = [yarp(f"CAMERA_CALIBRATION_{side}", "projection         pinhole\n") for side in ("LEFT", "RIGHT")]
    text = "".join([*sides, "[STEREO_DISPARITY]\nHN (1 0 0 -0.068 0 1 0 0 0 0 1 0 0 0 0 1)\n"])
    camera_file = parse(text, "CAMERA_CALIBRATION_LEFT")
    assert off_px(camera_file.camera, D5[:4]) < 1e-6
    assert "event-driven or iCub" in camera_file.kind
    with pytest.raises(NotACamera, match="2 cameras"):
        parse(text)


def test_a_list_of_the_model_brown_is_not_guessed():
    """cuVSLAM and openMVG write k1 k2 k3 p1 p2 (nvidia-isaac/cuVSLAM#151), RealSense and OpenCV k1 k2 p1 p2 k3."""
    text = {**LISTS, "distortion_model": "brown", "distortion_coefficients": D5}
    with pytest.raises(NotACamera, match="no one order") as error:
        parse(text)
    assert "--lens brown" in error.value.remedy
    assert off_px(parse(text, lens="brown").camera, D5) < 1e-6
    assert off_px(parse({**LISTS, "distortion_model": "brown", **NAMED}).camera, D5) < 1e-6
    alike = parse({**text, "distortion_coefficients": [K1, K2, 0.0, 0.0, 0.0]})
    assert off_px(alike.camera, [K1, K2, 0.0, 0.0]) < 1e-6


def numbered(names):
    """Two cameras, whose names are those of KITTI and EasyMocap; the second one has another focal length."""
    return "".join(
        f"{names[0]}{at}: {' '.join(map(str, [FX + at, *FLAT_K[1:]]))}\n{names[1]}{at}: {' '.join(map(str, D5))}\n{size}"
        for at, size in enumerate(names[2:])
    )


@pytest.mark.parametrize(
    "text",
    [
        # KITTI, calib_cam_to_cam.txt, and KITTI-360, perspective.txt
        "calib_time: 09-Jan-2012 13:57:47\n"
        + numbered(("K_0", "D_0", "S_00: 1.28e+03 7.2e+02\nS_rect_00: 1.2e+03 3.7e+02\n", "S_01: 1.28e+03 7.2e+02\n")),
        # EasyMocap, camera_utils.py: write_intri
        f'{YAML}names:\n  - "0"\n' + numbered(("K_", "dist_", "H_0: 720\nW_0: 1280\n", "H_1: 720\nW_1: 1280\n")),
    ],
)  # fmt: skip
def test_cameras_with_numbers_state_their_size_by_number_too(text):
    name = "01" if "K_01" in text else "1"
    assert off_px(parse(text, name).camera, D5, matrix=np.array(K) + np.diag([1.0, 0.0, 0.0])) < 1e-6
    assert parse(text, name).camera.image_size == tuple(SIZE)


DOUBTFUL = {
    "omni of Kalibr with its five numbers": (lines({"camera_model": "omni", "intrinsics": [1.2, *FOCAL_AND_CENTRE], "resolution": SIZE}), "'omni'"),
    "unified projection of maplab": ({"type": "unified-projection", "intrinsics": [1.2, *FOCAL_AND_CENTRE], **SIDES}, "'unified-projection'"),
    "k4 of Metashape": (xml({**METASHAPE, "k1": K1, "k4": 0.1}), "Metashape's coefficient k4"),
    "p3 of Metashape": (xml({**METASHAPE, "k1": K1, "p3": 0.1}), "Metashape's coefficient p3"),
    "fisheye of Metashape": (xml({**METASHAPE, "projection": "fisheye"}), "Metashape's projection 'fisheye'"),
    "thin prism beside": ({**LISTS, "distortion_coefficients": D5, "thin_prism": [0.004, -0.003]}, "'thinprism' may be"),
    # Viam
    "rk1 below the distortion": ({"ppx": CX, "ppy": CY, "fx": FX, "fy": FY, **SIDES, "distortion_parameters": {"rk1": K1}}, "'distortionparametersrk1' may be"),
    # Theia
    "radial_distortion_1": ({"focal_length": [FX, FY], "principal_point": [CX, CY], **SIDES, "radial_distortion_1": K1, "k1": 0.0}, "'radialdistortion1' may be"),
    "RealSense under a name that nobody knows": ({**FOUR, **SIDES, "ppx": CX, "ppy": CY, "kappa": [K1, K2]}, "states no distortion"),
    "tangential beside": ({**LISTS, "distortion_coefficients": [K1, K2, 0.0, 0.0, K3], "tangential": [P1, P2]}, "'tangential' may be"),
    "a lens beside the camera": ({"color": {**FOUR, **SIDES, "ppx": CX, "ppy": CY}, "lens": {"radial": [K1, K2]}}, "'lens' may be"),
    "BoofCV": ({**BOOFCV, "radial_tangential": {"radial": [K1, K2], "t1": P1, "t2": P2}}, "'radialtangential' may be"),
    "camera.txt of DSO": (f"FOV {lines({1280: 720}, sign='')}0.53 0.67 0.49 0.5 0.9\ncrop\n640 480\n", "numbers without names"),
    "HALCON": ('ParGroup: Cam: Parameter\n    "Internal camera parameters";\n  Focus:foc: 0.008;\n', "HALCON"),
    "numpy's print": (f"{{'mtx': array([[{FX}, 0., {CX}]])}}", "numpy's arrays"),
    "a web page": ("<!DOCTYPE html>\n<html><body>Raw</body></html>", "a web page"),
    "a pointer of Git LFS": ("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n", "Git LFS"),
    "a pinhole with coefficients of an unknown name": ({**LISTS, "camera_model": "pinhole", "distortion_coefficents": D5}, "distortioncoefficents"),
    "a pinhole with radial coefficients": ({**LISTS, "camera_model": "pinhole", "radial": [K1, K2]}, "'radial'"),
    "a pinhole with a lens below": ({**LISTS, "camera_model": "pinhole", "lens": {"k1": K1}}, "'lens'"),
    "a pinhole without any coefficients": ({**LISTS, "camera_model": "pinhole"}, "states no distortion"),
    "t1 and t2": ({**FOUR, **SIDES, "k1": K1, "k2": K2, "t1": P1, "t2": P2}, "t1 = 0.0005"),
    "b1 of Metashape": ({**FOUR, **SIDES, **NAMED, "b1": 1.5}, "b1 = 1.5"),
    "k4 without k5 and k6": ({**FOUR, **SIDES, **NAMED, "k4": 0.01}, "r^8"),
    "another skew beside the matrix": ({**LISTS, "camera_matrix": [[FX, 0.5, CX], *K[1:]], "dist": D5, "skew": 2.0}, "two different skews"),
    "principal point from the middle": ({**FOUR, **SIDES, **NAMED, "cx": 4.2, "cy": -2.1}, "middle of the image"),
    "focal lengths of 50 mm": ({**FOUR, **SIDES, **NAMED, "fx": 50.0, "fy": 50.0}, "50 and 50 px are not possible"),
    "a tilt of 1.1 degrees": ({**FOUR, **SIDES, **NAMED, "tauX": 1.1, "tauY": 0.8}, "tilted by 1.1 rad"),
    "fx cx fy cy": ({"intrinsics": [FX, CX, FY, CY], "dist": D5, "image_size": SIZE}, "not possible together"),
    "height of 5:4 first": ({"camera_matrix": [[3000, 0, 1220], [0, 3000, 1030], K[2]], "dist": D5, "image_size": [2048, 2448]}, "height seems to stand before"),
    "inverse model of RealSense": ({**REALSENSE, "model": "distortion.inverse_brown_conrady"}, "only without distortion"),
    "double sphere of Basalt": (basalt("ds", {"xi": -0.2, "alpha": 0.6}), "omnidirectional"),
    "unified model of Basalt": (basalt("eucm", {"alpha": 0.6, "beta": 1.0}), "'eucm'"),
    # fisheye-calib-adapter, dataset/UCM.yml
    "unified model without a name": ({"image": SIDES, "parameter": {**FOUR, "alpha": 1.02}}, "states alpha"),
    # Gyroflow's lens profiles
    "the camera's name as camera_model": ({**LISTS, "camera_model": "DAVIS346", "dist": D5}, "'DAVIS346', which is no lens model"),
    "fisheye of camodocal": (YAML + "model_type: SCARAMUZZA\npoly_parameters:\n   p0: -2.1e+02\n", "Scaramuzza"),
    "fisheye of OCamCalib": ("#polynomial coefficients for the DIRECT mapping function\n\n5 -2.3e+02 0.0\n", "OCamCalib"),
    "cameras of MATLAB's toolbox by side": ("% left camera\nfc_left = [ 1050.3 ; 1049.1 ];\n", "no YAML"),
    "fisheye of MATLAB": ({"MappingCoefficients": [700.0, 0.0, 0.0, 0.0], "ImageSize": [720, 1280]}, "Scaramuzza"),
    "radial and tangential apart, of nobody known": ({**LISTS, "radial_distortion": [K1, K2], "tangential_distortion": [P1, P2]}, "apart"),
    "omni of SVO": (RPG.replace("type: pinhole", "type: omni"), "'omni'"),
    "VINS's settings of the filter": (YAML + 'imu: 1\ncam0_calib: "cam0_pinhole.yaml"\n', "names the files of its cameras"),
    "iKalibr's settings": (
        "# iKalibr\nConfigor:\n  DataStream:\n    CameraTopics:\n      - key: /cam\n        value:\n          Intrinsics: a.yaml\n",
        "names the files of its cameras",
    ),
    "PhotoScan before 1.2": (xml({"projection": "frame", **SIDES, **FOUR, "skew": 0, "k1": K1}), "PhotoScan before 1.2"),
    "Meshroom's cameras.sfm": (
        {"version": ["1", "2", "3"], "intrinsics": [{"type": "radial3", "initializationMode": "estimated", "focalLength": "4.3", "principalPoint": ["-3.5", "12.2"]}]},
        "AliceVision",
    ),
    # AirSLAM and AirVO: 1 is radial-tangential there; in MC-Calib it is a fisheye.
    "a number as lens model": ({"intrinsics": FOCAL_AND_CENTRE, "distortion_type": 1, "distortion_coeffs": D5, "resolution": SIZE}, "number 1"),
    # Android, CaptureResult.LENS_DISTORTION: three radial coefficients, then two tangential ones
    "Android's distortion": ({"intrinsics": FOCAL_AND_CENTRE, "lens_distortion": D5, "image_size": SIZE}, "lens_distortion has no one order"),
    "rs-enumerate-devices": (' Intrinsic of "Color" / 640x480 / {YUYV}\n  Width: \t640\n  PPX: \t320\n', "RealSense"),
    "a note with the words of rs-enumerate-devices": (YAML + "# Intrinsic of the left camera\nD: [0, 0, 0, 0]\n", "no camera matrix"),
    "Qualisys": (
        '<calibration><cameras><camera><fov_video left="0"/><intrinsic focalLengthU="107599.67"/></camera></cameras></calibration>',
        "Qualisys, which counts in 1/64 px",
    ),
    "calib.txt of RPG": (" ".join(map(str, [*FOCAL_AND_CENTRE, *D5])) + "\n", "numbers without names"),
    "Kalibr's report": ("Calibration results\n===\nCamera-system parameters:\n\tcam0 (/cam0):\n", "results-cam.txt"),
    "Kalibr's report with an IMU": (
        "Calibration results\n===\nNormalized Residuals\n---\nReprojection error (cam0):     mean 0.49, median 0.46\n",
        "results-imucam.txt",
    ),
    "ZED's two cameras": ("[LEFT_CAM_HD]\nfx=700.5\n\n[RIGHT_CAM_HD]\nfx=701\n", "no camera matrix"),
    "torn TOML": ("[cam_0]\nsize = [ 1280,", "no complete TOML"),
    "two values of one name": ({"intrinsics": {**FOUR, "k1": 0.1}, "distortion": {"k1": 0.2}, "image_size": SIZE}, "'k1' twice"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "why"), DOUBTFUL.values(), ids=DOUBTFUL)
def test_what_can_be_read_in_two_ways_or_in_none_is_refused(text, why):
    with pytest.raises(NotACamera) as error:
        parse(text)
    assert why in error.value.what
    assert error.value.remedy


def test_a_file_whose_writer_nobody_knows_is_called_by_its_syntax():
    assert parse({**LISTS, "distortion_coeffs": D5}).kind == "the JSON file"
    assert parse(RPG).kind == "the YAML file"


def test_a_stated_skew_is_used():
    camera_file = parse({**FOUR, **SIDES, **NAMED, "skew": 2.0})
    assert camera_file.camera.skew == 2.0
    assert "skew" in camera_file.remarks[0]
