"""Event images of simulated recordings, and how far the stars that are found in a view are from the truth."""

import math
from typing import Any

import numpy as np

from calib.events.event_image import EventImages, make_images
from calib.events.flicker import Flicker
from calib.view import View
from simulators.optics.picture import TARGET, project, star_centres
from simulators.world.truth import Truth
from simulators.world.world import LightState


def event_images(
    events: Any, light: LightState, phase: float, size: tuple[int, int], window_us: float, periods: Any = None
) -> EventImages:
    """Return the images of events from 0 on, with the true flicker; ``phase`` is that of the light at 0, in periods."""
    edge_us = -phase * light.period_us % light.period_us
    flicker = Flicker(light.period_us, edge_us, light.high_share, 0.0, 0, "triggers")
    return make_images(*events, size, flicker, window_us=(0.0, window_us), periods=periods)


def random_pose(rng: np.random.Generator) -> dict[str, float]:
    """Draw pan, tilt and roll, degrees."""
    return {"pan": rng.uniform(-6, 6), "tilt": rng.uniform(-3, 3), "roll": rng.uniform(0, 360)}


def whole_stars(truth: Truth, rotation: Any) -> Any:
    """Return the ids of the stars whose cells lie completely in the frame and in the bright part of the disc."""
    pitch_px = truth.camera.fx * TARGET.pitch_mm / truth.collimator.r
    return star_centres(truth, rotation, clearance=0.72, border_px=pitch_px / math.sqrt(2.0))[0]


def star_scores(view: View, truth: Truth, rotation: Any, whole: Any) -> dict[str, float]:
    """Return sums of squares and z-squares; missed and wrong stars."""
    errors = view.points_px - project(np.asarray(TARGET.positions_mm(view.ids)), rotation, truth)
    squares = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(view.covariances_px2), errors) / 2.0
    return {
        "square": float((errors**2).sum()),
        "z_square": float(squares.sum()),
        "stars": len(view),
        "whole": len(whole),
        "missed": len(np.setdiff1d(whole, view.ids)),
        "wrong": int((np.linalg.norm(errors, axis=1) > 0.5).sum()),
    }
