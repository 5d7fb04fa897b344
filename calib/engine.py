"""From views to a calibrated camera: `calibrate` checks its input, and adjusts jointly or by a reference method."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

from calib.calibration import DEFAULT_DISTORTION, REFERENCE_MODELS, Calibration, CalibrationOptions
from calib.diagnosis.checks import check_image_size, check_views, require_one_target
from calib.diagnosis.flat_board import require_turns
from calib.diagnosis.gross_stars import find_gross_stars, without_gross_stars
from calib.errors import DegenerateViews, InputMismatch
from calib.fit import fit_model, summarize
from calib.joint.result import calibrate_jointly
from calib.model.camera import CameraModel
from calib.model.lens import is_fisheye
from calib.model.type_b_terms import corrected_passport, corrected_views
from calib.one_thread import on_one_thread
from calib.view import View

__all__ = ["Calibration", "CalibrationOptions", "calibrate"]


@on_one_thread
def calibrate(views: Iterable[View] | View, options: CalibrationOptions | None = None) -> Calibration:
    """Calibrate a camera from views of the star target through a collimator.

    The geometry is that of arXiv:2512.16092; the adjustment is that of docs/adjustment.md.

    Parameters
    ----------
    views
        Two or more poses of one camera; one is enough with a passport that holds more than the radius.
    options
        Model, distortion, loss, passport and guard band; None for the defaults.

    Returns
    -------
    Calibration
        Intrinsics, distortion, collimator and rotations, with their covariance. A view with fewer than 4 stars, or with
        all on a line, is left out: a note says so, and nothing else of the result counts it.

    Raises
    ------
    InputMismatch
        If views contradict each other (image sizes, names, places on the target), are no views or show the target
        mirrored, or if ``spherical`` or ``planar`` is given a passport.
    DegenerateViews
        If the views do not constrain the camera; says why.
    NotConverged
        If the adjustment did not reach an optimum.
    """
    views, options = [views] if isinstance(views, View) else list(views), options or CalibrationOptions()
    _require_kinds(views, options)
    if options.passport and options.model in REFERENCE_MODELS:
        raise InputMismatch(
            f"The {options.model} model is a method of reference: it uses no passport or certificate.",
            remedy="Use the joint model, or give no passport.",
        )
    if options.gimbal and len(options.gimbal.angles_deg) != len(views):
        raise InputMismatch(
            f"{len(options.gimbal.angles_deg)} readings of the gimbal, but {len(views)} views.",
            remedy="Give one reading for each view, in their order.",
        )
    views = corrected_views(views, options.budget)
    found = find_gross_stars(views)
    seen = [at for at, stars in enumerate(found) if not stars.fault]
    views, wrong = [views[at] for at in seen], [found[at] for at in seen]
    named = [stars.sentence for stars in found]
    _check(views, 1 if options.passport and not options.passport.is_certificate else 2, named)
    if options.passport:
        options = replace(options, passport=corrected_passport(options.passport, options.budget))
    if options.gimbal:
        options = replace(options, gimbal=options.gimbal.part(seen))
    known_r = options.passport.values_by_name["r"] if options.passport else None
    right = without_gross_stars(views, wrong)
    doubts = check_views(right, known_r_mm=known_r)
    if options.model not in REFERENCE_MODELS and not (options.passport or options.gimbal):
        require_turns(right)
    if options.model in REFERENCE_MODELS:
        result = summarize(fit_model(views, options, options.model, wrong=wrong))
    else:
        result = calibrate_jointly(views, options, wrong)
    doubt = check_image_size(right, result.camera, (result.sigma["cx"], result.sigma["cy"]))
    remarks = _remarks(options, result.camera)
    notes = filter(None, (*named, *doubts, *result.notes, doubt, *remarks))
    return replace(result, notes=tuple(notes), remarks=(*result.remarks, *remarks))


def _remarks(options: CalibrationOptions, camera: CameraModel) -> list[str]:
    """Return sentences on the model that was asked for, the lens that was chosen, and options that took no part."""
    remarks = []
    if options.compares_lenses and options.model not in REFERENCE_MODELS:
        lens = "fisheye" if is_fisheye(camera.distortion) else "k1k2k3p1p2"
        remarks.append(f"The data chose the lens model {lens}.")
    more = [name for name in camera.distortion if name not in options.distortion]
    if more and options.model not in REFERENCE_MODELS and options.distortion != DEFAULT_DISTORTION:
        asked = " ".join(options.distortion) or "no distortion"
        remarks.append(f"{asked} was asked for; the joint adjustment also estimated {' '.join(more)}.")
    if options.unused:
        remarks.append(options.unused)
    return remarks


def _require_kinds(views: Sequence[object], options: object) -> None:
    """Refuse what is no view and what are no options: a user's own lists, words or numbers."""
    other = next((view for view in views if not isinstance(view, View)), None)
    if other is not None:
        raise InputMismatch(
            f"A view is a {type(other).__name__}.",
            remedy="Make each: calib.View(name, image_size, ids, points_px, target_mm, covariances_px2).",
        )
    if not isinstance(options, CalibrationOptions):
        raise InputMismatch(
            f"The options are a {type(options).__name__}.",
            remedy='Make them: calib.CalibrationOptions(distortion="k1k2").',
        )


def _check(views: Sequence[View], fewest: int, left_out: Sequence[str]) -> None:
    """Refuse views that do not belong together, or are too few.

    ``left_out`` holds a sentence for each given view, empty if it is used whole.
    """
    if len(views) < fewest:
        or_passport = ", or give a collimator's passport" if len(views) == 1 else ""
        few = f"{len(views)} view{'s' if len(views) != 1 else ''} given; at least {fewest} needed."
        if len(views) < len(left_out):
            few = f"Of {len(left_out)} views, {len(views)} can be used; at least {fewest} needed."
        raise DegenerateViews(
            " ".join(filter(None, (few, *left_out))),
            remedy=f"Record the target from more angles{or_passport}.",
        )
    sizes = sorted({view.image_size for view in views})
    if len(sizes) > 1:
        shown = ", ".join(f"{width} x {height}" for width, height in sizes)
        raise InputMismatch(
            f"Views of different image sizes: {shown}.", remedy="Calibrate one camera at a time."
        )
    name, times = Counter(view.name for view in views).most_common(1)[0]
    if times > 1:
        raise InputMismatch(f"{times} views are named {name!r}.", remedy="Give each view its own name.")
    require_one_target(views)
