"""Edit the meshes of a stage in a layer over it, and save that layer, or the flattened stage."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from warpqem.errors import StageError
from warpqem.files.outputs import OutputFile
from warpqem.files.temporary import temporary_path
from warpqem.usd.checks.usd_errors import first_line
from warpqem.usd.layers.asset_paths import move_asset_paths, name_from
from warpqem.usd.layers.sample_saver import SampleSaver
from warpqem.usd.read.inheritors import keep_heirs
from warpqem.usd.read.instances import end_instancing, move_to_classes
from warpqem.usd.read.mesh_skin import Skin
from warpqem.usd.read.open_stage import MeshSelection
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.stage_views import copy_stage_metadata, layer_name, open_like
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.fitted_normals import write_fitted_normals
from warpqem.usd.write.flatten import flattened, write_flat
from warpqem.usd.write.hard_edges import write_hard_edged_normals
from warpqem.usd.write.layer_files import export_layer
from warpqem.usd.write.layer_output import merge_edits
from warpqem.usd.write.map_files import MapFiles, place_maps
from warpqem.usd.write.package import is_package
from warpqem.usd.write.point_samples import PointSamples
from warpqem.usd.write.primvars import name_arrays, transfer_motion, transfer_normals, transfer_primvars
from warpqem.usd.write.remove_properties import Dropped, block, drop_skin, drop_subdivision
from warpqem.usd.write.shape_normals import write_normal_offsets
from warpqem.usd.write.skin_output import write_skin
from warpqem.usd.write.smooth_normals import NORMAL_ATTRIBUTES, has_normals
from warpqem.usd.write.subsets import transfer_subsets

__all__ = ["OverLayer"]


class OverLayer:
    """Edits over an input file, in memory or in a temporary file, until they are saved.

    The stage of the edits has the input as its only sublayer and the same stage metadata.
    """

    def __init__(self, source: Usd.Stage, folder: Path | None = None) -> None:
        """Start an empty layer over the file that `source` was opened from.

        Args:
            source: Stage of the input.
            folder: Where to keep a binary file for the edits, so that point samples need no memory once they are
                authored; None to keep all in memory. The file goes away with this object, or with `close`.

        Raises:
            StageError: there can be no file in the folder.
        """
        self._input = source
        self._source = source.GetRootLayer()
        self._layer = Sdf.Layer.CreateAnonymous("over.usda") if folder is None else _create_layer(folder)
        # Called with the bytes of each sample that is authored in the layer.
        self.count_sample = SampleSaver(self._layer)
        file = Path(self._layer.realPath) if folder is not None else None
        self._remove = weakref.finalize(self, file.unlink, missing_ok=True) if file else None
        self.maps = MapFiles(folder)
        try:
            self.stage: Usd.Stage = self._start()
        except BaseException:
            # An error holds on to this object, and so to the file.
            self.close()
            raise
        self._classes: list[Sdf.Path] = []
        # By the path of the mesh: what was taken off it, and its blend shapes that were written.
        self._dropped: dict[str, list[Dropped]] = {}
        self._shapes: dict[str, list[Sdf.Path]] = {}
        self._on_discard: dict[str, list[Callable[[], None]]] = {}

    def _start(self) -> Usd.Stage:
        copy_stage_metadata(self._source, self._layer)
        name = layer_name(self._source)
        try:
            self._layer.subLayerPaths.append(name)
        except Tf.ErrorException as error:
            raise StageError(f"{name!r}: no layer can name a file of this name ({first_line(error)})") from error
        # In the session layer instances are open.
        return open_like(self._input, self._layer, self._input.GetSessionLayer())

    def close(self) -> None:
        """Remove the temporary files; nothing can be saved any more."""
        self.maps.close()
        if self._remove is not None:
            self._remove()

    @property
    def layer(self) -> Sdf.Layer:
        """The edits."""
        return self._layer

    def discard(self, path: str) -> None:
        """Take back all edits of a mesh, of the prims below it, and of its blend shapes."""
        for edited in (Sdf.Path(path), *self._shapes.pop(path, [])):
            spec = self._layer.GetPrimAtPath(edited)
            if spec:
                del self._layer.GetPrimAtPath(edited.GetParentPath()).nameChildren[spec.name]
        self._dropped.pop(path, None)
        for action in self._on_discard.pop(path, []):
            action()

    def on_discard(self, path: str, action: Callable[[], None]) -> None:
        """Do something when the edits of a mesh are taken back: take back those of what it shares with others."""
        self._on_discard.setdefault(path, []).append(action)

    def point_samples(self, path: str, times: list[float] | None, with_normals: bool = True) -> PointSamples:
        """A sink for the points of the simplified mesh that `replace_mesh` is going to be called for.

        Args:
            path: Prim path of a mesh on the input.
            times: Time code of each frame, None for one frame at the default time.
            with_normals: Whether it writes the normals of a mesh that is to be smooth, if it can.
        """
        mesh = UsdGeom.Mesh(self.stage.OverridePrim(path))
        return PointSamples(mesh, times, self.count_sample, with_normals)

    @property
    def dropped(self) -> list[Dropped]:
        """What was taken off each mesh."""
        return [dropped for found in self._dropped.values() for dropped in found]

    def add_dropped(self, path: str, dropped: Dropped) -> None:
        """Note what was taken off the mesh at a path."""
        self._dropped.setdefault(path, []).append(dropped)

    def replace_mesh(
        self,
        path: str,
        samples: PointSamples,
        times: list[float] | None,
        faces: npt.NDArray[np.int32],
        transfer: AttributeTransfer,
        skin: Skin | None = None,
    ) -> list[str]:
        """Give a mesh new faces, bring its values to them, and drop what cannot be brought.

        Args:
            path: Prim path of a mesh on the input.
            samples: What has its new points already, in local space.
            times: Time code of each frame, None for one frame at the default time.
            faces: int32, shape (N, 3), in the winding of the mesh's authored orientation.
            transfer: Where on the input the new points, faces and corners get their values from.
            skin: The skin that goes on deforming the points, which are then one frame, the rest shape; None for a mesh
                without one, or one whose points are poses.

        Returns:
            Names of what was dropped.
        """
        mesh = UsdGeom.Mesh(self.stage.OverridePrim(path))
        dropped = self._transfer_values(mesh, transfer, times, skin, with_normals=not samples.smooth)
        shaded = transfer.normals != "none" and (samples.shaded_later or dropped.rest_normals)
        # The two sides of a sheet cancel out at its points, where nothing is fitted.
        shaded |= (
            transfer.shades_all and not has_normals(transfer.prim) and not (transfer.is_plain and transfer.has_backs)
        )
        if shaded:
            # They hide what was blocked, and are to be in a flat file.
            normals = mesh.GetNormalsAttr().GetPath()
            dropped.blocked = [path for path in dropped.blocked if path != normals]
        counts = np.full(len(faces), 3, dtype=np.int32)
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.reshape(-1))))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        if shaded and transfer.normals == "fit" and not transfer.has_backs:
            poser = None if skin is None else StagePoses(self.stage).poser(mesh.GetPrim())
            shaded = write_fitted_normals(mesh, transfer, times, self.count_sample, poser)
        elif shaded:
            write_hard_edged_normals(mesh, faces, transfer.hard_edges(), times, self.count_sample)
        if skin is not None and (shaded or samples.smooth):
            write_normal_offsets(mesh, faces, skin.shapes)
        return dropped.names

    def _transfer_values(
        self,
        mesh: UsdGeom.Mesh,
        transfer: AttributeTransfer,
        times: list[float] | None,
        skin: Skin | None,
        with_normals: bool,
    ) -> Dropped:
        dropped = Dropped()
        prim = mesh.GetPrim()
        self.add_dropped(str(prim.GetPath()), dropped)
        if skin is None:
            drop_skin(prim, dropped)
        else:
            self._shapes[str(prim.GetPath())] = [*(shape.path for shape in skin.shapes), *skin.removed_shapes]
            write_skin(self.stage, prim, skin, transfer)
        if skin is None and times is not None:
            points = mesh.GetPointsAttr()
            transfer.frames = range(len(times))
            transfer.read_placed = lambda frame: np.asarray(points.Get(times[frame]), dtype=np.float32)
        if transfer.normals == "none":
            for name in NORMAL_ATTRIBUTES:
                block(prim.GetAttribute(name), dropped)
        elif with_normals:
            transfer_normals(mesh, transfer, dropped, self.count_sample)
        transfer_primvars(prim, transfer, dropped, self.count_sample)
        transfer_motion(prim, transfer, times or [], dropped, self.count_sample)
        name_arrays(prim, transfer, dropped)
        transfer_subsets(mesh, transfer, dropped)
        drop_subdivision(mesh, dropped)
        return dropped

    def share_instances(self, selection: MeshSelection, by_root: bool) -> list[str]:
        """Give what was edited in opened instances to all instances of their prototypes; nothing is edited after that.

        Args:
            selection: The meshes, as they were found on the input.
            by_root: The classes for it are to be below the root prims of the instances, not beside them.

        Returns:
            What was done, a line for each prototype.

        Raises:
            StageError: USD cannot copy the edits.
        """
        keep_heirs(self._layer, selection.prims)
        ended = list(filter(self._layer.GetPrimAtPath, selection.own_instances))
        end_instancing(self._layer, ended)
        moved = move_to_classes(self._layer, selection.shared, self._input, by_root)
        self._classes = list(moved)
        lines = [f"{path}: no instance any more, as what is below it changed" for path in ended]
        for path, users in moved.items():
            others = f" and {len(users) - 1} more instances" if len(users) > 1 else ""
            lines.append(f"the new meshes below {users[0]}{others} come from the class {path}")
        return lines

    def set_vertex_colors(
        self,
        path: str,
        times: list[float] | None,
        colors: Sequence[npt.NDArray[np.float32]] | npt.NDArray[np.float32],
        interpolation: str = "vertex",
    ) -> None:
        """Author `primvars:displayColor` on a mesh, one colour per authored point.

        Args:
            path: Prim path of a mesh on the input.
            times: Time code of each frame of colours, None for one set of colours at the default time.
            colors: float32, shape (F, authored point count, 3), linear Rec. 709; a list of arrays where the number of
                points changes.
            interpolation: Interpolation of the primvar.
        """
        mesh = UsdGeom.Mesh(self.stage.OverridePrim(path))
        primvar = mesh.CreateDisplayColorPrimvar(interpolation)
        if primvar.IsIndexed():
            primvar.BlockIndices()
        _author(primvar.GetAttr(), times, colors, primvar.GetAttr().Get() is not None)

    def save(
        self, output: Path | Sdf.Layer, flatten: bool = False, other_outputs: Sequence[OutputFile] = ()
    ) -> list[str]:
        """Write the layer, or the flattened stage, under a temporary name and rename it.

        Args:
            output: Path checked with `check_output_path`; a package holds the flattened stage and all its files. Or a
                layer checked with `check_output_layer`, which gets the edits alone.
            flatten: Write one self-contained file instead of a layer over the input, see `write_flat`.
            other_outputs: What else is going to be written: no texture may take its place.

        Returns:
            What was left behind, or programs may not read; one line each.

        Raises:
            StageError: the file cannot be written; nothing is left behind.
            OptionError: a texture would take the place of a file that is read, or of another output.
        """
        if isinstance(output, Sdf.Layer):
            merge_edits(self._layer, output, self._input)
            return []
        if flatten or is_package(output):
            layer = flattened(self._input, self._layer, self._classes, self.dropped)
            return write_flat(layer, self._input, output, other_outputs, self.maps)
        # A copy, because an anonymous layer that a stage is open on cannot resolve a relative path.
        layer = Sdf.Layer.CreateAnonymous("save.usda")
        layer.TransferContent(self._layer)
        layer.subLayerPaths[0] = name_from(output, layer_name(self._source))
        place_maps(layer, [("", self.maps)], output, self._input, other_outputs)
        move_asset_paths(layer, self._source, output.parent)
        export_layer(layer, output)
        return []


def _create_layer(folder: Path) -> Sdf.Layer:
    try:
        return Sdf.Layer.CreateNew(os.fspath(temporary_path(folder, ".usdc")))
    except Tf.ErrorException as error:
        raise StageError(f"{folder}: cannot be written to ({first_line(error)})") from error


def _author(
    attribute: Usd.Attribute,
    times: list[float] | None,
    values: Sequence[npt.NDArray[np.float32]] | npt.NDArray[np.float32],
    hides_default: bool,
) -> None:
    """Author one array per frame; a stale default value of a weaker layer is replaced by the first frame."""
    arrays = [Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(value)) for value in values]
    if times is None or hides_default:
        attribute.Set(arrays[0])
    for time, array in zip(times or [], arrays, strict=False):
        attribute.Set(array, time)
