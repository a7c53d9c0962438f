"""Which mesh and how few influences, joints and shapes hold a limit together, by a model of how far they are off."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from warpqem.usd.commands.rig_bound import HALF_STEP, fewest_of_rig, fewest_steps, simplify_with_fewer
from warpqem.usd.commands.rig_steps import RigSteps
from warpqem.usd.commands.skin_bound import MAX_STEPS, STEP, Attempt, simplify_skinned
from warpqem.usd.commands.skin_fit import FittedMesh
from warpqem.usd.read.mesh_skin import Influences
from warpqem.usd.write.stage_report import JointsReport

NOTHING = Influences(np.zeros((0, 1), dtype=np.int32), np.zeros((0, 1), dtype=np.float32))
JOINTS, INFLUENCES = 9, 4


def skin(joints: int, added_error: float) -> FittedMesh:
    report = JointsReport(JOINTS, joints, [], [], added_error, [], [], 1)
    return FittedMesh(np.zeros((0, 3), dtype=np.float32), NOTHING, joints=report)


class Model:
    """Meshes are their shares of the limit; a rig is off by that and by what it lacks of all joints and influences."""

    def __init__(self, asked: int, each: float, least: float, influences: int = INFLUENCES, one: float = 0.0) -> None:
        self.asked, self.each, self.least = asked, each, least
        self.influences, self.one = influences, one
        self.shares: list[float] = []

    def simplify(self, share: float) -> float:
        self.shares.append(share)
        return share

    def distance(self, share: float, joints: int, influences: int = INFLUENCES) -> float:
        lack = self.each * (JOINTS - joints) + self.one * (INFLUENCES - influences)
        return self.least + share + lack

    def attempt(self, share: float) -> Attempt:
        def skins(influences: int) -> list[FittedMesh]:
            return [skin(joints, 10 * self.each * (JOINTS - joints)) for joints in range(self.asked, JOINTS + 1)]

        limits = list(range(self.influences, INFLUENCES + 1))
        steps = RigSteps(limits, skins, JOINTS - self.asked + 1)
        return fewest_of_rig(
            share,
            steps,
            1.0,
            lambda rig: self.distance(share, rig.fitted.joints.after, rig.influences) <= 1.0,
        )


@given(st.integers(1, 9), st.floats(0, 0.5), st.floats(0, 1.2))
def test_what_is_said_to_hold_holds_with_as_few_joints_as_its_mesh_allows(asked, each, least):
    model = Model(asked, each, least)
    done = simplify_with_fewer(model.simplify, model.attempt)
    joints = done.rig.fitted.joints.after
    assert done.holds == (model.distance(done.mesh, joints) <= 1.0)
    assert done.reached == (done.holds and joints == asked)
    if done.holds and joints > asked:
        assert model.distance(done.mesh, joints - 1) > 1.0
    if not done.holds:
        assert model.distance(STEP ** (MAX_STEPS - 1), JOINTS) > 1.0
    if model.distance(STEP ** (MAX_STEPS - 1), asked) <= 1.0:
        # The coarsest mesh with which the joints asked for hold.
        assert done.reached
        assert done.mesh == 1.0 or model.distance(done.mesh / STEP, asked) > 1.0
    assert len(model.shares) == len(set(model.shares)) <= MAX_STEPS


@given(st.integers(1, 9), st.floats(0, 0.3), st.integers(1, 4), st.floats(0, 0.6), st.floats(0, 1.2))
def test_neither_joints_nor_influences_stay_that_the_limit_does_not_need(asked, each, influences, one, least):
    model = Model(asked, each, least, influences, one)
    done = simplify_with_fewer(model.simplify, model.attempt)
    joints, most = done.rig.fitted.joints.after, done.rig.influences
    assert done.holds == (model.distance(done.mesh, joints, most) <= 1.0)
    assert done.reached == (done.holds and (joints, most) == (asked, influences))
    if done.holds:
        assert joints == asked or model.distance(done.mesh, joints - 1, most) > 1.0
        assert most == influences or model.distance(done.mesh, joints, most - 1) > 1.0
    else:
        assert (joints, most) == (JOINTS, INFLUENCES)
    assert done.rig.keeps_influences == (most == INFLUENCES > influences)


def test_nothing_is_tried_for_joints_that_are_far_off():
    model = Model(1, 2.0, 0.1)
    done = simplify_with_fewer(model.simplify, model.attempt)
    assert model.shares == [1.0, STEP**HALF_STEP]
    assert (done.rig.fitted.joints.after, done.holds, done.reached) == (JOINTS, True, False)


@given(st.tuples(*[st.integers(1, 17)] * 3), st.tuples(*[st.floats(0, 1)] * 3), st.floats(0, 1.5))
@example((1, 16, 1), (0.0, 1.0, 0.0), 0.5)
def test_steps_found_hold_and_no_one_of_them_can_be_less(sizes, weights, limit):
    """What is off is a sum over the three of how far each is from its last step."""

    def holds(place):
        return sum(w * (1 - (step + 1) / size) for w, step, size in zip(weights, place, sizes, strict=True)) <= limit

    found = fewest_steps(sizes, holds)
    assert found is not None
    assert holds(found)
    for index, step in enumerate(found):
        less = tuple(step - 1 if place == index else other for place, other in enumerate(found))
        assert step == 0 or not holds(less)


@pytest.mark.parametrize("sizes", [(1, 1, 1), (4, 16, 16)])
def test_no_steps_are_found_where_nothing_holds(sizes):
    assert fewest_steps(sizes, lambda place: False) is None


@given(st.floats(STEP ** (MAX_STEPS - 1), 1.1))
def test_the_share_that_a_skin_leaves_is_found_to_a_quarter_of_a_step_and_written_last(most):
    shares: list[float] = []

    def simplify(share: float) -> SimpleNamespace:
        shares.append(share)
        return SimpleNamespace(share=share, faces=range(round(1000 / share)))

    done = simplify_skinned(simplify, lambda mesh: Attempt(mesh, None, holds=mesh.share <= most))
    assert done.holds
    assert shares[-1] == done.mesh.share
    assert min(most, 1.0) - done.mesh.share <= (1 - STEP) / 4 * done.mesh.share / STEP + 1e-9
    assert len(shares) <= MAX_STEPS + 3
