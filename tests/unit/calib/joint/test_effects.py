"""The effects of the joint adjustment: what each adds is what its own name says, whatever moves the pupil."""

import numpy as np
import pytest

from calib.joint.amplitudes import Lever, Pupil, hyperprior
from calib.joint.effects import EFFECTS
from calib.joint.effects.by_turn import Along, GimbalAside, OwnByTurn
from calib.joint.effects.effect import Circumstances, PoseBasis, Turned
from calib.joint.effects.rim import NUMBER, Rim
from calib.joint.fields import FieldBasis
from calib.joint.layout import Layout
from calib.joint.prior import RandomPrior

CAMERA = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
TURNS = np.array([[0.0, 0.0], [0.1, 0.02], [-0.05, 0.2]])
POSES = Turned(TURNS, np.tile(np.eye(2), (3, 1, 1)), TURNS)


def layout(pupil):
    bench = Circumstances(pupil, 1.0, 0.2, 0.2, len(TURNS), False, {}, gimbal=("scale_pan", "encoder_pan_0"))
    return Layout(
        PoseBasis(CAMERA, FieldBasis((0.0, 0.0, 250.0), 40.0), 0 if pupil is Pupil.HELD else NUMBER), bench
    )


@pytest.mark.parametrize("pupil", Pupil)
def test_every_unknown_belongs_to_one_effect_and_every_expected_size_to_one_unknown(pupil):
    there = layout(pupil)
    assert len(there.index) == len(there.names)
    prior = RandomPrior.of(there, hyperprior(Lever(0.03, 1.0), pupil))
    assert len(set(prior.places.tolist())) == len(prior.places)
    assert set(prior.groups) | set(there.own.rows) == set(there.rows)


@pytest.mark.parametrize("pupil", Pupil)
def test_an_effect_moves_the_image_by_its_own_unknowns_alone(pupil):
    there = layout(pupil)
    maps = there.maps(POSES)
    for kind in EFFECTS[pupil]:
        effect, at = kind(there.pose, there.bench), there.places(there.names_of(kind))
        alone = np.zeros((len(TURNS), there.pose.size, len(effect.names)))
        effect.fill(alone, POSES)
        assert np.array_equal(maps[:, :, at], alone)


def test_a_hand_brings_what_a_gimbal_has_not():
    held, walks, by_hand = map(layout, (Pupil.HELD, Pupil.WALKS, Pupil.BY_HAND))
    assert len(by_hand.names_of(Along)) == len(TURNS)
    assert by_hand.names_of(OwnByTurn)
    assert not by_hand.names_of(GimbalAside)
    assert not held.names_of(Rim)
    assert walks.names_of(Rim) == by_hand.names_of(Rim) != ()
    assert len(walks.own.places) == len(held.own.places) + NUMBER + 2
