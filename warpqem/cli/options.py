"""Arguments and options that several commands have."""

from __future__ import annotations

from enum import Enum
from typing import Annotated

import typer

from warpqem.cost_models import cost_model_names

__all__ = [
    "Coherence",
    "Device",
    "Distance",
    "FeatureFloor",
    "FeatureThreshold",
    "FieldOfView",
    "Frames",
    "ImageHeight",
    "Input",
    "JsonReport",
    "KeyFrames",
    "MeshInput",
    "MeshMemory",
    "MeshOutput",
    "Metric",
    "MetricOption",
    "Output",
    "Prims",
    "ReportPage",
    "ScreenError",
    "StageOutput",
    "Variants",
]


# Cost models, those of other packages too; none of them is loaded for it.
Metric = Enum("Metric", {name: name for name in cost_model_names()}, type=str)  # type: ignore[misc]

Input = Annotated[str, typer.Argument(metavar="IN", help="USD file to read (.usd, .usda, .usdc, .usdz).")]

Output = Annotated[
    str,
    typer.Option(
        "--output", "-o", metavar="OUT", help="USD file to write (.usd, .usda, .usdc); replaced if it exists, never IN."
    ),
]

MeshInput = Annotated[
    str,
    typer.Argument(
        metavar="IN",
        help="USD file to read (.usd, .usda, .usdc, .usdz), or mesh files, one for each frame, such as 'horse-*.ply'.",
    ),
]

MeshOutput = Annotated[
    str,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT",
        help="USD file to write (.usd, .usda, .usdc, .usdz), or with mesh files as IN such files, for example "
        "out/horse_####.ply (.ply, .obj, .stl, .off, .glb); replaced if it exists, never IN.",
    ),
]

StageOutput = Annotated[
    str,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT",
        help="USD file to write (.usd, .usda, .usdc, .usdz); replaced if it exists, never IN.",
    ),
]

Prims = Annotated[
    list[str] | None,
    typer.Option(
        "--prim",
        metavar="PATH",
        help="Only the meshes at and below this prim path, such as /Root/Body; may be given several times.",
    ),
]

Variants = Annotated[
    list[str] | None,
    typer.Option(
        "--variant",
        metavar="SET=NAME",
        help="Variant to look at instead of the one that the file selects, such as LOD=LOD1; '/Prim/Path{SET=NAME}' "
        "where several prims have the set. May be given several times, and goes for each file that has the set.",
    ),
]

Frames = Annotated[
    str | None,
    typer.Option(
        "--frames",
        metavar="START:END[:STEP]",
        help="Only the samples from START to END, in time codes; with STEP, poses interpolated every STEP time codes.",
    ),
]

Device = Annotated[
    str | None,
    typer.Option(
        "--device", metavar="NAME", help="Warp device, such as cpu or cuda:0; by default the GPU if there is one."
    ),
]

JsonReport = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the report as JSON to FILE, or to stdout for -."),
]

ReportPage = Annotated[
    str | None,
    typer.Option(
        "--report",
        metavar="FILE",
        help="Write a page (.html) that shows both in motion, their distance and all figures; it opens offline.",
    ),
]

MetricOption = Annotated[
    Metric,
    typer.Option(
        "--metric",
        help="Cost model: dsd sums the error over frames (Mohr & Gleicher 2003), qem takes the first pose only "
        "(Garland & Heckbert 1997), dod adds stretching edges (Huang, Chen & Chuang), aqem keeps joints (Yang et al. "
        "2019), face keeps the feature points of a face. Installed packages may offer more.",
    ),
]

FeatureThreshold = Annotated[
    float | None,
    typer.Option(
        "--feature-threshold",
        metavar="DEG",
        help="Joints: degrees that an edge bends by between two frames to be part of one; by default the mean over all "
        "edges. Less finds finer ones.",
    ),
]

FeatureFloor = Annotated[
    float | None,
    typer.Option(
        "--feature-floor", metavar="DEG", help="Joints: degrees that an edge bends by in any case; by default 1."
    ),
]

Coherence = Annotated[
    float,
    typer.Option(
        "--coherence",
        help="0 to 1: 0 fits every frame on its own, 1 lets vertices stick to the surface over time.",
    ),
]

MeshMemory = Annotated[
    str | None,
    typer.Option(
        "--memory",
        metavar="BYTES",
        help="Memory that a progressive mesh may take, such as 8G or 500M, where the file is trusted; by default 64M, "
        "or 256 times the size of the file where that is more. Files of this version of warpqem need no more.",
    ),
]

KeyFrames = Annotated[
    int, typer.Option("--key-frames", help="Number of frames, different in pose, that decide the topology.")
]

ScreenError = Annotated[
    float | None,
    typer.Option("--screen-error", metavar="PX", help="Largest error in pixels, seen from --distance."),
]

Distance = Annotated[
    float | None,
    typer.Option("--distance", help="With --screen-error: from the camera to the mesh, in units of the stage."),
]

FieldOfView = Annotated[
    float, typer.Option("--fov", metavar="DEG", help="With --screen-error: vertical field of view, in degrees.")
]

ImageHeight = Annotated[
    int, typer.Option("--image-height", metavar="PX", help="With --screen-error: height of the picture, in pixels.")
]
