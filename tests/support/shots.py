"""A small shot of many files, for tests of what a stage reads and of what may be written beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Sdf, UsdUtils

# Faces along each side of the cloth.
SIDE = 6

# What `write_shot` writes beside in.usda, and what each file is to it.
ROLES = {
    "geo.usd": "a sublayer of {root}",
    "reference.usda": "a reference of /Root/Props in {root}",
    "payload.usda": "a payload of /Root/Props in {root}",
    "below.usda": "a sublayer of {folder}/payload.usda",
    "chosen.usda": "a reference of /Root/Props{{look=new}} in {root}",
    "other.usda": "a reference of /Root/Props{{look=old}} in {root}",
    "other.png": "a texture of /Root/Props{{look=old}}.map in {root}",
    "named.usda": "a reference of /Root/Props/Named in {root}",
    "map.png": "a texture of /Root/Props.map in {root}",
    "first.exr": "a texture of /Root/Props.maps in {root}",
    "at_time_2.png": "a texture of /Root/Props.moving in {root}",
    "tile.1001.png": "a texture of /Root/Props.tiles in {root}",
    "tile.1002.png": "a texture of /Root/Props.tiles in {root}",
    "sound.wav": "a file of /Root/Props.sound in {root}",
    "clip_1.usda": "a value clip of /Root/Props in {root}",
    "clip_2.usda": "a value clip of /Root/Props in {root}",
    "manifest.usda": "a value clip of /Root/Props in {root}",
    "run.1.usda": "a value clip of /Root/Props in {root}",
    "run_manifest.usda": "a value clip of /Root/Props in {root}",
    "in_clip.png": "a texture of /Props.map in {folder}/clip_1.usda",
    "deep.png": "a texture of /Props.map in {folder}/reference.usda",
    "packed.usdz": "a reference of /Root/Props/Packed in {root}",
    "notes.txt": "a file that the metadata 'customData' of /Root/Props names in {root}",
}

ROOT = """#usda 1.0
(
    defaultPrim = "Root"
    expressionVariables = {
        string name = "named"
    }
    subLayers = [@./geo.usd@]
)

over "Root"
{
    def Scope "Props" (
        prepend references = @./reference.usda@</Props>
        payload = @./payload.usda@</Props>
        prepend variantSets = "look"
        variants = {
            string look = "new"
        }
        assetInfo = {
            asset identifier = @./published.usda@
        }
        customData = {
            asset notes = @./notes.txt@
        }
        clips = {
            dictionary listed = {
                double2[] active = [(1, 0), (2, 1)]
                asset[] assetPaths = [@./clip_1.usda@, @./clip_2.usda@]
                asset manifestAssetPath = @./manifest.usda@
                string primPath = "/Props"
            }
            dictionary numbered = {
                asset manifestAssetPath = @./run_manifest.usda@
                string primPath = "/Props"
                string templateAssetPath = "./run.#.usda"
                double templateEndTime = 2
                double templateStartTime = 1
                double templateStride = 1
            }
        }
    )
    {
        asset map = @./map.png@
        asset[] maps = [@./first.exr@]
        asset tiles = @./tile.<UDIM>.png@
        asset sound = @./sound.wav@
        asset moving.timeSamples = {
            1: @./map.png@,
            2: @./at_time_2.png@,
        }
        variantSet "look" = {
            "new" (
                prepend references = @./chosen.usda@</Props>
            ) {
            }
            "old" (
                prepend references = @./other.usda@</Props>
            ) {
                asset map = @./other.png@
            }
        }

        def Scope "Named" (
            prepend references = @`"./${name}.usda"`@</Props>
        )
        {
        }

        def Scope "Packed" (
            prepend references = @./packed.usdz@</Props>
        )
        {
        }
    }
}
"""
PROPS = """#usda 1.0
def Scope "Props"
{
}
"""
WITH_MAP = """#usda 1.0
def Scope "Props"
{{
    asset map = @./{}@
}}
"""


def cloth_text(name: str = "Cloth") -> str:
    """A layer with a waving cloth at /Root/NAME, as text."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    mesh = Sdf.CreatePrimInLayer(layer, f"/Root/{name}")
    for prim, kind in ((mesh.nameParent, "Xform"), (mesh, "Mesh")):
        prim.specifier, prim.typeName = Sdf.SpecifierDef, kind
    first = (np.arange(SIDE)[:, None] * (SIDE + 1) + np.arange(SIDE)).ravel()
    corners = np.stack([first, first + 1, first + SIDE + 2, first + SIDE + 1], axis=1)
    types = Sdf.ValueTypeNames
    for attribute, kind, value in (
        ("faceVertexCounts", types.IntArray, [4] * len(corners)),
        ("faceVertexIndices", types.IntArray, corners.ravel().tolist()),
        ("subdivisionScheme", types.Token, "none"),
    ):
        Sdf.AttributeSpec(mesh, attribute, kind).default = value
    x, y = (axis.ravel().astype(float) for axis in np.meshgrid(np.arange(SIDE + 1), np.arange(SIDE + 1)))
    Sdf.AttributeSpec(mesh, "points", types.Point3fArray)
    for time in (1.0, 2.0):
        pose = np.stack([x, y, np.sin(0.7 * x + time) + 0.3 * np.cos(y + 2.0 * time)], axis=1)
        layer.SetTimeSample(f"{mesh.path}.points", time, [tuple(point) for point in pose.tolist()])
    layer.defaultPrim = "Root"
    return str(layer.ExportToString())


def write_shot(folder: Path) -> Path:
    """Write in.usda and all that it needs; returns its path."""
    for name in ROLES:
        (folder / name).write_text(PROPS if name.endswith(".usda") else name)
    (folder / "geo.usd").write_text(cloth_text())
    (folder / "payload.usda").write_text(PROPS.replace("1.0", "1.0\n(\n    subLayers = [@./below.usda@]\n)"))
    (folder / "reference.usda").write_text(WITH_MAP.format("deep.png"))
    for clip, name in (("clip_1.usda", "in_clip.png"), ("clip_2.usda", "map.png")):
        (folder / clip).write_text(WITH_MAP.format(name))
    (folder / "packed.usdz").unlink()
    (folder / "content.usda").write_text(PROPS)
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(folder / "content.usda")), str(folder / "packed.usdz"))
    (folder / "content.usda").unlink()
    (folder / "in.usda").write_text(ROOT)
    return folder / "in.usda"


def file_bytes(folder: Path) -> dict[str, bytes]:
    """The bytes of all files in and below a folder by their names."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
