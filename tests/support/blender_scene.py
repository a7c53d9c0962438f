"""A script for Blender: a rigged and shaped mesh in two clips, and the boxes of meshes in the frames of a file.

blender_scene.py make FOLDER              FOLDER/arm.glb and FOLDER/arm.blend
blender_scene.py boxes FILE OUT.json      (3, 2, 3) the box of all meshes in three frames of each clip
blender_scene.py run FILE SCRIPT ARG...   SCRIPT in a scene, as `blender FILE --python SCRIPT -- ARG...`
"""

import json
import math
import runpy
import sys

import bpy

CLIPS = {"Bend": (1, 21), "Twist": (1, 31)}


def open_file(path):
    if path.endswith(".blend"):
        bpy.ops.wm.open_mainfile(filepath=path)
        return
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=path, disable_bone_shape=True)


def rig():
    bpy.ops.object.armature_add()
    armature = bpy.context.object
    armature.name = "Rig one"
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature.data.edit_bones
    bones[0].name, bones[0].head, bones[0].tail = "Bone.A", (0, 0, 0), (0, 0, 2)
    tip = bones.new("Bone.B")
    tip.head, tip.tail, tip.parent = (0, 0, 2), (0, 0, 4), bones[0]
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def body(armature):
    around, along = 24, 20
    points = [
        (0.5 * math.cos(6.2832 * i / around), 0.5 * math.sin(6.2832 * i / around), 4 * j / along)
        for j in range(along + 1)
        for i in range(around)
    ]
    faces = [
        (j * around + i, j * around + (i + 1) % around, (j + 1) * around + (i + 1) % around, (j + 1) * around + i)
        for j in range(along)
        for i in range(around)
    ]
    mesh = bpy.data.meshes.new("Arm mesh")
    mesh.from_pydata(points, [], faces)
    uv = mesh.uv_layers.new(name="Map 1")
    for polygon in mesh.polygons:
        j, i = divmod(polygon.index, around)
        for corner, (x, y) in zip(polygon.loop_indices, ((0, 0), (1, 0), (1, 1), (0, 1)), strict=True):
            uv.data[corner].uv = ((i + x) / around, (j + y) / along)
    item = bpy.data.objects.new("Arm", mesh)
    bpy.context.collection.objects.link(item)
    for name in ("Bone.A", "Bone.B"):
        item.vertex_groups.new(name=name)
    for vertex in mesh.vertices:
        upper = min(1.0, max(0.0, (vertex.co.z - 1.5) / 1.0))
        item.vertex_groups[0].add([vertex.index], 1.0 - upper, "REPLACE")
        item.vertex_groups[1].add([vertex.index], upper, "REPLACE")
    item.modifiers.new("Armature", "ARMATURE").object = armature
    item.parent = armature
    for color in ("red", "blue"):
        mesh.materials.append(material(f"Skin {color}"))
    for polygon in mesh.polygons:
        polygon.material_index = int(polygon.index >= 10 * around)
    item.shape_key_add(name="Basis")
    for name, z in (("Bulge low", 1.0), ("Bulge high", 3.0)):
        key = item.shape_key_add(name=name)
        for vertex in mesh.vertices:
            grow = 1.0 + 0.6 * math.exp(-4.0 * (vertex.co.z - z) ** 2)
            key.data[vertex.index].co = (vertex.co.x * grow, vertex.co.y * grow, vertex.co.z)
    return item


def material(name):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    image = bpy.data.images.new(f"{name} image", 8, 8)
    image.generated_color = (0.8, 0.2, 0.1, 1.0)
    image.pack()
    node = made.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    shader = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    made.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    return made


def on_track(owner, name):
    """Put the action of an animation on a track of its own."""
    animation = owner.animation_data
    action = animation.action
    action.name = f"{name} {owner.name}"
    track = animation.nla_tracks.new()
    track.name = name
    track.strips.new(name, int(action.frame_range[0]), action)
    track.mute = True
    animation.action = None


def animate(armature, item):
    tip, keys = armature.pose.bones["Bone.B"], item.data.shape_keys
    tip.rotation_mode = "QUATERNION"
    for name, (first, last) in CLIPS.items():
        turn = (math.cos(0.5), math.sin(0.5), 0, 0) if name == "Bend" else (math.cos(0.6), 0, math.sin(0.6), 0)
        block = keys.key_blocks["Bulge low" if name == "Bend" else "Bulge high"]
        for frame, pose, value in ((first, (1, 0, 0, 0), 0.0), (last, turn, 1.0)):
            tip.rotation_quaternion, block.value = pose, value
            tip.keyframe_insert("rotation_quaternion", frame=frame)
            block.keyframe_insert("value", frame=frame)
        on_track(armature, name)
        on_track(keys, name)
        tip.rotation_quaternion, block.value = (1, 0, 0, 0), 0.0


def make(folder):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    armature = rig()
    item = body(armature)
    animate(armature, item)
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/arm.blend")
    # By the names of tracks: an action for the rig and one for the shape keys are one clip.
    bpy.ops.export_scene.gltf(filepath=f"{folder}/arm.glb", export_animation_mode="NLA_TRACKS")


def tracks():
    owners = [*bpy.data.objects, *bpy.data.shape_keys]
    return [track for owner in owners if owner.animation_data for track in owner.animation_data.nla_tracks]


def boxes(path, output):
    open_file(path)
    for owner in [*bpy.data.objects, *bpy.data.shape_keys]:
        if owner.animation_data:
            owner.animation_data.action = None
    found = {}
    for clip, (first, last) in CLIPS.items():
        for track in tracks():
            track.mute = not track.name.startswith(clip)
        found[clip] = []
        for frame in (first, (first + last) // 2, last):
            bpy.context.scene.frame_set(frame)
            shown = bpy.context.evaluated_depsgraph_get()
            corners = []
            for item in bpy.data.objects:
                if item.type == "MESH":
                    posed = item.evaluated_get(shown)
                    corners += [posed.matrix_world @ vertex.co for vertex in posed.to_mesh().vertices]
            found[clip].append([[pick(c[axis] for c in corners) for axis in range(3)] for pick in (min, max)])
    details = {
        item.name: {
            "triangles": sum(len(polygon.vertices) - 2 for polygon in item.data.polygons),
            "keys": [key.name for key in item.data.shape_keys.key_blocks] if item.data.shape_keys else [],
            "groups": [group.name for group in item.vertex_groups],
            "materials": [one.name for one in item.data.materials],
            "uvs": [layer.name for layer in item.data.uv_layers],
        }
        for item in bpy.data.objects
        if item.type == "MESH"
    }
    with open(output, "w") as file:
        json.dump({"boxes": found, "meshes": details}, file)


def run(path, script, *arguments):
    open_file(path)
    sys.argv = [script, "--", *arguments]
    runpy.run_path(script, run_name="__main__")


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    {"make": make, "boxes": boxes, "run": run}[given[0]](*given[1:])
