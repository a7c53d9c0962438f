"""What to do with the meshes of a USD file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warpqem.cost_models import cost_model
from warpqem.errors import OptionError
from warpqem.memory import parse_bytes
from warpqem.motion import MotionWeighting, motion_weighting
from warpqem.screen import ScreenView
from warpqem.symmetry import AXES
from warpqem.usd.frames import FrameRange
from warpqem.usd.option_checks import WEIGHT_SCALES, AttributeWeights, check_lods, check_weights

if TYPE_CHECKING:
    from warpqem.face import FaceProtection, FacialFeatures

__all__ = ["SimplifyOptions"]


@dataclass(frozen=True)
class SimplifyOptions:
    """How to simplify. Exactly one of `ratio`, `faces`, `max_error`, `screen` and `lods` is given.

    Attributes:
        ratio: Share of its triangles that each mesh keeps, above 0 and at most 1.
        faces: Triangles of all meshes together, split so that a face saves the same error on each.
        max_error: Largest distance of each mesh from the input, at every point and in every pose, in % of its
            bounding-box diagonal there, see `warpqem.simplify`. Where a skin is fitted, of the points that it is fitted
            to.
        screen: Largest error of each mesh on a screen, at a distance in world units.
        lods: Ratios of levels of detail, each smaller than the one before, between 0 and 1. The output offers the input
            and one level for each ratio as variants LOD0, LOD1, ... of the root prim that holds the default prim.
        usd_lod: With `lods`, write the levels as prims below that root prim, with the schemas of UsdLod, instead.
        metric: Cost model, see `warpqem.simplify`.
        coherence: 0 to 1, see `warpqem.simplify`.
        refit: Fit the surface as a whole after placing its vertices, see `warpqem.simplify`.
        memoryless: Order by quadrics of the present faces, see `warpqem.simplify`; each level of detail is
            then ordered on its own.
        placement: Vertex placement, see `warpqem.simplify`.
        key_frames: Frames that decide the topology.
        uv_weight: Weight of the error of texture coordinates in the order of collapses: at 1 an error of the whole UV
            square counts as much as one bounding-box diagonal, see `warpqem.AttributeField`; 0 does not look at them.
            None for the weight of the metric: 0.1 of "face", 0 of the others.
        attribute_weights: Names of primvars and the weights of their error; for a texture coordinate it takes the place
            of `uv_weight`.
        weight_primvar: Name of a primvar of numbers that say how much the surface counts where it is painted; infinity
            locks. None for none.
        weight_scales: What those numbers scale: "cost", that of collapses, or "quadrics" (Kho & Garland 2003), so that
            merged vertices go nearer to what counts more, too; see `vertex_weights` and `quadric_scale` of
            `warpqem.simplify`.
        morph_weights: Scale the error of what moves more between the shapes of a mesh, see `warpqem.morph_weights`:
            "thirds", "rank", "distance" or "usage"; None for no weights.
        face_points: JSON file with feature points by name for the metric "face", such as `warpqem face detect` writes;
            they take precedence over those that the mesh names itself, see `warpqem.usd.face_points`, and these over
            those that are found. They are of the mesh that the file names, or of the largest one.
        face_weight: Weight of the feature points, see `warpqem.FaceProtection`; None for its default.
        face_ring: Neighbours up to so many edges away count at a feature point; None for the default.
        face_keep: Feature points stay where they are, as points, whatever the face count.
        feature_threshold: With a metric that keeps motion features, such as "aqem": degrees that an edge bends by
            between two frames to be part of one, see `warpqem.MotionWeighting`; None for the mean over all edges.
        feature_floor: Degrees that it bends by in any case; None for 1.
        feature_weight: What a vertex in a motion feature weighs: "size", "root", "log" or "bend"; None for "size".
        lock_borders: Points at edges with one face keep their position.
        keep_components: No small component vanishes, see `warpqem.simplify`.
        measure: Measure every mesh that was written against the input; no bit of the output depends on it.
        symmetry: "x", "y" or "z": a mesh whose first pose, or rest shape, is its own mirror image across that local
            axis stays so; "auto" for the first of them; None for no care. Other meshes are simplified as usual.
        memory: Bytes that the work on a mesh may take, beside what the program and USD hold already, or text such as
            "8G"; None for most of what is free. It decides how many frames are in memory at once.
        frames: Time codes to read; None for all authored ones.
        poses: USD file with example poses, see `warpqem.usd.example_poses`: they decide how a mesh with a skin is
            simplified instead of its own animation, and how one without is beside it. None for none.
        influences: Joints that move a new point of a skinned mesh at most; None for as many as in the input.
        skin_fit: Fit rest points and joint influences of skinned meshes together to their poses, see
            `warpqem.skinning.fit`; otherwise influences are interpolated.
        pose_independent: Simplify meshes with a linear skin in their rest shape, by the errors of all poses pulled back
            to it, and interpolate their skin, see `warpqem.skinning.pullback`: a method to compare with.
        asset_roots: Folders that all files which the input needs must be in, or in its own; empty for anywhere.
        prims: Prim paths; meshes at and below them are simplified. Empty for all.
        device: Warp device; None for the default.
        bake: Write skinned and blend-shaped meshes as point samples without their skin.
        weld: Join points of a mesh that differ in nothing that moves them before simplifying; what else differs between
            them stays apart as faceVarying values.
        flatten: Write one self-contained file instead of a layer over the input.
        strict: Stop at the first mesh that cannot be done, also if it only misses its face count, and write nothing.
    """

    ratio: float | None = None
    faces: int | None = None
    max_error: float | None = None
    screen: ScreenView | None = None
    lods: tuple[float, ...] = ()
    usd_lod: bool = False
    metric: str = "dsd"
    coherence: float = 0.5
    refit: bool = False
    memoryless: bool = False
    placement: str = "optimal"
    key_frames: int = 16
    uv_weight: float | None = None
    attribute_weights: AttributeWeights = ()
    weight_primvar: str | None = None
    weight_scales: str = "cost"
    morph_weights: str | None = None
    face_points: str | os.PathLike[str] | None = None
    face_weight: float | None = None
    face_ring: int | None = None
    face_keep: bool = True
    feature_threshold: float | None = None
    feature_floor: float | None = None
    feature_weight: str | None = None
    lock_borders: bool = False
    keep_components: bool = False
    measure: bool = True
    symmetry: str | None = None
    memory: int | str | None = None
    frames: FrameRange | None = None
    poses: str | os.PathLike[str] | None = None
    influences: int | None = None
    skin_fit: bool = True
    pose_independent: bool = False
    asset_roots: tuple[str, ...] = ()
    prims: tuple[str, ...] = ()
    device: str | None = None
    bake: bool = False
    weld: bool = True
    flatten: bool = False
    strict: bool = False

    def __post_init__(self) -> None:
        """Check the targets; the core checks the other options."""
        given = [name for name in ("ratio", "faces", "max_error", "screen") if getattr(self, name) is not None]
        given += ["lods"] if self.lods else []
        if len(given) != 1:
            raise OptionError(
                f"exactly one of ratio, faces, max_error, screen and lods must be given, not {given or 'none'}"
            )
        if self.ratio is not None and not 0 < self.ratio <= 1:
            hint = f"; for {self.ratio:g} % give {self.ratio / 100:g}" if 1 < self.ratio <= 100 else ""
            raise OptionError(f"ratio {self.ratio:g}: expected a share above 0 and at most 1{hint}")
        if self.faces is not None and self.faces < 1:
            raise OptionError(f"faces {self.faces}: expected at least 1")
        if self.max_error is not None and not self.max_error > 0:
            raise OptionError(f"max_error {self.max_error:g}: expected a percentage above 0")
        if self.influences is not None and self.influences < 1:
            raise OptionError(f"influences {self.influences}: expected at least 1")
        if self.memory is not None:
            parse_bytes(self.memory)
        check_lods(self.lods)
        check_weights(self.uv_weight, self.attribute_weights)
        self._check_face()
        if self.weight_scales not in WEIGHT_SCALES:
            raise OptionError(f"weight_scales {self.weight_scales!r}: expected one of {', '.join(WEIGHT_SCALES)}")
        # It checks its values when it is made.
        _ = self.motion
        if self.symmetry not in (None, "auto", *AXES):
            raise OptionError(f"symmetry {self.symmetry!r}: expected auto, {', '.join(AXES)}")
        others = (
            self.symmetry
            or self.refit
            or self.memoryless
            or self.bake
            or self.lods
            or self.metric != "dsd"
            or self.placement != "optimal"
            or self.motion is not None
        )
        if self.pose_independent and others:
            raise OptionError(
                "pose_independent excludes symmetry, refit, memoryless, bake, lods, another metric, its options and "
                "another placement"
            )
        if self.lods and self.flatten:
            raise OptionError("lods and flatten exclude each other: every level is a layer over the input")
        if self.usd_lod and not self.lods:
            raise OptionError("usd_lod needs lods: the ratios of the levels")

    def _check_face(self) -> None:
        given = [name for name in ("face_points", "face_weight", "face_ring") if getattr(self, name) is not None]
        given += [] if self.face_keep else ["face_keep"]
        if given and not cost_model(self.metric).keeps_face:
            raise OptionError(f"{given[0]}: needs metric 'face', not {self.metric!r}")
        if given:
            self.face_protection()

    def face_protection(self, features: FacialFeatures | None = None) -> FaceProtection:
        """How these feature points are kept.

        Raises:
            OptionError: the weight or the ring is out of range.
        """
        from warpqem.face import FaceProtection

        chosen: dict[str, Any] = {"weight": self.face_weight, "ring": self.face_ring, "keep": self.face_keep}
        return FaceProtection(features, **{name: value for name, value in chosen.items() if value is not None})

    @property
    def texture_weight(self) -> float:
        """Weight of texture coordinates that `attribute_weights` does not name."""
        return cost_model(self.metric).uv_weight if self.uv_weight is None else self.uv_weight

    @property
    def motion(self) -> MotionWeighting | None:
        """How motion features are found and weighted, for `warpqem.simplify`; None where nothing is asked for."""
        return motion_weighting(self.feature_threshold, self.feature_floor, self.feature_weight)
