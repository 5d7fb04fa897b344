"""What others do with the same images: the camera from one image by angles.

The angle between the rays of two stars does not depend on the pose of the camera (Liang et al., "Flexible camera
calibration using a collimator system", arXiv:2512.16113). Two stars at P_i and P_j on the reticle leave the collimator as
parallel beams along d = (P - C, r), with the foot C of its axis and its focal length r. The camera must see them under
the same angle: angle(ray(p_i), ray(p_j)) = angle(d_i, d_j). All angles are right if one rotation turns all beams to the
rays. So the method is the spherical model of one view whose r and C are known. One image cannot tell them from the
camera: a longer collimator and a longer camera give the same image. They are taken as exact, so the stated uncertainties
hold the noise of the stars only.
"""

import numpy as np

from calib import Passport, View
from calib.calibration import CalibrationOptions, rms_and_mean
from calib.errors import DegenerateViews, NotConverged, TooFewStars
from calib.fit import fit_model
from calib.model.collimator import CENTRE
from tests.benchmarks.compared.reference_methods import MethodResult

_FEWEST_STARS = 20


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
    return MethodResult(camera, sigma, *lengths, None)
