"""The options of `warpqem simplify`, which other commands take too."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection
from enum import Enum
from typing import Annotated, Any

import typer

from warpqem.cli.options import (
    Coherence,
    Device,
    Distance,
    FeatureFloor,
    FeatureThreshold,
    FieldOfView,
    Frames,
    ImageHeight,
    KeyFrames,
    Metric,
    MetricOption,
    Prims,
    ScreenError,
)

__all__ = ["takes_simplify_options"]


FacePoints = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="With --metric face: JSON file with feature points by name, such as face detect writes. They take "
        "precedence over point subsets of the family face and primvars such as face:chin, these over what is found.",
    ),
]
FaceWeight = Annotated[
    float | None,
    typer.Option(
        metavar="FLOAT",
        help="With --metric face: weight of the quadrics of a feature point and of its neighbours, which are summed at "
        "it (equation 1 of multiresolution facial animation); 100 by default.",
    ),
]
FaceRing = Annotated[
    int | None,
    typer.Option(
        metavar="EDGES", help="With --metric face: neighbours up to so many edges away are summed; 1 by default."
    ),
]
FaceKeep = Annotated[
    bool,
    typer.Option(
        "--face-keep/--no-face-keep",
        help="With --metric face: feature points stay as they are at any face count; or as long as their weight holds.",
    ),
]


class MorphWeights(str, Enum):
    """Ways from the distances of morph targets to weights."""

    thirds = "thirds"
    rank = "rank"
    distance = "distance"
    usage = "usage"


class FeatureWeight(str, Enum):
    """What motion features weigh."""

    size = "size"
    root = "root"
    log = "log"
    bend = "bend"


class WeightScales(str, Enum):
    """What painted weights scale."""

    cost = "cost"
    quadrics = "quadrics"


class Placement(str, Enum):
    """Vertex placements."""

    optimal = "optimal"
    endpoint = "endpoint"


def simplify_values(
    ratio: Annotated[
        float | None, typer.Option(help="Share of its triangles that each mesh keeps, above 0 and at most 1.")
    ] = None,
    faces: Annotated[
        int | None,
        typer.Option(help="Triangles of all meshes together; each mesh gets its part by what its faces are worth."),
    ] = None,
    max_error: Annotated[
        float | None,
        typer.Option(
            metavar="PCT",
            help="Largest distance of each mesh from the input, in % of its bounding-box diagonal, proved for every "
            "point and pose, with about the fewest faces; of a skinned mesh before its skin is fitted, and not with "
            "--pose-independent.",
        ),
    ] = None,
    screen_error: ScreenError = None,
    distance: Distance = None,
    fov: FieldOfView = 45.0,
    image_height: ImageHeight = 1080,
    lods: Annotated[
        str | None,
        typer.Option(
            metavar="RATIOS",
            help="Levels of detail, such as 0.5,0.25,0.1: OUT offers IN as LOD0 and one level for each ratio as LOD1, "
            "LOD2, ... in the variant set LOD of its default prim.",
        ),
    ] = None,
    usd_lod: Annotated[
        bool,
        typer.Option(
            "--usd-lod",
            help="With --lods: write the levels with the UsdLod schemas, for renderers to choose by size or distance.",
        ),
    ] = False,
    metric: MetricOption = Metric.dsd,
    coherence: Coherence = 0.5,
    refit: Annotated[
        bool,
        typer.Option("--refit/--no-refit", help="Fit the whole surface once more at the end: better shape, slower."),
    ] = False,
    memoryless: Annotated[
        bool,
        typer.Option(
            "--memoryless/--no-memoryless",
            help="Order by planes of the present faces instead of the input's (Lindstrom & Turk 1998): better shape, "
            "slower.",
        ),
    ] = False,
    placement: Annotated[
        Placement, typer.Option(help="Merged vertices at the optimal point, or at an endpoint of the edge.")
    ] = Placement.optimal,
    key_frames: KeyFrames = 16,
    uv_weight: Annotated[
        float | None,
        typer.Option(
            metavar="FLOAT",
            help="Weight of texture-coordinate error in the choice of collapses: at 1 the whole UV square counts as "
            "much as the bounding-box diagonal; 0 does not look at UVs (Hoppe 1999). By default 0.1 with --metric "
            "face, else 0.",
        ),
    ] = None,
    attribute_weight: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=FLOAT", help="The same for the primvar NAME; may be given several times."),
    ] = None,
    weight_primvar: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Primvar of numbers, painted on the meshes: 10 is ten times as important as 1, infinity locks.",
        ),
    ] = None,
    weight_scales: Annotated[
        WeightScales,
        typer.Option(
            help="What --weight-primvar scales: the cost of collapses, or the quadrics (Kho & Garland 2003), which "
            "also draw merged vertices to what counts more."
        ),
    ] = WeightScales.cost,
    morph_weights: Annotated[
        MorphWeights | None,
        typer.Option(
            help="Keep more detail where blend shapes or poses move the surface more: scale quadrics by thirds of the "
            "points (Berner & Rieger 2006), by rank, by distance, or by distance as an animation uses the shapes."
        ),
    ] = None,
    feature_threshold: FeatureThreshold = None,
    feature_floor: FeatureFloor = None,
    feature_weight: Annotated[
        FeatureWeight | None,
        typer.Option(
            help="With --metric aqem: what a joint weighs: its size in points (the default, Yang et al. 2019), the "
            "root or one plus the logarithm of that, or how far it bends. All but size cost the rest less shape."
        ),
    ] = None,
    face_points: FacePoints = None,
    face_weight: FaceWeight = None,
    face_ring: FaceRing = None,
    face_keep: FaceKeep = True,
    symmetry: Annotated[
        str | None,
        typer.Option(
            metavar="AXIS",
            help="x, y or z: meshes that are their own mirror image across this local axis, at rest or in the first "
            "pose, stay so; auto for the first axis of which this is true.",
        ),
    ] = None,
    lock_borders: Annotated[bool, typer.Option("--lock-borders", help="Keep the points of open borders.")] = False,
    keep_components: Annotated[
        bool,
        typer.Option(
            "--keep-components", help="Let no small component vanish, even if the shape would miss it less than others."
        ),
    ] = False,
    measure: Annotated[
        bool,
        typer.Option(
            "--measure/--no-measure",
            help="Measure what was written against IN, as `warpqem compare` does: RMS and largest distance, flips.",
        ),
    ] = True,
    memory: Annotated[
        str | None,
        typer.Option(
            metavar="BYTES",
            help="Memory that the work on a mesh may take beside the program itself, such as 8G or 500M; by default "
            "most of what is free. It decides how many frames are in memory at once, and no bit of the result.",
        ),
    ] = None,
    frames: Frames = None,
    poses: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="USD file with example poses at the same prim paths, such as another clip: they decide how skinned "
            "meshes are simplified, instead of the animation in IN.",
        ),
    ] = None,
    influences: Annotated[
        int | None,
        typer.Option(help="Joints that move a point of a skinned mesh at most; by default as many as in IN."),
    ] = None,
    skin_fit: Annotated[
        bool,
        typer.Option(
            "--skin-fit/--no-skin-fit",
            help="Fit rest points and joint influences of skinned meshes together to their poses (Landreneau & "
            "Schaefer 2009); or interpolate them.",
        ),
    ] = True,
    pose_independent: Annotated[
        bool,
        typer.Option(
            "--pose-independent",
            help="To compare with: simplify skinned meshes in their rest shape, by the errors of all poses pulled back "
            "to it, and interpolate their skin (DeCoro & Rusinkiewicz 2005).",
        ),
    ] = False,
    asset_root: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DIR",
            help="Refuse inputs that name files outside of this folder and their own; may be given several times.",
        ),
    ] = None,
    prim: Prims = None,
    device: Device = None,
    bake: Annotated[
        bool, typer.Option("--bake", help="Write skinned and blend-shaped meshes as point samples, without their skin.")
    ] = False,
    weld: Annotated[
        bool,
        typer.Option(
            "--weld/--no-weld", help="Join points that lie together in every frame, such as those split at UV seams."
        ),
    ] = True,
    flatten: Annotated[
        bool, typer.Option("--flatten", help="Write one self-contained file instead of a layer over IN.")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Stop at the first mesh that cannot be done, and write nothing.")
    ] = False,
) -> dict[str, Any]:
    """The values of all options by name, for `warpqem.usd.option_values.read_options`.

    The parameters are the definition of the options: their names, types, defaults and help.
    """
    return dict(locals())


def takes_simplify_options(command: Callable[..., None], without: Collection[str] = ()) -> Callable[..., None]:
    """Give a command the options of a simplification beside its own; it gets their values as `options`.

    Those named in `without` keep their defaults.
    """
    own = inspect.signature(command, eval_str=True)
    offered = inspect.signature(simplify_values, eval_str=True).parameters
    shared = {name: parameter for name, parameter in offered.items() if name not in without}
    # What has no default comes first, then the shared options, then those of the command.
    kept = [parameter for name, parameter in own.parameters.items() if name != "options"]
    first = [parameter for parameter in kept if parameter.default is parameter.empty]
    last = [parameter for parameter in kept if parameter.default is not parameter.empty]
    parameters = [*first, *shared.values(), *last]

    @functools.wraps(command)
    def wrapper(**arguments: Any) -> None:
        values = simplify_values(**{name: arguments.pop(name) for name in shared})
        command(**arguments, options=values)

    # Typer reads both.
    wrapper.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
    wrapper.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return wrapper
