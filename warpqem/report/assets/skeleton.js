// Skeletons: a line from each joint to the one above it, and a dot on each joint, over the meshes.

// sRGB, of joints that move the mesh, of those that moved the original alone, and of those that move nothing.
const JOINT_COLORS = { used: 0x19c5ff, gone: 0xff3b30, idle: 0x8b929b };
const JOINT_SIZE = 6;

class SkeletonView {
  constructor(skeleton, bytes) {
    this.skeleton = skeleton;
    this.nodes = addUp(joinPlanes(bytes, Uint16Array), 3 * skeleton.joints.length);
    this.bones = skeleton.parents.map((parent, joint) => [joint, parent]).filter(([, parent]) => parent >= 0);
    const cloud = (count, Kind, material) => {
      const geometry = new THREE.BufferGeometry();
      for (const name of ["position", "color"]) geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(3 * count), 3));
      const found = new Kind(geometry, material);
      found.frustumCulled = false;
      // After all surfaces, whatever is before it.
      found.renderOrder = 2;
      return found;
    };
    const over = { vertexColors: true, depthTest: false, transparent: true };
    this.lines = cloud(2 * this.bones.length, THREE.LineSegments, new THREE.LineBasicMaterial(over));
    this.dots = cloud(skeleton.joints.length, THREE.Points, new THREE.PointsMaterial({ ...over, size: JOINT_SIZE, sizeAttenuation: false }));
  }

  // What to draw of a frame: `joints` says which joints move the level; null for the original.
  show(frame, joints) {
    const { grid, used } = this.skeleton;
    const start = 3 * used.length * frame;
    const place = (joint, axis) => grid.low[axis] + grid.step * this.nodes[start + 3 * joint + axis];
    const kindOf = (joint) => ((joints || used)[joint] ? "used" : used[joint] ? "gone" : "idle");
    const put = (object, index, joint, kind) => {
      const { position, color } = object.geometry.attributes;
      position.setXYZ(index, place(joint, 0), place(joint, 1), place(joint, 2));
      new THREE.Color(JOINT_COLORS[kind]).toArray(color.array, 3 * index);
      position.needsUpdate = color.needsUpdate = true;
    };
    used.forEach((_, joint) => put(this.dots, joint, joint, kindOf(joint)));
    this.bones.forEach(([joint, parent], i) => {
      put(this.lines, 2 * i, joint, kindOf(joint));
      put(this.lines, 2 * i + 1, parent, kindOf(joint));
    });
    return [this.lines, this.dots];
  }
}
