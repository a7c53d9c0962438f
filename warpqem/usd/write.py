"""Write simplified meshes as a layer over the input, or as one flat file."""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Ar, Sdf, Tf, Usd, UsdGeom, UsdUtils, Vt

from warpqem.errors import OptionError, StageError
from warpqem.outputs import InputFile, OutputFile, check_outputs
from warpqem.temporary import replacing, temporary_path
from warpqem.usd.arrays import anchored
from warpqem.usd.carrier import Carrier
from warpqem.usd.collect import collect_files, lies_elsewhere, write_collected
from warpqem.usd.drop import Dropped, drop_skin, drop_subdivision
from warpqem.usd.inheritors import keep_heirs
from warpqem.usd.input_files import check_stage_outputs
from warpqem.usd.instances import end_instancing, flat_places, move_to_classes
from warpqem.usd.layer_output import merge_edits
from warpqem.usd.package import PACKAGE_SUFFIX, is_package, write_package
from warpqem.usd.point_samples import PointSamples
from warpqem.usd.primvars import carry_motion, carry_normals, carry_primvars, name_arrays
from warpqem.usd.skin import Skin
from warpqem.usd.skin_output import write_skin
from warpqem.usd.stage import MeshSelection
from warpqem.usd.stage_views import layer_name, open_like, without_edits
from warpqem.usd.subsets import carry_subsets
from warpqem.usd.text_numbers import make_readable
from warpqem.usd.usd_errors import first_line

__all__ = [
    "OverLayer",
    "check_output_path",
    "copy_stage_metadata",
    "export_layer",
    "move_asset_paths",
    "relative_path",
]

OUTPUT_SUFFIXES = (".usd", ".usda", ".usdc")

# Samples are saved to the temporary file when so many bytes of them are in memory.
UNSAVED_BYTES = 8 * 2**20
# A binary file has a time and a place in the file for each sample, 8 bytes each. They are written anew at each save,
# and may come to one byte in four.
SAMPLE_ENTRY_BYTES, TABLE_SHARE = 16, 4

# Metadata of the input's root layer that belongs to that layer alone: its own sublayers and its own relocates compose
# through it already.
LAYER_ONLY_METADATA = frozenset({"subLayers", "subLayerOffsets", "primChildren", "layerRelocates", "hasOwnedSubLayers"})


def check_output_path(
    output: str | os.PathLike[str],
    inputs: Iterable[str | os.PathLike[str]],
    option: str = "output",
    packages: bool = False,
) -> Path:
    """Check that there can be a USD file of a name, before the inputs are opened.

    Args:
        output: The file to write.
        inputs: Files to read, themselves; `warpqem.usd.input_files.check_stage_outputs` looks at all that they name.
        option: Name of the option that names the output, for messages.
        packages: Whether it may be a package (.usdz), too.

    Returns:
        The absolute output path.

    Raises:
        OptionError: the suffix is not one of .usd, .usda, .usdc (.usdz), the folder does not exist, or the path is an
            input.
    """
    path = Path(output).absolute()
    suffixes = (*OUTPUT_SUFFIXES, PACKAGE_SUFFIX) if packages else OUTPUT_SUFFIXES
    if path.suffix.lower() not in suffixes:
        only = " (simplify and batch write packages)" if is_package(path) else ""
        raise OptionError(f"{option} {output}: the suffix must be one of {', '.join(suffixes)}{only}")
    if not path.parent.is_dir():
        raise OptionError(f"{option} {output}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise OptionError(f"{option} {output}: this is a folder")
    check_outputs([OutputFile(option, output)], map(InputFile, inputs))
    return path


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
        self._on_disk = folder is not None
        file = Path(self._layer.realPath) if folder is not None else None
        self._remove = weakref.finalize(self, file.unlink, missing_ok=True) if file else None
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
        self._unsaved = self._samples = 0

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
        """Remove the temporary file; nothing can be saved any more."""
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

    def point_samples(self, path: str, times: list[float] | None) -> PointSamples:
        """A sink for the points of the simplified mesh that `replace_mesh` is going to be called for.

        Args:
            path: Prim path of a mesh on the input.
            times: Time code of each frame, None for one frame at the default time.
        """
        return PointSamples(UsdGeom.Mesh(self.stage.OverridePrim(path)), times, self.count_sample)

    @property
    def dropped(self) -> list[Dropped]:
        """What was taken off each mesh."""
        return [dropped for found in self._dropped.values() for dropped in found]

    def add_dropped(self, path: str, dropped: Dropped) -> None:
        """Note what was taken off the mesh at a path."""
        self._dropped.setdefault(path, []).append(dropped)

    def count_sample(self, size: int) -> None:
        """Save the layer now and then: what is saved is let go of by USD, and read from the file when asked for."""
        self._unsaved += size
        self._samples += 1
        # Each time the table of all samples is written again, so that it must not become most of what is written.
        if self._on_disk and self._unsaved >= max(UNSAVED_BYTES, TABLE_SHARE * SAMPLE_ENTRY_BYTES * self._samples):
            self._unsaved = 0
            if not self._layer.Save():
                raise StageError(f"{self._layer.realPath}: USD cannot write it")

    def replace_mesh(
        self,
        path: str,
        samples: PointSamples,
        times: list[float] | None,
        faces: npt.NDArray[np.int32],
        carrier: Carrier,
        skin: Skin | None = None,
    ) -> list[str]:
        """Give a mesh new faces, bring its values to them, and drop what cannot be brought.

        Args:
            path: Prim path of a mesh on the input.
            samples: What has its new points already, in local space.
            times: Time code of each frame, None for one frame at the default time.
            faces: int32, shape (N, 3), in the winding of the mesh's authored orientation.
            carrier: Where on the input the new points, faces and corners get their values from.
            skin: The skin that goes on deforming the points, which are then one frame, the rest shape; None for a mesh
                without one, or one whose points are poses.

        Returns:
            Names of what was dropped.
        """
        mesh = UsdGeom.Mesh(self.stage.OverridePrim(path))
        dropped = self._carry_values(mesh, carrier, times, skin, with_normals=not samples.smooth)
        counts = np.full(len(faces), 3, dtype=np.int32)
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.reshape(-1))))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        return dropped.names

    def _carry_values(
        self, mesh: UsdGeom.Mesh, carrier: Carrier, times: list[float] | None, skin: Skin | None, with_normals: bool
    ) -> Dropped:
        dropped = Dropped()
        prim = mesh.GetPrim()
        self.add_dropped(str(prim.GetPath()), dropped)
        if skin is None:
            drop_skin(prim, dropped)
        else:
            self._shapes[str(prim.GetPath())] = [shape.path for shape in skin.shapes]
            write_skin(self.stage, prim, skin, carrier)
        carry_primvars(prim, carrier, dropped, self.count_sample)
        if with_normals:
            carry_normals(mesh, carrier, dropped, self.count_sample)
        carry_motion(prim, carrier, times or [], dropped, self.count_sample)
        name_arrays(prim, carrier, dropped)
        carry_subsets(mesh, carrier, dropped)
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
            flatten: Write one self-contained file instead of a layer over the input. Pictures and sounds that lie in
                packages, or outside of the output's folder, go into the folder NAME_textures beside it.
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
        if is_package(output):
            layer = self._flattened()
            collection = collect_files(layer, "textures", lambda place: True, self.stage)
            # What is left outside, and is mostly missing, is named as from the input.
            move_asset_paths(layer, self._source, Path(self._source.realPath).parent)
            return collection.problems + write_package(layer, collection, output)
        problems = []
        if flatten:
            layer = self._flattened()
            folder = f"{output.stem}_textures"
            collection = collect_files(layer, folder, lambda place: lies_elsewhere(place, output.parent), self.stage)
            written = [OutputFile("texture", output.parent / name) for name in collection.files]
            check_stage_outputs([*written, *other_outputs] if written else [], [self._input])
            write_collected(collection, output.parent)
            problems = collection.problems
        else:
            # A copy, because an anonymous layer that a stage is open on cannot resolve a relative path.
            layer = Sdf.Layer.CreateAnonymous("save.usda")
            layer.TransferContent(self._layer)
            layer.subLayerPaths[0] = _named_from(output, layer_name(self._source))
        move_asset_paths(layer, self._source, output.parent)
        export_layer(layer, output)
        return problems

    def _flattened(self) -> Sdf.Layer:
        session = without_edits(self._input.GetSessionLayer())
        layer = open_like(self._input, self._layer, session).Flatten(addSourceFileComment=False)
        for path in self._classes:
            # What instances inherited is in their flattened prototypes.
            del layer.GetPrimAtPath(path.GetParentPath()).nameChildren[path.name]
        for spec in layer.rootPrims:
            # Flattening leaves what instances share as overs, which nothing defines.
            if spec.name.startswith("Flattened_Prototype_") and spec.specifier == Sdf.SpecifierOver:
                spec.specifier = Sdf.SpecifierClass
        for dropped in self.dropped:
            for path in flat_places(layer, dropped.blocked):
                _remove_property(layer, path)
            for path in flat_places(layer, dropped.deactivated):
                spec = layer.GetPrimAtPath(path)
                if spec:
                    # Nothing weaker is left in a flat file that an inactive prim would have to hide.
                    del layer.GetPrimAtPath(path.GetParentPath()).nameChildren[spec.name]
            for path in flat_places(layer, dropped.unbound):
                _author_empty_relationship(layer, path)
            for path in flat_places(layer, dropped.unskinned):
                _remove_api(layer, path, "SkelBindingAPI")
        return layer


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


def _remove_property(layer: Sdf.Layer, path: Sdf.Path) -> None:
    spec = layer.GetPropertyAtPath(path)
    if spec:
        layer.GetPrimAtPath(path.GetPrimPath()).RemoveProperty(spec)


def _remove_api(layer: Sdf.Layer, path: Sdf.Path, name: str) -> None:
    spec = layer.GetPrimAtPath(path)
    applied = spec.GetInfo("apiSchemas").GetAppliedItems()
    spec.SetInfo("apiSchemas", Sdf.TokenListOp.CreateExplicit([api for api in applied if api != name]))


def _author_empty_relationship(layer: Sdf.Layer, path: Sdf.Path) -> None:
    """Flattening leaves out relationships without targets, even if they are empty on purpose."""
    spec = layer.GetRelationshipAtPath(path)
    if not spec:
        spec = Sdf.RelationshipSpec(layer.GetPrimAtPath(path.GetPrimPath()), path.name, custom=False)
    spec.targetPathList.ClearEditsAndMakeExplicit()


def relative_path(target: str, folder: Path) -> str:
    """Path from a folder to a file, anchored so that USD does not look for it on its search path."""
    try:
        relative = os.path.relpath(target, folder)
    except ValueError:
        # On Windows there is no relative path from one drive to another.
        return Path(target).as_posix()
    relative = Path(relative).as_posix()
    return relative if relative.startswith("../") else f"./{relative}"


def _named_from(output: Path, target: str) -> str:
    """How a layer names a file.

    Raises:
        StageError: USD would not find the file by this name, such as one with a backslash, which it takes for a slash.
    """
    if not os.path.isabs(target):
        return target
    path = relative_path(target, output.parent)
    found = Ar.GetResolver().CreateIdentifier(path, Ar.ResolvedPath(os.fspath(output)))
    if os.path.realpath(found) != os.path.realpath(target):
        raise StageError(f"{target!r}: no layer can name a file of this name (USD would look for {found!r})")
    return path


def move_asset_paths(layer: Sdf.Layer, source: Sdf.Layer, folder: Path) -> None:
    """Make absolute asset paths relative to a folder, if the files exist or lie with the input.

    Flattening makes them absolute, and so does carrying them from a layer in one folder to one in another.

    Args:
        layer: The layer to change.
        source: The root layer of the input.
        folder: The folder the layer is going to be in.
    """
    source_folder = Path(source.realPath).parent

    def move(path: str) -> str:
        package = path.split("[", 1)[0]
        if not os.path.isabs(package) or not (os.path.exists(package) or Path(package).is_relative_to(source_folder)):
            return path
        return relative_path(package, folder) + path[len(package) :]

    # USD takes empty paths out of arrays, which then have too few values for their faces.
    with_gaps = _arrays_with_empty_paths(layer)
    UsdUtils.ModifyAssetPaths(layer, move)
    for path, time, array in with_gaps:
        moved = Sdf.AssetPathArray([Sdf.AssetPath(move(asset.path)) if asset.path else asset for asset in array])
        if time is None:
            layer.GetAttributeAtPath(path).default = moved
        else:
            layer.SetTimeSample(path, time, moved)


def _arrays_with_empty_paths(layer: Sdf.Layer) -> list[tuple[Sdf.Path, float | None, Sdf.AssetPathArray]]:
    """Arrays of asset paths some of which are empty: attribute, time (None for the default value), and value."""
    found: list[tuple[Sdf.Path, float | None, Sdf.AssetPathArray]] = []

    def look(path: Sdf.Path) -> None:
        attribute = layer.GetAttributeAtPath(path) if path.IsPropertyPath() else None
        if attribute is None or attribute.typeName != Sdf.ValueTypeNames.AssetArray:
            return
        values = [(time, layer.QueryTimeSample(path, time)) for time in layer.ListTimeSamplesForPath(path)]
        for time, value in [(None, attribute.default), *values]:
            if isinstance(value, Sdf.AssetPathArray) and not all(asset.path for asset in value):
                found.append((path, time, value))

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    return found


def export_layer(layer: Sdf.Layer, output: Path) -> None:
    """Write a layer under a temporary name and rename it.

    Raises:
        StageError: the file cannot be written; nothing is left behind.
    """
    try:
        with replacing(output) as temporary:
            if not layer.Export(os.fspath(temporary)):
                raise StageError(f"{output}: USD cannot write it")
            make_readable(temporary)
    except (OSError, Tf.ErrorException) as error:
        raise StageError(f"{output}: cannot be written ({first_line(error)})") from error
