"""What the skin of a mesh is fitted with: how many joints stay, and what to say where poses do not decide that."""

from __future__ import annotations

import numpy as np

from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.rig_options import RigOptions, single
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.commands.skin_fit import SkinFitter, skin_poses
from warpqem.usd.read.skin_poses import repeated_joint

__all__ = ["make_fitter", "whole_joints_stay"]


def make_fitter(job: MeshJob, options: SimplifyOptions) -> tuple[SkinFitter, list[str]]:
    """What fits a skin, with fewer joints if that is asked for; and what is worth knowing about it."""
    poses, notes, path = skin_poses(job, options), [], job.mesh.path
    most = single(options.influences)
    assert job.skin is not None
    reduces = options.reduces_joints or (most is not None and job.skin.influence_count > most)
    is_still = reduces and np.ptp(poses.transforms()[1:], axis=0).max(initial=0.0) == 0
    if is_still and not options.reduces_joints:
        notes.append(
            f"{path}: nothing animates it, so that the rest pose alone is known and the largest influences stay; poses "
            "(--poses FILE) would say which matter"
        )
    if not options.reduces_joints:
        return SkinFitter(poses), notes
    repeated = repeated_joint(poses.poser)
    if repeated is not None:
        notes.append(f"{path}: its order of joints (skel:joints) stays, as two joints have the name {repeated}")
    limit = options.joint_error
    if is_still:
        lost = "joints go from the leaves" if options.joints is not None else "all joints stay"
        notes.append(
            f"{path}: nothing animates it, so that the rest pose alone is known and {lost}; "
            "poses (--poses FILE) would say which joints matter"
        )
        if options.joints is None:
            return SkinFitter(poses), notes
        limit = None
    return SkinFitter(poses, single(options.joints), limit), notes


def whole_joints_stay(job: MeshJob, options: RigOptions) -> list[str]:
    """A note where more joints than are asked for move a mesh as a whole, which is one motion and stays."""
    given, poser = single(options.joints), job.source.poser
    if job.skin is None or given is None or poser is None or not poser.skinning_query.HasJointInfluences():
        return []
    weights = np.asarray(poser.skinning_query.GetJointWeightsPrimvar().ComputeFlattened())
    count = int(np.count_nonzero(weights))
    if count <= given:
        return []
    return [f"{job.mesh.path}: {count} joints stay, as they move the whole mesh as one; asked for: {given}"]
