"""Open again what a stage shows: with its load rules, population mask and resolver context, and other layers."""

from __future__ import annotations

import os

from pxr import Sdf, Tf, Usd

from warpqem.errors import StageError
from warpqem.usd.checks.usd_errors import first_line
from warpqem.usd.read.value_arrays import anchored

__all__ = [
    "copy_stage_metadata",
    "layer_name",
    "open_like",
    "private_view",
    "unopened",
    "without_edits",
]

# What a session layer holds of prims; the rest of its pseudo-root is metadata of the stage.
PRIMS = frozenset({"primChildren", "subLayers", "subLayerOffsets"})

# Metadata of a stage's root layer that belongs to that layer alone: its own sublayers and its own relocates compose
# through it already.
LAYER_ONLY_METADATA = frozenset({"subLayers", "subLayerOffsets", "primChildren", "layerRelocates", "hasOwnedSubLayers"})


def open_like(
    stage: Usd.Stage, root: Sdf.Layer, session: Sdf.Layer | None, mask: Usd.StagePopulationMask | None = None
) -> Usd.Stage:
    """A stage of other layers that loads, populates and resolves as a stage does.

    Args:
        stage: The stage.
        root: Root layer of the new one.
        session: Session layer of the new one, which shares it; None for a new one.
        mask: What the new one shows; None for what the other does.
    """
    session = session or Sdf.Layer.CreateAnonymous("session.usda")
    context = stage.GetPathResolverContext()
    mask = mask or stage.GetPopulationMask()
    if mask == Usd.StagePopulationMask.All():
        opened = Usd.Stage.Open(root, session, context, Usd.Stage.LoadNone)
    else:
        opened = Usd.Stage.OpenMasked(root, session, context, mask, Usd.Stage.LoadNone)
    opened.SetLoadRules(stage.GetLoadRules())
    opened.SetInterpolationType(stage.GetInterpolationType())
    opened.MuteAndUnmuteLayers(stage.GetMutedLayers(), [])
    return opened


def private_view(stage: Usd.Stage) -> Usd.Stage:
    """The same stage with a session layer of its own over that of the stage, so that edits there do not show on it."""
    return open_like(stage, stage.GetRootLayer(), _over(stage.GetSessionLayer()))


def unopened(view: Usd.Stage) -> Usd.Stage:
    """A view of a stage without what was edited in its own session layer, such as instances that were opened."""
    return open_like(view, view.GetRootLayer(), without_edits(view.GetSessionLayer()))


def without_edits(session: Sdf.Layer) -> Sdf.Layer:
    """A session layer with the metadata and sublayers of another one, but none of its prims."""
    bare = Sdf.Layer.CreateAnonymous("session.usda")
    _copy_metadata(session, bare)
    bare.subLayerPaths = list(session.subLayerPaths)
    return bare


def _over(session: Sdf.Layer | None) -> Sdf.Layer:
    layer = Sdf.Layer.CreateAnonymous("session.usda")
    if session is not None and not session.empty:
        # Sublayers bring prims, but no metadata of the stage.
        _copy_metadata(session, layer)
        layer.subLayerPaths.append(session.identifier)
    return layer


def _copy_metadata(source: Sdf.Layer, target: Sdf.Layer) -> None:
    for key in sorted(source.pseudoRoot.ListInfoKeys()):
        if key not in PRIMS:
            target.pseudoRoot.SetInfo(key, source.pseudoRoot.GetInfo(key))


def layer_name(layer: Sdf.Layer) -> str:
    """What other layers call a layer: its file, or its identifier where a resolver has it from elsewhere."""
    return layer.realPath if os.path.isabs(layer.realPath) else layer.identifier


def copy_stage_metadata(source: Sdf.Layer, target: Sdf.Layer) -> None:
    """Give a layer the stage metadata of another, but for what that layer composes by itself."""
    # The keys come in the order of addresses in memory. Sorted, a crate file has the same bytes on every run.
    for key in sorted(source.pseudoRoot.ListInfoKeys()):
        if key not in LAYER_ONLY_METADATA:
            value = source.pseudoRoot.GetInfo(key)
            try:
                target.pseudoRoot.SetInfo(key, anchored(value, source) if isinstance(value, Sdf.AssetPath) else value)
            except (TypeError, Tf.ErrorException) as error:
                raise StageError(f"{source.realPath}: the metadata {key!r} is damaged ({first_line(error)})") from error
