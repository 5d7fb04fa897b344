"""Cameras whose values have a name each, are stated twice, or are in another unit than px."""

import json
from pathlib import Path

import pytest

from bench.plan.camera_files import NotACamera, parse_camera

K = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
D = [-0.1, 0.01, 0.001, -0.002, 0.3]
NAMED = dict(zip(("k1", "k2", "p1", "p2", "k3"), D, strict=True))
SIZE = {"image_width": 1280, "image_height": 720}


def camera(**content):
    return parse_camera(json.dumps(content).encode(), Path("camera.json")).camera


def refusal(**content):
    with pytest.raises(NotACamera) as caught:
        camera(**content)
    return str(caught.value)


def test_k4_without_a_model_is_asked_for():
    assert "--lens fisheye" in refusal(K=K, **SIZE, k1=-0.1, k2=0.02, k3=0.003, k4=0.004)


def test_a_named_coefficient_that_the_model_lacks_is_refused():
    assert "no coefficient p1" in refusal(K=K, **SIZE, model="fisheye", k1=-0.1, p1=0.02)


HALF_K = [[450.0, 0.0, 320.0], [0.0, 452.5, 180.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("more", "what"),
    [
        ({"camera_matrix": HALF_K}, "the camera matrix twice"),
        ({"dist": [0.0] * 5}, "the distortion twice"),
        ({"k1": -0.2}, "the distortion twice"),
        ({"width": 640, "height": 360}, "the size of the image twice"),
    ],
)
def test_what_is_stated_twice_and_differs_is_refused(more, what):
    assert what in refusal(K=K, distortion_coefficients=D, **SIZE, **more)


def test_what_is_stated_twice_and_is_the_same_is_read():
    """``M`` is a matrix of extrinsics here; the second list of coefficients has more zeros."""
    pose = [[0.0, 1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0], [0.0, 0.0, 0.0, 1.0]]
    lens = {"distortion_coefficients": D, "dist": [*D, 0.0, 0.0, 0.0], "k1": -0.1, "k2": 0.01, "p1": 0.001}
    model = camera(K=K, camera_matrix=K, M=pose, **SIZE, resolution=[1280, 720], **lens, p2=-0.002, k3=0.3)
    assert model.distortion == NAMED


@pytest.mark.parametrize(
    "pose",
    [
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        [[0.0, -1.0, 0.0, 1.5], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, -3.0]],
        [[0.6, 0.0, 0.8, 1.5], [0.0, 1.0, 0.0, 0.2], [-0.8, 0.0, 0.6, -3.0]],
    ],
)
def test_a_pose_under_the_name_of_a_camera_matrix_is_none(pose):
    """OpenPose, models/cameraParameters: ``CameraMatrix`` is the pose, in m, beside ``Intrinsics``."""
    model = camera(CameraMatrix=pose, Intrinsics=K, Distortion=[*D, 0.0, 0.0, 0.0], **SIZE)
    assert (model.fx, model.fy, model.cx, model.cy) == (900.0, 905.0, 640.0, 360.0)
    assert "no camera matrix" in refusal(CameraMatrix=pose, Distortion=D, **SIZE)


@pytest.mark.parametrize("skew", [0.0, 0.7])
def test_a_fifth_number_after_focal_lengths_and_centre_is_the_skew(skew):
    """IC-GVINS, config/gvins.yaml: ``intrinsic`` is [fx, fy, cx, cy(, skew)]."""
    model = camera(intrinsic=[900.0, 905.0, 640.0, 360.0, skew], distortion=D, resolution=[1280, 720])
    assert (model.fx, model.fy, model.cx, model.cy) == (900.0, 905.0, 640.0, 360.0)
    assert model.distortion == NAMED | ({"skew": skew} if skew else {})


def test_a_fifth_number_that_is_no_skew_is_refused():
    """GTSAM, Cal3_S2: fx, fy, skew, u0, v0."""
    assert "last one is no skew" in refusal(K=[900.0, 905.0, 0.0, 640.0, 360.0], distortion=D, **SIZE)


def test_the_name_of_a_lens_model_is_found_by_any_usual_key():
    assert "'fov' is not read" in refusal(K=K, dist=D[:4], DistModel="fov", **SIZE)
    assert "kb1" in camera(K=K, dist=D[:4], DistModel="equidistant", **SIZE).distortion


def test_a_height_before_the_width_is_refused():
    message = refusal(K=K, dist=D, image_size=[720, 1280])
    assert "720 x 1280 px" in message
    assert "Write the width first" in message


@pytest.mark.parametrize("factor", [0.005, 1 / 1280])
def test_a_focal_length_in_mm_or_as_a_share_is_refused(factor):
    small = [[factor * number for number in row] for row in K[:2]]
    assert "some programs state them in mm" in refusal(K=[*small, K[2]], dist=D, **SIZE)


def test_a_fisheye_of_more_than_a_half_sphere_is_read():
    matrix = [[333.0, 0.0, 640.0], [0.0, 333.0, 360.0], [0.0, 0.0, 1.0]]
    assert camera(K=matrix, dist=D[:4], model="fisheye", **SIZE).fx == 333.0


PASCAL_SIZES = {
    "square": ([[400.0, 0.0, 160.0], [0.0, 400.0, 160.0], [0.0, 0.0, 1.0]], [320, 320]),
    "wide": ([[400.0, 0.0, 320.0], [0.0, 400.0, 240.0], [0.0, 0.0, 1.0]], [640, 480]),
}


@pytest.mark.parametrize("also_apart", [False, True])
@pytest.mark.parametrize("more", [{}, {"DistortionModel": "plumb_bob"}])
@pytest.mark.parametrize(("matrix", "size"), PASCAL_SIZES.values(), ids=PASCAL_SIZES)
def test_names_like_those_of_matlab_do_not_make_a_file_one_of_matlab(matrix, size, more, also_apart):
    (fx, _, cx), (_, fy, cy), _ = matrix
    apart = {"FocalLength": [fx, fy], "PrincipalPoint": [cx, cy]} if also_apart else {}
    coefficients = D[:4] if more else D
    model = camera(K=matrix, DistortionCoefficients=coefficients, ImageSize=size, **more, **apart)
    assert (model.cx, model.cy, list(model.image_size)) == (cx, cy, size)
    assert list(model.distortion.values()) == coefficients
    assert list(model.distortion) == list(NAMED)[: len(coefficients)]


def test_four_coefficients_with_some_names_of_matlab_are_asked_for():
    matrix, size = PASCAL_SIZES["square"]
    message = refusal(K=matrix, DistortionCoefficients=[0.1, 0.2, 0.1, 0.1], ImageSize=size)
    assert "--lens fisheye" in message


@pytest.mark.parametrize(
    "name",
    [
        "board_tilt_deg", "tilts", "mount_tilt_deg1", "radial_distortion_stddev", "rms_radial", "radial_error_px",
        "radial_order", "use_tilted", "prismatic_joint", "tilt1",
    ],
)  # fmt: skip
@pytest.mark.parametrize("value", [[3.0, 2.0], 3.0])
def test_names_that_are_no_coefficients_do_not_stop_a_complete_file(name, value):
    assert camera(K=K, D=D, **SIZE, **{name: value}).distortion == NAMED


COEFFICIENTS_BESIDE = (
    "prism", "thin_prism_coeffs", "tilt", "tilt_coefficients", "tilted", "radial", "tangential_coefficients",
    "radial_distortion_coeffs", "radialCoefficients", "dist_radial", "camera_radial", "coeffs_tangential", "radial_distortion_3",
)  # fmt: skip


@pytest.mark.parametrize("name", COEFFICIENTS_BESIDE)
def test_coefficients_beside_a_complete_lens_are_refused(name):
    assert "may be distortion coefficients" in refusal(K=K, D=D, **SIZE, **{name: [0.004, -0.003]})


def of_text(text):
    return parse_camera(text.encode(), Path("camera.yaml"))


IN_YAML = f"K: {K}\nD: {D}\nimage_width: 1280\nimage_height: 720\n"


def test_a_tilt_of_one_number_is_a_pose_in_yaml_too():
    assert of_text(f"{IN_YAML}tilt: 3\n").camera.distortion == NAMED


@pytest.mark.parametrize("words", ["np.array(", "array([["])
def test_a_comment_with_words_of_numpy_does_not_make_a_file_python(words):
    ini = f"[camera]\nresolution=[1280 720]\nfx=900\nfy=905\ncx=640\ncy=360\ndist={D}\n"
    for text in (IN_YAML, ini):
        assert of_text(f"# made with {words}\n{text}").camera.distortion == NAMED
    assert camera(K=K, D=D, **SIZE, comment=f"made with {words}").distortion == NAMED


@pytest.mark.parametrize(
    "text",
    [f"mtx = np.array({K})\n", f"import numpy as np\n\nmtx = np.array({K})\n", "{'a': array([[1., 2.]])}"],
)
def test_python_code_is_still_called_so(text):
    with pytest.raises(NotACamera, match="Python code"):
        of_text(text)


@pytest.mark.parametrize("sides", [SIZE, {"image_size": [1280, 720]}, {"size": [1280, 720]}])
def test_dim_is_that_of_a_board_where_another_name_states_the_size(sides):
    assert camera(K=K, D=D, **sides, dim=[9, 6]).image_size == (1280, 720)


@pytest.mark.parametrize("dim", [[1280, 720], {"width": 1280, "height": 720}])
def test_dim_alone_is_the_size_of_the_image(dim):
    assert camera(K=K, D=D, DIM=dim).image_size == (1280, 720)


def test_an_ini_that_no_toml_is_like_is_called_ini():
    values = f"fx=900\nfy=905\ncx=640\ncy=360\ndist=[{' '.join(map(str, D))}]\n"
    assert of_text(f"[camera]\nresolution=[1280 720]\n{values}").kind == "the INI file"
    assert of_text(f"[camera]\nresolution=[1280, 720]\n{values.replace(' ', ', ')}").kind == "the TOML file"
