"""What Blender does for warpqem, as a script of its own: a scene out as USD, and its simplified meshes back.

Run by Blender or by a Python that has its module `bpy`; see `warpqem.gltf.blender`:

    blender_script.py open IN.glb FOLDER            FOLDER/scene.blend, a stage and FOLDER/meshes.json
    blender_script.py close FOLDER OUT.glb          FOLDER/simplified.usdc in the place of the meshes of the scene

Inside Blender `write_stage` and `take_meshes` do the same with the scene that is open. Skins, shape keys, materials,
actions and all else stay the scene's own: of the simplified stage only the geometry of the meshes is taken.
"""

from __future__ import annotations

import functools
import json
import math
import os
import re
import sys
from collections.abc import Callable
from typing import Any

import bpy

__all__ = ["close_gltf", "open_gltf", "take_meshes", "write_stage"]

# Names of meshes and materials in the stage, by which they are found again: those of the scene may be any text.
MESH_NAME, MATERIAL_NAME = "WarpqemMesh{}", "WarpqemMaterial{}"


def write_stage(path: str) -> dict[str, Any]:
    """Write all meshes of the scene with their skins, shape keys and clips as USD; the scene stays as it is.

    Clips on tracks of the NLA editor are played one after the other, so that all of them decide what is simplified.

    Returns:
        The names that `take_meshes` needs.
    """
    first = {}
    for item in bpy.context.view_layer.objects:
        if item.type == "MESH" and item.data.name not in first:
            first[item.data.name] = item
    names: dict[str, Any] = {"objects": {}, "materials": {}}
    for index, item in enumerate(first.values()):
        names["objects"][MESH_NAME.format(index)] = item.name
    for index, material in enumerate(bpy.data.materials):
        names["materials"][MATERIAL_NAME.format(index)] = material.name
    with _Restored() as restored:
        # A mesh that several objects show is simplified for the first of them.
        chosen = {item.name for item in first.values()}
        for item in bpy.context.view_layer.objects:
            restored.hide(item)
            item.select_set(item.type != "MESH" or item.name in chosen)
        for own, name in names["objects"].items():
            restored.set(bpy.data.objects[name].data, "name", own)
        for own, name in names["materials"].items():
            restored.set(bpy.data.materials[name], "name", own)
        _play_all_clips(restored)
        _call(
            bpy.ops.wm.usd_export,
            filepath=path,
            selected_objects_only=True,
            visible_objects_only=False,
            export_animation=True,
            export_armatures=True,
            export_shapekeys=True,
            # Every bone, so that no weight is left out.
            only_deform_bones=False,
            rename_uvmaps=False,
            export_materials=True,
            export_textures=True,
            convert_orientation=False,
            evaluation_mode="RENDER",
            allow_unicode=False,
        )
    return names


class _Restored:
    """What is changed for a while, and set back in reverse order."""

    def __init__(self) -> None:
        self._before: list[Callable[[], None]] = []

    def __enter__(self) -> _Restored:
        # What clips have moved stays so when they end, and is set back last.
        for keys in bpy.data.shape_keys:
            for block in keys.key_blocks:
                self._before.append(functools.partial(setattr, block, "value", block.value))
        for item in bpy.data.objects:
            for moved in [item, *(item.pose.bones if item.pose is not None else ())]:
                self._before.append(functools.partial(setattr, moved, "matrix_basis", moved.matrix_basis.copy()))
        scene = bpy.context.scene
        self._before.append(functools.partial(scene.frame_set, scene.frame_current, subframe=scene.frame_subframe))
        for item in bpy.context.view_layer.objects:
            self._before.append(functools.partial(item.select_set, item.select_get()))
        return self

    def __exit__(self, *error: object) -> None:
        for put_back in reversed(self._before):
            put_back()

    def set(self, owner: Any, name: str, value: Any) -> None:
        """Set a property for a while."""
        self._before.append(functools.partial(setattr, owner, name, getattr(owner, name)))
        setattr(owner, name, value)

    def hide(self, item: Any) -> None:
        """Show an object that may be hidden; a hidden one cannot be selected."""
        self._before.append(functools.partial(item.hide_set, item.hide_get()))
        item.hide_set(False)


def _animated() -> list[Any]:
    """The animation of all objects, and of the shape keys of meshes."""
    found = [item.animation_data for item in bpy.data.objects] + [keys.animation_data for keys in bpy.data.shape_keys]
    return [animation for animation in found if animation is not None]


def _play_all_clips(restored: _Restored) -> None:
    """Put the strips of all tracks one after the other, those of one name at the same time."""
    tracks = [track for animation in _animated() for track in animation.nla_tracks if len(track.strips)]
    scene = bpy.context.scene
    if not tracks:
        actions = [animation.action for animation in _animated() if animation.action is not None]
        if actions:
            restored.set(scene, "frame_start", math.floor(min(action.frame_range[0] for action in actions)))
            restored.set(scene, "frame_end", math.ceil(max(action.frame_range[1] for action in actions)))
        return
    begin = scene.frame_start
    for name in dict.fromkeys(track.name for track in tracks):
        own = [strip for track in tracks if track.name == name for strip in track.strips]
        start, end = min(strip.frame_start for strip in own), max(strip.frame_end for strip in own)
        for strip in own:
            restored.set(strip, "frame_start_ui", strip.frame_start + begin - start)
            # One that holds would play on through all others.
            restored.set(strip, "extrapolation", "NOTHING")
            restored.set(strip, "blend_type", "REPLACE")
        begin = math.ceil(begin + end - start) + 1
    for animation in _animated():
        if len(animation.nla_tracks):
            if getattr(animation, "action_slot", None) is not None:
                # Set back after the action, which chooses one itself.
                restored.set(animation, "action_slot", None)
            restored.set(animation, "action", None)
            restored.set(animation, "use_nla", True)
    for track in tracks:
        restored.set(track, "mute", False)
    restored.set(scene, "frame_end", begin - 1)


def take_meshes(path: str, names: dict[str, Any], wanted: list[str] | None = None) -> list[str]:
    """Put simplified meshes in the place of those of the scene.

    Args:
        path: The simplified stage.
        names: What `write_stage` has returned, for this scene as it was before.
        wanted: Names of meshes in the stage that are to be taken; None for all.

    Returns:
        The objects whose mesh is another one now.
    """
    before, kinds = set(bpy.data.objects), ("actions", "materials", "meshes", "armatures", "images")
    others = {kind: set(getattr(bpy.data, kind)) for kind in kinds}
    _call(bpy.ops.wm.usd_import, filepath=path, import_subdiv=False, import_usd_preview=False, set_frame_range=False)
    added = [item for item in bpy.data.objects if item not in before]
    taken = []
    for item in added:
        own = item.name.partition(".")[0]
        if item.type == "MESH" and own in names["objects"] and (wanted is None or own in wanted):
            replaced = bpy.data.objects[names["objects"][own]]
            _replace(replaced, item, names["materials"])
            taken.append(replaced.name)
    for item in added:
        bpy.data.objects.remove(item, do_unlink=True)
    # What came with the meshes: clips of the stage would be clips of the scene.
    used = {item.data for item in bpy.data.objects}
    for kind in kinds:
        for item in set(getattr(bpy.data, kind)) - others[kind] - used:
            getattr(bpy.data, kind).remove(item)
    return taken


def _replace(target: Any, source: Any, materials: dict[str, str]) -> None:
    """Give an object, and all that share its mesh, the mesh of another one."""
    old, new = target.data, source.data
    # A mesh with shape keys alone gets a joint on its way, as UsdSkel needs one.
    is_skinned = len(target.vertex_groups) > 0
    group_names = _original_names([group.name for group in source.vertex_groups], _group_names(target))
    for slot, material in enumerate(new.materials):
        name = "" if material is None else material.name.partition(".")[0]
        new.materials[slot] = bpy.data.materials[materials[name]] if name in materials else None
    if not len(new.materials):
        for material in old.materials:
            new.materials.append(material)
    for kind in ("uv_layers", "color_attributes"):
        for was, has in zip(getattr(old, kind), getattr(new, kind), strict=False):
            has.name = was.name
    for key, value in old.items():
        new[key] = value
    if old.shape_keys is not None:
        _take_keys(old.shape_keys, new.shape_keys, old.name)
    for user in [item for item in bpy.data.objects if item.data is old]:
        user.data = new
    # They are the mesh's.
    if not is_skinned:
        target.vertex_groups.clear()
    for group, name in zip(target.vertex_groups, group_names, strict=False):
        group.name = name
    name = old.name
    bpy.data.meshes.remove(old)
    new.name = name


def _group_names(target: Any) -> list[str]:
    """Names of the joints that may move an object."""
    bones = [
        bone.name
        for modifier in target.modifiers
        if modifier.type == "ARMATURE" and modifier.object is not None
        for bone in modifier.object.data.bones
    ]
    return [*bones, *(group.name for group in target.vertex_groups)]


def _original_names(found: list[str], names: list[str]) -> list[str]:
    """The names that those of the stage stand for."""
    known = {re.sub(r"^(?=\d)|[^A-Za-z0-9_]", "_", name): name for name in names}
    return [known.get(name, name) for name in found]


def _take_keys(old: Any, new: Any, name: str) -> None:
    """Names, values and animation of shape keys."""
    count = 0 if new is None else len(new.key_blocks)
    if count != len(old.key_blocks):
        raise SystemExit(f"{name}: {len(old.key_blocks)} shape keys went to USD, {count} came back")
    for was, has in zip(old.key_blocks, new.key_blocks, strict=True):
        for field in ("name", "slider_min", "slider_max", "value", "mute", "interpolation"):
            setattr(has, field, getattr(was, field))
    new.use_relative, old_name = old.use_relative, old.name
    if new.animation_data is not None:
        new.animation_data_clear()
    if old.animation_data is not None:
        _copy_animation(old.animation_data, new.animation_data_create())
    old.name, new.name = f"{old_name}.old", old_name


def _copy_animation(old: Any, new: Any) -> None:
    for track in old.nla_tracks:
        copy = new.nla_tracks.new()
        for strip in track.strips:
            made = copy.strips.new(strip.name, int(strip.frame_start), strip.action)
            made.action_frame_start, made.action_frame_end = strip.action_frame_start, strip.action_frame_end
            made.frame_end, made.frame_start = strip.frame_end, strip.frame_start
            if hasattr(strip, "action_slot"):
                made.action_slot = strip.action_slot
        copy.name, copy.mute = track.name, track.mute
    if old.action is not None:
        new.action = old.action
        if hasattr(old, "action_slot"):
            new.action_slot = old.action_slot


def open_gltf(path: str, folder: str) -> None:
    """Load a glTF file, and write the scene and its stage into a folder, where `input.json` says how."""
    with open(os.path.join(folder, "input.json"), encoding="utf-8") as file:
        given = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = given["frames_per_second"]
    # With shapes of bones there is a mesh that stands for them.
    _call(bpy.ops.import_scene.gltf, filepath=path, bone_heuristic="BLENDER", disable_bone_shape=True)
    for node, mesh in given["skinned"]:
        _name_as_node(node, mesh)
    bpy.ops.wm.save_as_mainfile(filepath=os.path.join(folder, "scene.blend"))
    names = write_stage(os.path.join(folder, given["stage"]))
    with open(os.path.join(folder, "meshes.json"), "w", encoding="utf-8") as file:
        json.dump(names, file)


def _name_as_node(node: str, mesh: str) -> None:
    """Name a skinned mesh as its node, which Blender's importer makes an empty object beside it."""
    named, shown = bpy.data.objects.get(node), bpy.data.objects.get(mesh)
    if shown is None or shown.type != "MESH" or named is shown:
        return
    if named is not None and named.type == "EMPTY" and not named.children:
        bpy.data.objects.remove(named, do_unlink=True)
        named = None
    if named is None:
        shown.name = node


def close_gltf(folder: str, path: str) -> None:
    """Write the scene with the simplified meshes as a glTF file."""
    bpy.ops.wm.open_mainfile(filepath=os.path.join(folder, "scene.blend"))
    with open(os.path.join(folder, "meshes.json"), encoding="utf-8") as file:
        names = json.load(file)
    take_meshes(os.path.join(folder, "simplified.usdc"), names, names.get("wanted"))
    _call(
        bpy.ops.export_scene.gltf,
        filepath=path,
        export_format="GLB" if path.lower().endswith(".glb") else "GLTF_SEPARATE",
        export_animation_mode="ACTIONS",
        export_extras=True,
        export_cameras=True,
        export_lights=True,
        export_tangents=bool(names.get("tangents")),
        export_all_influences=bool(names.get("influences")),
        export_optimize_animation_size=False,
    )


def _call(operator: Any, **options: Any) -> None:
    """Call an operator with those of some options that this version of Blender has."""
    known = operator.get_rna_type().properties
    operator(**{name: value for name, value in options.items() if name in known})


def main(arguments: list[str]) -> None:
    """Open or close a glTF file."""
    step, first, second = arguments
    if step == "open":
        open_gltf(first, second)
    else:
        close_gltf(first, second)


if __name__ == "__main__":
    # Blender gives a script what stands behind two dashes.
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
