// One mesh in three.js: its positions, normals and colours in the frame that is shown.

// sRGB, of plain surfaces of the two meshes.
const PLAIN = { original: 0xa9b4c2, level: 0xd9a860 };
// Edges stand out from what they lie on.
const LINES = { look: 0x10141a, plain: 0x10141a, heat: 0xffffff, features: 0x000000 };
// The strongest that they are, and the length in pixels from which on: shorter ones would cover the shape.
const LINE_OPACITY = { look: 0.5, plain: 0.55, heat: 0.4, features: 0.5 };
const LINE_LENGTH = 14;
// Dots of named vertices, in pixels.
const DOT_COLOR = 0xe5383b;
const DOT_SIZE = 7;
// Hues in steps of the golden ratio stay apart; vertices outside every feature are grey.
const GOLDEN_RATIO_STEP = 0.6180339887498949;
const NO_FEATURE = 255;
const NO_FEATURE_COLOR = 0x5a5f66;
// Triangles from whose edges the length of edges is estimated.
const LENGTH_SAMPLES = 400;

class MeshView {
  constructor(mesh, grid, kind, marked = [], textures = []) {
    this.mesh = mesh;
    this.grid = grid;
    this.kind = kind;
    this.frame = -1;
    this.count = mesh.wedgeVertex.length;
    this.groupCount = mesh.group.reduce((most, group) => Math.max(most, group), -1) + 1;
    this.sums = new Float32Array(3 * this.groupCount);
    const attribute = (width) => new THREE.BufferAttribute(new Float32Array(width * this.count), width);
    this.geometry = new THREE.BufferGeometry();
    for (const name of ["position", "normal", "color"]) {
      this[name] = attribute(3);
      this[name].setUsage(THREE.DynamicDrawUsage);
      this.geometry.setAttribute(name, this[name]);
    }
    if (mesh.uvs) this.geometry.setAttribute("uv", this.placeOnTexture(mesh.uvs));
    this.geometry.setIndex(new THREE.BufferAttribute(mesh.faces, 1));
    const material = (options) => new THREE.MeshLambertMaterial({
      vertexColors: true, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1, ...options,
    });
    this.bare = material({});
    this.textured = mesh.parts.map((part) => (part.texture === null ? this.bare : material({ map: textures[part.texture] })));
    this.materials = [this.bare, ...this.textured.filter((one) => one !== this.bare)];
    this.solid = new THREE.Mesh(this.geometry, this.bare);
    this.lines = new THREE.Mesh(this.geometry, [nearer(new THREE.MeshBasicMaterial({ wireframe: true, transparent: true }))]);
    this.marked = marked;
    const dots = new THREE.BufferGeometry();
    this.dotPosition = new THREE.BufferAttribute(new Float32Array(3 * marked.length), 3);
    dots.setAttribute("position", this.dotPosition);
    this.dots = new THREE.Points(dots, dotMaterial());
    // The points move and their bounds with them; both meshes are always in view.
    this.solid.frustumCulled = this.lines.frustumCulled = this.dots.frustumCulled = false;
    this.hide(new Set());
    this.flat = false;
  }

  get hasLook() {
    return this.mesh.colors !== null || this.mesh.parts.some((part) => part.texture !== null);
  }

  placeOnTexture({ low, step, nodes }) {
    return new THREE.BufferAttribute(Float32Array.from(nodes, (node, i) => low[i % 2] + step * node), 2);
  }

  // Leave out the parts of these names.
  hide(names) {
    this.shownParts = this.mesh.parts.filter((part) => !names.has(part.name) && part.count);
    this.geometry.clearGroups();
    for (const part of this.shownParts) {
      this.geometry.addGroup(3 * part.start, 3 * part.count, this.mesh.parts.indexOf(part));
    }
  }

  // Draw a frame: colours are "look", "plain", "heat" or "features", shading is "smooth" or "flat".
  show(frame, colors, shading, heatEnd) {
    const moved = frame !== this.frame;
    if (moved) this.move(frame);
    const flat = shading === "flat";
    if ((moved || this.flat) && !flat) this.shadeSmoothly();
    if (flat !== this.flat) {
      for (const material of this.materials) {
        material.flatShading = flat;
        material.needsUpdate = true;
      }
      this.flat = flat;
    }
    const { heat, features } = this.mesh;
    const has = { heat: heat !== null, features: features !== null, look: this.hasLook };
    // What has none of these is plain, and so is the original where the colours are distances.
    const drawn = has[colors] ? colors : "plain";
    const name = drawn === "heat" ? `heat ${heatEnd}` : drawn;
    if (name !== this.painted || (drawn === "heat" && moved)) this.paint(drawn, frame, heatEnd);
    this.painted = name;
    this.drawn = drawn;
    this.solid.material = this.mesh.parts.map((_, index) => (drawn === "look" ? this.textured[index] : this.bare));
    if (this.lines.material.length !== this.mesh.parts.length) {
      this.lines.material = this.mesh.parts.map(() => this.lines.material[0]);
    }
  }

  move(frame) {
    const { nodes, vertexCount, wedgeVertex } = this.mesh;
    const array = this.position.array;
    const start = 3 * vertexCount * frame;
    const { low, step } = this.grid;
    for (let wedge = 0; wedge < this.count; wedge += 1) {
      const from = start + 3 * wedgeVertex[wedge];
      const to = 3 * wedge;
      array[to] = low[0] + step * nodes[from];
      array[to + 1] = low[1] + step * nodes[from + 1];
      array[to + 2] = low[2] + step * nodes[from + 2];
    }
    this.position.needsUpdate = true;
    this.marked.forEach((vertex, i) => {
      for (let axis = 0; axis < 3; axis += 1) this.dotPosition.array[3 * i + axis] = low[axis] + step * nodes[start + 3 * vertex + axis];
    });
    this.dotPosition.needsUpdate = true;
    this.frame = frame;
  }

  // Normals of groups: the mean of their faces, by area.
  shadeSmoothly() {
    const { faces, group } = this.mesh;
    const p = this.position.array;
    const sums = this.sums.fill(0);
    for (let corner = 0; corner < faces.length; corner += 3) {
      const [a, b, c] = [3 * faces[corner], 3 * faces[corner + 1], 3 * faces[corner + 2]];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (let k = 0; k < 3; k += 1) {
        const to = 3 * group[faces[corner + k]];
        sums[to] += x;
        sums[to + 1] += y;
        sums[to + 2] += z;
      }
    }
    const normal = this.normal.array;
    for (let wedge = 0; wedge < this.count; wedge += 1) {
      const from = 3 * group[wedge];
      const to = 3 * wedge;
      const length = Math.hypot(sums[from], sums[from + 1], sums[from + 2]) || 1;
      normal[to] = sums[from] / length;
      normal[to + 1] = sums[from + 1] / length;
      normal[to + 2] = sums[from + 2] / length;
    }
    this.normal.needsUpdate = true;
  }

  paint(drawn, frame, heatEnd) {
    const array = this.color.array;
    const { mesh, count } = this;
    const vertexOf = mesh.wedgeVertex;
    if (drawn === "plain" || (drawn === "look" && !mesh.colors)) {
      const plain = drawn === "plain" ? new THREE.Color(PLAIN[this.kind]) : new THREE.Color(1, 1, 1);
      for (let i = 0; i < array.length; i += 3) plain.toArray(array, i);
    } else if (drawn === "look") {
      for (let i = 0; i < array.length; i += 1) array[i] = MeshView.linear[mesh.colors[i]];
    } else {
      const heat = drawn === "heat";
      const table = heat ? MeshView.heatColors : MeshView.featureColors;
      const source = heat ? mesh.heat : mesh.features;
      const start = heat ? mesh.vertexCount * frame : 0;
      // From steps of this mesh's own scale to those of the one that all levels share.
      const factor = heat && heatEnd > 0 ? mesh.heatScale / heatEnd : 1;
      for (let wedge = 0; wedge < count; wedge += 1) {
        const value = source[start + vertexOf[wedge]];
        const entry = 3 * (heat ? Math.min(255, Math.round(value * factor)) : value);
        array[3 * wedge] = table[entry];
        array[3 * wedge + 1] = table[entry + 1];
        array[3 * wedge + 2] = table[entry + 2];
      }
    }
    this.color.needsUpdate = true;
  }

  // Mean length of some edges in the first frame.
  get edgeLength() {
    if (this.meanLength === undefined) {
      const { faces, nodes, wedgeVertex } = this.mesh;
      const stride = 3 * Math.max(1, Math.floor(faces.length / 3 / LENGTH_SAMPLES));
      let [total, count] = [0, 0];
      for (let corner = 0; corner + 1 < faces.length; corner += stride) {
        const [a, b] = [3 * wedgeVertex[faces[corner]], 3 * wedgeVertex[faces[corner + 1]]];
        total += this.grid.step * Math.hypot(nodes[b] - nodes[a], nodes[b + 1] - nodes[a + 1], nodes[b + 2] - nodes[a + 2]);
        count += 1;
      }
      this.meanLength = count ? total / count : 0;
    }
    return this.meanLength;
  }

  // Nearest hit of a ray with what is shown, as a distance along it; Infinity for none (Möller and Trumbore 1997).
  hit(origin, direction) {
    const p = this.position.array;
    const { faces } = this.mesh;
    let nearest = Infinity;
    const [dx, dy, dz] = [direction.x, direction.y, direction.z];
    for (const part of this.shownParts) {
      for (let corner = 3 * part.start; corner < 3 * (part.start + part.count); corner += 3) {
        const [a, b, c] = [3 * faces[corner], 3 * faces[corner + 1], 3 * faces[corner + 2]];
        const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
        const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
        const qx = dy * vz - dz * vy, qy = dz * vx - dx * vz, qz = dx * vy - dy * vx;
        const det = ux * qx + uy * qy + uz * qz;
        if (det === 0) continue;
        const sx = origin.x - p[a], sy = origin.y - p[a + 1], sz = origin.z - p[a + 2];
        const s = (sx * qx + sy * qy + sz * qz) / det;
        if (s < 0 || s > 1) continue;
        const rx = sy * uz - sz * uy, ry = sz * ux - sx * uz, rz = sx * uy - sy * ux;
        const t = (dx * rx + dy * ry + dz * rz) / det;
        if (t < 0 || s + t > 1) continue;
        const along = (vx * rx + vy * ry + vz * rz) / det;
        if (along > 0 && along < nearest) nearest = along;
      }
    }
    return nearest;
  }

  // Points of the shown parts in some frames, about `most` of them, as an array of numbers.
  samples(frames, most) {
    const { nodes, vertexCount, wedgeVertex, faces } = this.mesh;
    const corners = this.shownParts.reduce((sum, part) => sum + 3 * part.count, 0);
    const stride = Math.max(1, Math.floor((corners * frames.length) / most));
    const { low, step } = this.grid;
    const found = [];
    for (const frame of frames) {
      for (const part of this.shownParts) {
        for (let corner = 3 * part.start; corner < 3 * (part.start + part.count); corner += stride) {
          const from = 3 * (vertexCount * frame + wedgeVertex[faces[corner]]);
          for (let axis = 0; axis < 3; axis += 1) found.push(low[axis] + step * nodes[from + axis]);
        }
      }
    }
    return found;
  }

  // The frame in which some vertex is farthest from the original; null where nothing was measured.
  get worstFrame() {
    const { heat, vertexCount, frameCount } = this.mesh;
    if (!heat) return null;
    let [worst, most] = [0, -1];
    for (let frame = 0; frame < frameCount; frame += 1) {
      for (let i = vertexCount * frame; i < vertexCount * (frame + 1); i += 1) {
        if (heat[i] > most) [worst, most] = [frame, heat[i]];
      }
    }
    return worst;
  }

  dispose() {
    this.geometry.dispose();
    for (const material of [...this.materials, ...this.lines.material, this.dots.material]) material.dispose();
    this.dots.geometry.dispose();
  }
}

// Draws a little nearer than it is, so that the surface something lies on does not hide it.
function nearer(material, alter = () => {}) {
  material.onBeforeCompile = (shader) => {
    const moved = "#include <project_vertex>\n gl_Position.z -= 3e-4 * gl_Position.w;";
    shader.vertexShader = shader.vertexShader.replace("#include <project_vertex>", moved);
    alter(shader);
  };
  return material;
}

// Round dots.
function dotMaterial() {
  const material = new THREE.PointsMaterial({ color: DOT_COLOR, size: DOT_SIZE, sizeAttenuation: false });
  return nearer(material, (shader) => {
    const round = "#include <clipping_planes_fragment>\n if (length(gl_PointCoord - 0.5) > 0.5) discard;";
    shader.fragmentShader = shader.fragmentShader.replace("#include <clipping_planes_fragment>", round);
  });
}

// 256 linear colours for what an 8-bit value stands for.
function colorTable(colorOf) {
  const table = new Float32Array(3 * 256);
  for (let value = 0; value < 256; value += 1) {
    const color = colorOf(value);
    table.set([color.r, color.g, color.b], 3 * value);
  }
  return table;
}

function mapColor(stops, fraction) {
  const at = fraction * (stops.length - 1);
  const index = Math.min(Math.floor(at), stops.length - 2);
  return stops[index].map((channel, i) => channel + (at - index) * (stops[index + 1][i] - channel));
}

function setColorTables(data) {
  MeshView.linear = Float32Array.from({ length: 256 }, (_, value) => new THREE.Color().setRGB(value / 255, 0, 0, THREE.SRGBColorSpace).r);
  MeshView.heatColors = colorTable((value) => {
    const [r, g, b] = mapColor(data.colorMap, value / 255);
    return new THREE.Color().setRGB(r, g, b, THREE.SRGBColorSpace);
  });
  MeshView.featureColors = colorTable((value) =>
    value === NO_FEATURE
      ? new THREE.Color(NO_FEATURE_COLOR)
      : new THREE.Color().setHSL((value * GOLDEN_RATIO_STEP) % 1, 0.75, 0.55)
  );
}
