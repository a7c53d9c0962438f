"""Which mesh and how many joints hold a limit together, by a model of how far they are off."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from warpqem.usd.commands.joint_bound import HALF_STEP, fewest_joints, simplify_with_fewer_joints
from warpqem.usd.commands.skin_bound import MAX_STEPS, STEP, Attempt
from warpqem.usd.commands.skin_fit import FittedMesh
from warpqem.usd.read.mesh_skin import Influences
from warpqem.usd.write.stage_report import JointsReport

NOTHING = Influences(np.zeros((0, 1), dtype=np.int32), np.zeros((0, 1), dtype=np.float32))


def skin(joints: int, added_error: float) -> FittedMesh:
    report = JointsReport(9, joints, [], [], added_error, [], [], 1)
    return FittedMesh(np.zeros((0, 3), dtype=np.float32), NOTHING, joints=report)


class Model:
    """Meshes are their shares of the limit; a skin is off by that and by what it lacks of all joints."""

    def __init__(self, asked: int, each: float, least: float) -> None:
        self.asked, self.each, self.least = asked, each, least
        self.shares: list[float] = []

    def simplify(self, share: float) -> float:
        self.shares.append(share)
        return share

    def distance(self, share: float, joints: int) -> float:
        return self.least + share + self.each * (9 - joints)

    def attempt(self, share: float) -> Attempt:
        steps = [skin(joints, 100 * self.each * (9 - joints) / 10) for joints in range(self.asked, 10)]
        return fewest_joints(share, steps, 1.0, lambda fitted: self.distance(share, fitted.joints.after) <= 1.0)


@given(st.integers(1, 9), st.floats(0, 0.5), st.floats(0, 1.2))
def test_what_is_said_to_hold_holds_with_as_few_joints_as_its_mesh_allows(asked, each, least):
    model = Model(asked, each, least)
    done = simplify_with_fewer_joints(model.simplify, model.attempt)
    joints = done.fitted.joints.after
    assert done.holds == (model.distance(done.mesh, joints) <= 1.0)
    assert done.reached == (done.holds and joints == asked)
    if done.holds and joints > asked:
        assert model.distance(done.mesh, joints - 1) > 1.0
    if not done.holds:
        assert model.distance(STEP ** (MAX_STEPS - 1), 9) > 1.0
    if model.distance(STEP ** (MAX_STEPS - 1), asked) <= 1.0:
        # The coarsest mesh with which the joints asked for hold.
        assert done.reached
        assert done.mesh == 1.0 or model.distance(done.mesh / STEP, asked) > 1.0
    assert len(model.shares) == len(set(model.shares)) <= MAX_STEPS


def test_nothing_is_tried_for_joints_that_are_far_off():
    model = Model(1, 2.0, 0.1)
    done = simplify_with_fewer_joints(model.simplify, model.attempt)
    assert model.shares == [1.0, STEP**HALF_STEP]
    assert (done.fitted.joints.after, done.holds, done.reached) == (9, True, False)
