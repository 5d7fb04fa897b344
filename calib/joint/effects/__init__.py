"""The effects of the joint adjustment, an object each. How the pupil is moved selects the list.

A new effect is a class (`effect.Effect`) and its place in a list here; an amplitude of its own is a line in
`calib.joint.amplitudes.FAMILIES`.
"""

from collections.abc import Mapping

from calib.joint.amplitudes import Pupil
from calib.joint.effects import by_turn, camera, collimator, gimbal, rim
from calib.joint.effects.effect import Effect

_CAMERA_AND_GLASS = (
    camera.Lens,
    collimator.Centre,
    collimator.Radial,
    camera.TurningErrors,
    camera.Drift,
    collimator.CommonField,
    collimator.PrintTerms,
    collimator.Changes,
    collimator.PoseFields,
    gimbal.GimbalErrors,
)
_ON_A_GIMBAL = (
    by_turn.GimbalParallax,
    by_turn.GimbalAside,
    by_turn.CurvatureAside,
    by_turn.ByTurn,
    by_turn.ByTurnSquared,
)
_BY_HAND = (
    by_turn.Parallax,
    by_turn.Aside,
    by_turn.CurvatureAside,
    by_turn.OwnByTurn,
    by_turn.Along,
    by_turn.ByTurn,
    by_turn.ByTurnSquared,
)
EFFECTS: Mapping[Pupil, tuple[type[Effect], ...]] = {
    Pupil.HELD: (*_CAMERA_AND_GLASS, *_ON_A_GIMBAL),
    Pupil.WALKS: (*_CAMERA_AND_GLASS, rim.Rim, *_ON_A_GIMBAL),
    Pupil.BY_HAND: (*_CAMERA_AND_GLASS, rim.Rim, *_BY_HAND),
}
