"""What others do with the same images: corners of a checkerboard by OpenCV, and the camera from one image by angles.

The angle between the rays of two stars does not depend on the pose of the camera (Liang et al., "Flexible camera
calibration using a collimator system", arXiv:2512.16113). Two stars at P_i and P_j on the reticle leave the collimator as
parallel beams along d = (P - C, r), with the foot C of its axis and its focal length r. The camera must see them under
the same angle: angle(ray(p_i), ray(p_j)) = angle(d_i, d_j). All angles are right if one rotation turns all beams to the
rays. So the method is the spherical model of one view whose r and C are known. One image cannot tell them from the
camera: a longer collimator and a longer camera give the same image. They are taken as exact, so the stated uncertainties
hold the noise of the stars only.
"""

from __future__ import annotations

import cv2
import numpy as np

from calib.arrays import AnyArray, Array, Bytes
from calib.boards.board import Board
from calib.boards.detect import find_board
from calib.calibration import CalibrationOptions, rms_and_mean
from calib.errors import DegenerateViews, NotConverged, TargetNotFound, TooFewStars, placed
from calib.events.grey_image import to_uint8
from calib.fit import fit_model
from calib.model.collimator import CENTRE
from calib.model.passport import Passport
from calib.view import View
from tests.benchmarks.compared.reference_methods import MethodResult

_WINDOW_PX = 11
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
_FEWEST_STARS = 20


def opencv_corners(image: AnyArray, board: Board, finder: str, name: str) -> View:
    """Find the corners of a checkerboard by OpenCV alone.

    ``sectors``: ``findChessboardCornersSB`` (Duda and Frese, 2018); else ``findChessboardCorners``, ``cornerSubPix``.
    """
    grey = to_uint8(np.nan_to_num(np.asarray(image, np.float32)))
    with placed(f"view {name}"):
        corners = find_board(grey, board) if finder == "sectors" else _by_subpixel(grey, board)
    ids, size = np.arange(len(corners), dtype=np.int64), (grey.shape[1], grey.shape[0])
    return View(name, size, ids, corners, board.points_mm, np.tile(np.eye(2), (len(ids), 1, 1)))


def _by_subpixel(grey: Bytes, board: Board) -> Array:
    """Return (N, 2) px corners by ``findChessboardCorners`` and ``cornerSubPix``, for either contrast."""
    size, smooth = (board.columns, board.rows), cv2.medianBlur(grey, 3)
    for shown in (smooth, np.asarray(255 - smooth, np.uint8)):
        ok, corners = cv2.findChessboardCorners(shown, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH)
        if ok:
            window = (_WINDOW_PX, _WINDOW_PX)
            refined = cv2.cornerSubPix(cv2.GaussianBlur(shown, (0, 0), 2.0), corners, window, (-1, -1), _STOP)
            return np.asarray(refined, np.float64).reshape(-1, 2)
    raise TargetNotFound(f"No {board.words} was found.", remedy="Show the whole board, in focus.")


def calibrate_by_angles(
    view: View, r_mm: float, centre_mm: tuple[float, float], distortion: str = "k1k2"
) -> MethodResult:
    """Calibrate a camera from one image, with 20 stars or more, of a collimator whose focal length and axis are known."""
    where = f"view {view.name}"
    if len(view) < _FEWEST_STARS:
        raise TooFewStars(
            f"The image shows {len(view)} stars; one image needs {_FEWEST_STARS}.",
            where=where,
            remedy="Use more images.",
        )
    known = Passport(CENTRE, np.array([*centre_mm, r_mm]), np.zeros((3, 3)))
    options = CalibrationOptions("spherical", distortion, "l2", passport=known)
    try:
        fitted = fit_model([view], options, "spherical")
    except (DegenerateViews, NotConverged) as error:
        raise NotConverged("The angles of one image did not determine the camera.", where=where) from error
    lengths = rms_and_mean(np.linalg.norm(fitted.bundle.residuals_px(fitted.parameters), axis=1))
    camera, sigma = fitted.parameters.camera, fitted.uncertainty.sigma
    return MethodResult("one image, angle invariance", camera, sigma, *lengths, None)
