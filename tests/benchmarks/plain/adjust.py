"""From views and what is known to the posterior: starts, searches, mixture."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from calib.arrays import Array, Ints
from calib.calibration import CalibrationOptions
from calib.errors import NotConverged
from calib.model.beam import discs_of
from calib.model.rim_fit import Discs
from calib.view import View

from .camera import Camera, lens_names
from .knowledge import Known
from .poses import seen_poses
from .posterior import Posterior, posterior
from .problem import Problem, Start, State, Task
from .pupils import Moved, Pupil, shown_way
from .search import Optimum, search
from .solution import AS_STATED, Wide
from .starts import first_starts

#: A search that ends so far from its start, as a share, begins again there: fields are stated for the right radius.
_FAR, _AGAIN = 0.05, 3
#: Steps to the smallest circle about all stars.
_CIRCLE = 400


def adjusted(
    views: Sequence[View], options: CalibrationOptions, pupil: Pupil | None = None, lens: tuple[str, ...] = ()
) -> list[Posterior]:
    """Return the posteriors of views about the optima that were found, the most probable first.

    ``pupil``: how it is moved, if not as the discs say; ``lens``: other coefficients than the chosen ones. Where a
    hypothesis leads far from an optimum, its own is searched.
    """
    known, lens = Known.of(options), lens or lens_names(options.distortion)
    starts = first_starts(views, lens, known)
    task = _task(views, known, lens, starts[0], pupil)
    ends, failed = list[Optimum](), list[Exception]()
    for start in starts:
        try:
            ends.append(optimum(task, start, options.max_iterations))
        except np.linalg.LinAlgError as error:
            failed.append(error)
    if not ends:
        raise NotConverged("The joint adjustment cannot be solved.") from failed[0]
    found = [posterior(min(ends, key=lambda end: end.solution.value))]
    elsewhere = found[0].elsewhere
    if elsewhere is not None:
        with suppress(np.linalg.LinAlgError):
            start = begun_at(elsewhere.problem, elsewhere.equations.state.moved(*elsewhere.there()))
            found.append(posterior(optimum(task, start, options.max_iterations, elsewhere.wide)))
    return found


def _task(
    views: Sequence[View], known: Known, lens: tuple[str, ...], start: Start, pupil: Pupil | None
) -> Task:
    """Return what searches are given: poses and discs are found once, by the best start."""
    camera = Camera(views[0].image_size, start.f_px, lens).model(start.camera)
    poses = seen_poses(views, start.rotations, camera)
    discs = discs_of([views[v] for v in np.unique(poses, return_index=True)[1]])
    way = Pupil.HELD if known.bound is not None or discs is None else pupil or shown_way(discs)
    return Task(views, known, lens, poses, Moved(way, discs), _beam_shares(views, poses, discs))


def optimum(task: Task, start: Start, rounds: int, wide: Wide = AS_STATED) -> Optimum:
    """Go from a start to the optimum, by a hypothesis; again from its end if that is far away."""
    for _ in range(_AGAIN):
        problem, state = task.posed(start)
        end = search(problem, state, rounds, wide)
        last = end.state
        if np.abs(problem.wide[[0, 5]] @ last.b).max() < _FAR:
            break
        start = begun_at(problem, last)
    return end


def begun_at(problem: Problem, state: State) -> Start:
    """Return the start that a state is: focal length, centre, rotations, lens, radial distortion of the glass."""
    fields, results, log_r = problem.fields, problem.unknowns.results, problem.unknowns.log_r @ state.b
    c = state.b[: problem.depth].copy()
    x, y = (float(results[name] @ state.b) for name in ("x", "y"))
    glass = float(results["radial"] @ state.b) * float(np.exp(2.0 * log_r))
    f = problem.camera.f0_px * float(np.exp(c[0]))
    c[2:4] *= np.exp(-c[0])
    c[0] = 0.0
    centre = (fields.reference[0] + x, fields.reference[1] + y, fields.r0 * float(np.exp(log_r)))
    return Start(f, centre, state.rotations, c, glass)


def _beam_shares(views: Sequence[View], poses: Ints, discs: Discs | None) -> list[Array]:
    """Return for each view (N,) how far its stars are from the middle of the beam, over its radius.

    Visible discs show both. Without them, all views are taken to see one disc: the smallest circle about all stars
    (Badoiu and Clarkson, 2003).
    """
    if discs is not None:
        own = [discs.of_views[pose] for pose in poses]
        pairs = zip(views, own, strict=True)
        return [np.hypot(*(view.target_mm - disc.centre_mm).T) / disc.radius_mm for view, disc in pairs]
    points = np.concatenate([view.target_mm for view in views])
    middle = points.mean(axis=0)
    for k in range(1, _CIRCLE):
        farthest = points[np.argmax(((points - middle) ** 2).sum(axis=1))]
        middle = middle + (farthest - middle) / (k + 1)
    radius = float(np.sqrt(((points - middle) ** 2).sum(axis=1).max()))
    return [np.hypot(*(view.target_mm - middle).T) / radius for view in views]
