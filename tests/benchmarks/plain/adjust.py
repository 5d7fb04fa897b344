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
from .knowledge import CERTIFICATE, Known
from .poses import seen_poses
from .posterior import Posterior, posterior
from .problem import Problem, Start, State, Task
from .pupils import Moved, Pupil, shown_way
from .search import Optimum, search
from .solution import AS_STATED, Wide
from .starts import first_starts

#: A search that ends so far from its start, as a share, begins again there: fields are stated for the right radius.
_FAR, _AGAIN = 0.05, 3
#: Two searches ended at the same camera if it differs by less than so many sigma. Another one counts if its value is no
#: farther than the second number: by the weights of its own stars, it may still be the more probable one.
_SAME, _AS_PROBABLE = 0.2, 16.0
#: Steps to the smallest circle about all stars.
_CIRCLE = 400


def adjusted(
    views: Sequence[View],
    options: CalibrationOptions,
    pupil: Pupil | None = None,
    lens: tuple[str, ...] = (),
    starts: Sequence[Start] = (),
) -> list[Posterior]:
    """Return the posteriors of views about the optima that were found, the most probable first.

    ``pupil``: how it is moved, if not as the discs say; ``lens``: other coefficients than the chosen ones;
    ``starts``: where to begin, if that is known. Where a hypothesis leads far from an optimum, its own is searched.
    """
    known, lens = Known.of(options), lens or lens_names(options.distortion)
    starts = starts or first_starts(views, lens, known)
    task = _task(views, known, lens, starts[0], pupil)
    ends, failed = list[Optimum](), list[Exception]()
    for start in starts:
        try:
            ends.append(optimum(task, start, options.max_iterations))
        except np.linalg.LinAlgError as error:
            failed.append(error)
    if not ends:
        raise NotConverged("The joint adjustment cannot be solved.") from failed[0]
    first, *others = sorted(ends, key=lambda end: (not end.converged, end.solution.value))
    found = [posterior(first)]
    for other in others:
        if other.converged and all(_is_another(other, one.optimum) for one in found):
            with suppress(np.linalg.LinAlgError):
                found.append(posterior(other))
    elsewhere = found[0].elsewhere
    if elsewhere is not None:
        with suppress(np.linalg.LinAlgError):
            start = begun_at(elsewhere.problem, elsewhere.equations.state.moved(*elsewhere.there()))
            found.append(posterior(optimum(task, start, options.max_iterations, elsewhere.wide)))
    return found


def _is_another(end: Optimum, other: Optimum) -> bool:
    """Return whether an end is another camera than that of an optimum, and explains the views about as well."""
    if end.solution.value - other.solution.value > _AS_PROBABLE:
        return False
    problem, c = other.solution.problem, other.state.b[: other.solution.problem.depth]
    by_camera = problem.camera.by_unknowns(c)[:4]
    size = by_camera.shape[1]
    sigmas = np.sqrt(np.diag(by_camera @ other.solution.covariance[:size, :size] @ by_camera.T))
    there = end.solution.problem.camera.model(end.state.b[: end.solution.problem.depth])
    apart = np.array(there.values[:4]) - np.array(problem.camera.model(c).values[:4])
    return bool((np.abs(apart) / sigmas).max() > _SAME)


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
    eta, another = None, start.another
    for reach in (*(_AGAIN - 1) * (_FAR,), np.inf):
        problem, state = task.posed(start)
        if another:
            certificate = next(s for s in problem.unknowns.statements if s.name == CERTIFICATE)
            wide = dict(zip(certificate.at.tolist(), certificate.free.tolist(), strict=True))
        end = search(problem, state, rounds, wide, eta, reach)
        last = end.state
        if np.abs(problem.wide[[0, 5]] @ last.b).max() < _FAR:
            break
        start, eta = begun_at(problem, last), end.solution.eta
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
