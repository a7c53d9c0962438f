"""What to do with the meshes of a USD file."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from warpqem.arguments.limits import WEIGHTS, Limits
from warpqem.arguments.option_fields import check_options, option
from warpqem.costs.models import Metric as Metric  # read in the signature, as a type of a field that is inherited
from warpqem.costs.models import cost_model
from warpqem.costs.screen_error import ScreenView
from warpqem.usd.commands.option_checks import (
    FRAMES_HELP,
    AttributeWeights,
    check_faces,
    check_lods,
    check_weights,
    parse_faces,
    read_folders,
    read_frames,
    read_length,
    read_paths,
    read_ratios,
    read_weights,
)
from warpqem.usd.commands.option_conflicts import check_conflicts, check_goals
from warpqem.usd.commands.rig_options import RigOptions
from warpqem.usd.read.lengths import parse_length
from warpqem.usd.read.time_codes import FrameRange

if TYPE_CHECKING:
    from warpqem.costs.motion_features import MotionWeighting
    from warpqem.face import FaceProtection, FacialFeatures

__all__ = ["POINT_WEIGHTS", "SimplifyOptions"]

MorphWeights = Literal["thirds", "rank", "distance", "usage"]
WeightScales = Literal["cost", "quadrics"]
FeatureWeight = Literal["size", "root", "log", "bend"]
VaryingTopology = Literal["runs", "refuse"]
Axis = Literal["x", "y", "z", "auto"]
# A dihedral angle changes by half a turn at most.
ANGLE = Limits(0.0, 180.0)
# Of feature points, see `warpqem.face.FaceProtection`.
POINT_WEIGHTS = Limits(1.0, 1e12)
# Texels across a map: fewer hold no island, and more take over 2 GB while they are baked.
MAP_SIZE = Limits(8, 8192)


@dataclass(frozen=True)
class SimplifyOptions(RigOptions):
    """How to simplify the meshes of a stage: to a count (`ratio`, `faces`), within limits, or to levels (`lods`).

    One or more of `ratio`, `faces`, `max_error`, `max_distance` and `screen` are given, or `lods`; of `ratio` and
    `faces` only one. Of several, whichever comes first stops.

    Attributes:
        faces: Triangles of all meshes together, or a share of them such as "25%", split so that a face saves the same
            error on each.
        max_distance: The limit of `max_error` as a length in units of the stage, whatever size a mesh has; or text with
            a unit of its own, such as "2mm", by the stage's metersPerUnit, see `warpqem.usd.read.lengths`.
        screen: Largest error of each mesh on a screen, at a distance in world units: the same limit as `max_distance`.
        lods: Ratios of levels of detail, each smaller than the one before, between 0 and 1. The output offers the input
            and one level for each ratio as variants LOD0, LOD1, ... of the root prim that holds the default prim.
        usd_lod: With `lods`, write the levels as prims below that root prim, with the schemas of UsdLod, instead.
        lod_files: With `lods`, write each level as a file of its own beside the output, which is not written itself:
            OUT_LOD1.usdc, OUT_LOD2.usdc, ... for OUT.usdc.
        max_size_error: A mesh stops above its number of faces, or within its limit, where the estimate of its error
            would pass so many % of its bounding-box diagonal, see `warpqem.options.MeshOptions`; of two triangles none
            goes. 5, a twentieth of its size, keeps cubes and cards whole, and lets meshes of some hundred triangles
            come down to a twentieth of them. None or infinity for no limit.
        uv_weight: Weight of the error of texture coordinates in the order of collapses: at 1 an error of the whole UV
            square counts as much as one bounding-box diagonal, see `warpqem.costs.AttributeField`; 0 does not look at
            them. None for the weight of the metric: 0.1 of "face", 0 of the others.
        attribute_weights: Names of primvars and the weights of their error; for a texture coordinate it takes the place
            of `uv_weight`.
        weight_primvar: Name of a primvar of numbers that say how much the surface counts where it is painted; infinity
            locks. None for none.
        weight_scales: What those numbers scale: "cost", that of collapses, or "quadrics" (Kho & Garland 2003), so that
            merged vertices go nearer to what counts more, too; see `vertex_weights` and `quadric_scale` of
            `warpqem.options.MeshOptions`.
        morph_weights: Scale the error of what moves more between the shapes of a mesh, see
            `warpqem.costs.morph_weights`: "thirds", "rank", "distance" or "usage"; None for no weights.
        face_points: JSON file with feature points by name for the metric "face", such as `warpqem face detect` writes;
            they take precedence over those that the mesh names itself, see
            `warpqem.usd.commands.face_points`, and these over those that are found. They are of the mesh that the file
            names, or of the largest one.
        face_weight: Weight of the feature points, see `warpqem.face.FaceProtection`; None for its default.
        face_ring: Neighbours up to so many edges away count at a feature point; None for the default.
        face_keep: Feature points stay where they are, as points, whatever the face count.
        feature_threshold: With a metric that keeps motion features, such as "aqem": degrees that an edge bends by
            between two frames to be part of one, see `warpqem.costs.MotionWeighting`; None for the mean over all edges.
        feature_floor: Degrees that it bends by in any case; None for 1.
        feature_weight: What a vertex in a motion feature weighs: "size", "root", "log" or "bend"; None for "size".
        measure: Measure every mesh that was written against the input; no bit of the output depends on it.
        symmetry: "x", "y" or "z": a mesh whose first pose, or rest shape, is its own mirror image across that local
            axis stays so; "auto" for the first of them; None for no care. Other meshes are simplified as usual.
        frames: Time codes to read; None for all authored ones.
        poses: USD file with example poses, see `warpqem.usd.read.example_poses`: they decide how a mesh with a skin is
            simplified instead of its own animation, and how one without is beside it. None for none.
        skin_fit: Fit rest points and joint influences of skinned meshes together to their poses, see
            `warpqem.skinning.fit_skin`; otherwise influences are interpolated.
        pose_independent: Simplify meshes with a linear skin in their rest shape, by rest-pose quadrics of the
            errors of all poses, and interpolate their skin, see `warpqem.skinning.rest_pose_quadrics`: a method to
            compare with.
        normals: "fit": normals are fitted to those of the input, see `warpqem.attribute_fit`, and meshes without any
            get those of a smooth surface, but where the skin takes these further from the input's shading in its poses
            than that of its own faces is; "keep": they are blended from the input's nearest points; "none": no mesh has
            any; None: as "fit", but a mesh without any that is not smooth by subdivision gets none.
        bake_normals: Bake what the input's surface shades with, at rest or in the first frame, into a normal map of so
            many texels across for each mesh, see `warpqem.normal_maps`; None for none. Images lie in the folder
            NAME_textures beside the output, or in its package.
        asset_roots: Folders that all files which the input needs must be in, or in its own; empty for anywhere.
        prims: Prim paths; meshes at and below them are simplified. Empty for all.
        bake: Write skinned and blend-shaped meshes as point samples without their skin.
        weld: Join points of a mesh that differ in nothing that moves them before simplifying; what else differs between
            them stays apart as faceVarying values.
        varying_topology: "runs": a mesh whose topology varies over time is simplified run by run of constant topology,
            to the goal in each; "refuse": it is left as it is, with an error.
        flatten: Write one self-contained file instead of a layer over the input.
        strict: Stop at the first mesh that cannot be done, also if it only misses its face count, and write nothing.
    """

    faces: int | str | None = option(
        None,
        "Triangles of all meshes together, such as 5000, or a share of them, such as 25%; each mesh gets its part by "
        "the error that its faces save. For stages of many meshes.",
        "COUNT",
        brief="Triangles of all meshes together, such as 5000 or 25%",
        basic=True,
        parse=parse_faces,
        panel="Goal",
    )
    max_size_error: float | None = option(
        5.0,
        "A mesh stops where the estimate of its error would pass so many % of its bounding-box diagonal, so that cards "
        "and boxes are not destroyed for a face count or a large distance; inf for no limit. It is not proved, "
        "as --max-error is: the measured distance may be larger.",
        "PCT",
        Limits(0.0, open_low=True, infinite=True),
        panel="Goal",
    )
    max_distance: float | str | None = option(
        None,
        "Largest distance of each mesh from the input as a length, in units of the stage or with mm, cm, m, in or ft, "
        "such as 2mm. Limits go together, and with --ratio or --faces: whichever comes first stops.",
        "LENGTH",
        parse=read_length,
        panel="Goal",
    )
    screen: ScreenView | None = option(None, "")
    lods: tuple[float, ...] = option(
        (),
        "Levels of detail, such as 0.5,0.25,0.1: OUT offers IN as LOD0 and one level for each ratio as LOD1, LOD2, ... "
        "in the variant set LOD of its default prim.",
        "SHARES",
        brief="Levels of detail as variants, such as 0.5,0.2,0.1",
        basic=True,
        parse=read_ratios,
        panel="Levels",
    )
    usd_lod: bool = option(
        False,
        "With --lods: write the levels with the UsdLod schemas, for renderers to choose by size or distance.",
        panel="Levels",
    )
    lod_files: bool = option(
        False,
        "With --lods: write each level as a file of its own, OUT_LOD1.usdc, OUT_LOD2.usdc, ..., for programs that know "
        "neither variants nor UsdLod; OUT itself is not written.",
        panel="Levels",
    )
    uv_weight: float | None = option(
        None,
        "Weight of texture-coordinate error in the choice of collapses: at 1 the whole UV square counts as much as the "
        "bounding-box diagonal; 0 does not look at UVs (Hoppe 1999). By default 0.1 with --metric face, else 0.",
        "WEIGHT",
        WEIGHTS,
        panel="What to keep",
    )
    attribute_weights: AttributeWeights = option(
        (),
        "The same for the primvar NAME; may be given several times.",
        "NAME=WEIGHT",
        name="attribute_weight",
        parse=read_weights,
        repeated=True,
        panel="What to keep",
    )
    weight_primvar: str | None = option(
        None,
        "Primvar of numbers, painted on the meshes: 10 is ten times as important as 1, infinity locks.",
        "NAME",
        panel="What to keep",
    )
    weight_scales: WeightScales = option(
        "cost",
        "What --weight-primvar scales: the cost of collapses, or the quadrics (Kho & Garland 2003), which also draw "
        "merged vertices to what counts more.",
        panel="What to keep",
    )
    morph_weights: MorphWeights | None = option(
        None,
        "Keep more detail where blend shapes or poses move the surface more: scale quadrics by thirds of the points "
        "(Berner & Rieger 2006), by rank, by distance, or by distance as an animation uses the shapes.",
        panel="Skin and shapes",
    )
    face_points: str | os.PathLike[str] | None = option(
        None,
        "With --metric face: JSON file with feature points by name, such as face detect writes. They take precedence "
        "over point subsets of the family face and primvars such as face:chin, these over what is found.",
        "FILE",
        panel="What to keep",
    )
    face_weight: float | None = option(
        None,
        "With --metric face: weight of the quadrics of a feature point and of its neighbours, which are summed at it "
        "(equation 1 of multiresolution facial animation); 100 by default.",
        "WEIGHT",
        POINT_WEIGHTS,
        panel="What to keep",
    )
    face_ring: int | None = option(
        None,
        "With --metric face: neighbours up to so many edges away are summed; 1 by default.",
        "EDGES",
        Limits(0),
        panel="What to keep",
    )
    face_keep: bool = option(
        True,
        "With --metric face: feature points stay as they are at any face count; or as long as their weight holds.",
        panel="What to keep",
    )
    feature_threshold: float | None = option(
        None,
        "Joints: degrees that an edge bends by between two frames to be part of one; by default the mean over all "
        "edges. Less finds finer ones.",
        "DEG",
        ANGLE,
        panel="What to keep",
    )
    feature_floor: float | None = option(
        None, "Joints: degrees that an edge bends by in any case; by default 1.", "DEG", ANGLE, panel="What to keep"
    )
    feature_weight: FeatureWeight | None = option(
        None,
        "With --metric aqem: what a joint weighs: its size in points (the default, Yang et al. 2019), the root or one "
        "plus the logarithm of that, or how far it bends. All but size cost the rest less shape.",
        panel="What to keep",
    )
    measure: bool = option(
        True,
        "Measure what was written against IN, as `warpqem compare` does: RMS and largest distance, flips.",
        panel="Output",
    )
    symmetry: Axis | None = option(
        None,
        "Meshes that are their own mirror image across this local axis, at rest or in the first pose, stay so; auto "
        "for the first axis of which this is true.",
        panel="What to keep",
    )
    frames: FrameRange | None = option(
        None, FRAMES_HELP, "START:END[:STEP]", basic=True, parse=read_frames, panel="Input"
    )
    poses: str | os.PathLike[str] | None = option(
        None,
        "USD file with example poses at the same prim paths, such as another clip: they decide how skinned meshes are "
        "simplified, instead of the animation in IN.",
        "FILE",
        panel="Skin and shapes",
    )
    skin_fit: bool = option(
        True,
        "Fit rest points and joint influences of skinned meshes together to their poses (Landreneau & Schaefer 2009); "
        "or interpolate them.",
        panel="Skin and shapes",
    )
    pose_independent: bool = option(
        False,
        "To compare with: simplify skinned meshes in their rest shape, by rest-pose quadrics of all poses, and "
        "interpolate their skin (DeCoro & Rusinkiewicz 2005).",
        panel="Quality",
    )
    normals: Literal["fit", "keep", "none"] | None = option(
        None,
        "Normals fitted to those of IN by least squares, kept from the nearest points of IN, or none. By default they "
        "are fitted where IN has some or is smooth by subdivision; with fit others get some where that looks more "
        "like IN.",
        panel="What to keep",
    )
    bake_normals: int | None = option(
        None,
        "Bake the normals of IN into a normal map of so many texels across for each mesh whose texture coordinates do "
        "not overlap, such as 1024: PNG files in NAME_textures beside OUT, or in its package.",
        "PX",
        MAP_SIZE,
        panel="Output",
    )
    asset_roots: tuple[str, ...] = option(
        (),
        "Refuse inputs that name files outside of this folder and their own; may be given several times.",
        "DIR",
        name="asset_root",
        parse=read_folders,
        repeated=True,
        panel="Input",
    )
    prims: tuple[str, ...] = option(
        (),
        "Only the meshes at and below this prim path, such as /Root/Body; may be given several times.",
        "PATH",
        name="prim",
        basic=True,
        parse=read_paths,
        repeated=True,
        panel="Input",
    )
    bake: bool = option(
        False,
        "Write skinned and blend-shaped meshes as point samples, without their skin.",
        brief="Write skinned meshes as point samples",
        basic=True,
        panel="Skin and shapes",
    )
    varying_topology: VaryingTopology = option(
        "runs",
        "Meshes whose topology varies over time: simplify each run of constant topology over its frames, to the goal "
        "in each; or leave them as they are, with an error.",
        panel="Input",
    )
    weld: bool = option(
        True, "Join points that lie together in every frame, such as those split at UV seams.", panel="What to keep"
    )
    flatten: bool = option(
        False,
        "Write one self-contained file instead of a layer over IN; textures in packages or other folders are copied to "
        "NAME_textures beside it. Of variant sets it has what is selected.",
        basic=True,
        panel="Output",
    )
    strict: bool = option(False, "Stop at the first mesh that cannot be done, and write nothing.", panel="Output")

    def __post_init__(self) -> None:
        """Check the options, and those that need or exclude each other."""
        check_goals(self)
        check_options(self)
        if self.faces is not None:
            check_faces(self.faces)
        if self.max_distance is not None:
            parse_length(self.max_distance, meters_per_unit=1.0)
        if self.memory is not None:
            from warpqem.runtime.memory import parse_bytes

            parse_bytes(self.memory)
        check_lods(self.lods)
        check_weights(self.attribute_weights)
        check_conflicts(self)

    def face_protection(self, features: FacialFeatures | None = None) -> FaceProtection:
        """How these feature points are kept."""
        from warpqem.face import FaceProtection

        chosen: dict[str, Any] = {"weight": self.face_weight, "ring": self.face_ring, "keep": self.face_keep}
        return FaceProtection(features, **{name: value for name, value in chosen.items() if value is not None})

    @property
    def size_limit(self) -> float | None:
        """`max_size_error` for `warpqem.simplify`; None where it limits nothing, as an infinite one."""
        limit = self.max_size_error
        return None if limit is None or math.isinf(limit) else limit

    @property
    def texture_weight(self) -> float:
        """Weight of texture coordinates that `attribute_weights` does not name."""
        return cost_model(self.metric).uv_weight if self.uv_weight is None else self.uv_weight

    @property
    def motion(self) -> MotionWeighting | None:
        """How motion features are found and weighted, for `warpqem.simplify`; None where nothing is asked for."""
        if self.feature_threshold is None and self.feature_floor is None and self.feature_weight is None:
            return None
        from warpqem.costs.motion_features import motion_weighting

        return motion_weighting(self.feature_threshold, self.feature_floor, self.feature_weight)
