// The meshes in three.js: one camera for both panes, so that they turn together.

// sRGB, as the plain surfaces of the two meshes.
const PLAIN = { original: 0xb9bfc7, level: 0xc8ae84 };
// Edges stand out from what they lie on.
const LINES = { plain: 0x10141a, heat: 0xffffff, features: 0x000000 };
// Dots of named vertices, in pixels.
const DOT_COLOR = 0xe5383b;
const DOT_SIZE = 7;
// Part of the picture that is left free around the box.
const MARGIN = 1.06;
// Hues in steps of the golden ratio stay apart; vertices outside every feature are grey.
const GOLDEN_RATIO_STEP = 0.6180339887498949;
const NO_FEATURE = 255;
const NO_FEATURE_COLOR = 0x5a5f66;

class MeshView {
  constructor(mesh, grid, kind, marked = []) {
    this.mesh = mesh;
    this.grid = grid;
    this.kind = kind;
    this.frame = -1;
    const geometry = new THREE.BufferGeometry();
    this.position = new THREE.BufferAttribute(new Float32Array(3 * mesh.vertexCount), 3);
    this.position.setUsage(THREE.DynamicDrawUsage);
    this.color = new THREE.BufferAttribute(new Uint8Array(3 * mesh.vertexCount), 3, true);
    geometry.setAttribute("position", this.position);
    geometry.setAttribute("color", this.color);
    geometry.setIndex(new THREE.BufferAttribute(mesh.faces, 1));
    this.material = new THREE.MeshLambertMaterial({
      color: PLAIN[kind], flatShading: true, side: THREE.DoubleSide,
      polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
    });
    this.solid = new THREE.Mesh(geometry, this.material);
    this.lines = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ wireframe: true, transparent: true, opacity: 0.4 }));
    this.marked = marked;
    const dots = new THREE.BufferGeometry();
    this.dotPosition = new THREE.BufferAttribute(new Float32Array(3 * marked.length), 3);
    dots.setAttribute("position", this.dotPosition);
    this.dots = new THREE.Points(dots, dotMaterial());
    this.dots.frustumCulled = false;
    // The points move and their bounds with them; both meshes are always in view.
    this.solid.frustumCulled = this.lines.frustumCulled = false;
  }

  show(frame, colors) {
    const { nodes, vertexCount, heat, features } = this.mesh;
    const moved = frame !== this.frame;
    if (moved) {
      const array = this.position.array;
      const start = 3 * vertexCount * frame;
      const { low, step } = this.grid;
      for (let i = 0; i < array.length; i += 3) {
        array[i] = low[0] + step * nodes[start + i];
        array[i + 1] = low[1] + step * nodes[start + i + 1];
        array[i + 2] = low[2] + step * nodes[start + i + 2];
      }
      this.position.needsUpdate = true;
      this.marked.forEach((vertex, i) => this.dotPosition.set(array.subarray(3 * vertex, 3 * vertex + 3), 3 * i));
      this.dotPosition.needsUpdate = true;
      this.frame = frame;
    }
    const source = colors === "heat" ? heat : colors === "features" ? features : null;
    const drawn = source === null ? "plain" : colors;
    if (drawn !== this.drawn || (drawn === "heat" && moved)) this.paint(drawn, source, frame);
  }

  paint(drawn, source, frame) {
    const colored = drawn !== "plain";
    if (colored !== this.material.vertexColors) {
      this.material.vertexColors = colored;
      this.material.color.set(colored ? 0xffffff : PLAIN[this.kind]);
      this.material.needsUpdate = true;
    }
    if (colored) {
      const table = drawn === "heat" ? MeshView.heatColors : MeshView.featureColors;
      const start = drawn === "heat" ? this.mesh.vertexCount * frame : 0;
      const array = this.color.array;
      for (let v = 0; v < this.mesh.vertexCount; v += 1) {
        const entry = 3 * source[start + v];
        array[3 * v] = table[entry];
        array[3 * v + 1] = table[entry + 1];
        array[3 * v + 2] = table[entry + 2];
      }
      this.color.needsUpdate = true;
    }
    this.drawn = drawn;
  }

  dispose() {
    this.solid.geometry.dispose();
    this.material.dispose();
    this.lines.material.dispose();
    this.dots.geometry.dispose();
    this.dots.material.dispose();
  }
}

// Round dots, a little nearer than they are, so that the surface they lie on does not hide them.
function dotMaterial() {
  const material = new THREE.PointsMaterial({ color: DOT_COLOR, size: DOT_SIZE, sizeAttenuation: false });
  material.onBeforeCompile = (shader) => {
    const nearer = "#include <project_vertex>\n gl_Position.z -= 2e-4 * gl_Position.w;";
    const round = "#include <clipping_planes_fragment>\n if (length(gl_PointCoord - 0.5) > 0.5) discard;";
    shader.vertexShader = shader.vertexShader.replace("#include <project_vertex>", nearer);
    shader.fragmentShader = shader.fragmentShader.replace("#include <clipping_planes_fragment>", round);
  };
  return material;
}

// 256 linear colours, 8 bits each, for what an 8-bit value stands for.
function colorTable(colorOf) {
  const table = new Uint8Array(3 * 256);
  for (let value = 0; value < 256; value += 1) {
    const color = colorOf(value);
    table.set([color.r, color.g, color.b].map((channel) => Math.round(255 * channel)), 3 * value);
  }
  return table;
}

function mapColor(stops, fraction) {
  const at = fraction * (stops.length - 1);
  const index = Math.min(Math.floor(at), stops.length - 2);
  return stops[index].map((channel, i) => channel + (at - index) * (stops[index + 1][i] - channel));
}

class SceneView {
  constructor(canvas, data) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setScissorTest(true);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(30, 1, 0.1, 10);
    if (data.up === "z") this.camera.up.set(0, 0, 1);
    const head = new THREE.DirectionalLight(0xffffff, 2.1);
    head.position.set(-0.3, 0.5, 1);
    this.camera.add(head, head.target);
    head.target.position.set(0, 0, -1);
    this.scene.add(this.camera, new THREE.HemisphereLight(0xffffff, 0x8a8f98, 1.1));
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.up = data.up;
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

  // Look at a box {low, high} from the front, a little from the side and from above.
  aim(box) {
    this.box = box;
    const low = new THREE.Vector3(...box.low);
    const high = new THREE.Vector3(...box.high);
    const middle = low.clone().add(high).multiplyScalar(0.5);
    const [a, e] = [(30 * Math.PI) / 180, (12 * Math.PI) / 180];
    const [right, above, front] = [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)];
    const toward = this.up === "z" ? new THREE.Vector3(right, -front, above) : new THREE.Vector3(right, above, front);
    const across = new THREE.Vector3().crossVectors(this.camera.up, toward).normalize();
    const upward = new THREE.Vector3().crossVectors(toward, across);
    const pane = this.panes(this.layout || "side")[0];
    const slope = Math.tan((this.camera.fov * Math.PI) / 360) / MARGIN;
    // Near enough that each corner of the box is just inside the picture.
    let distance = 0;
    const radius = Math.max(low.distanceTo(high) / 2, 1e-9);
    for (let corner = 0; corner < 8; corner += 1) {
      const at = new THREE.Vector3(corner & 1 ? low.x : high.x, corner & 2 ? low.y : high.y, corner & 4 ? low.z : high.z).sub(middle);
      const wide = Math.abs(at.dot(across)) / (slope * (pane.width / pane.height));
      const tall = Math.abs(at.dot(upward)) / slope;
      distance = Math.max(distance, at.dot(toward) + Math.max(wide, tall), 0.1 * radius);
    }
    this.camera.position.copy(middle).addScaledVector(toward, distance);
    this.camera.near = distance / 100;
    this.camera.far = distance * 20 + 4 * radius;
    this.controls.target.copy(middle);
    this.controls.update();
  }

  setMeshes(original, level) {
    for (const view of [this.original, this.level]) {
      if (view && view !== original && view !== level) view.dispose();
    }
    this.original = original;
    this.level = level;
  }

  // The parts of the canvas, in CSS pixels from its lower left corner; a tall canvas is cut across.
  panes(layout) {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (layout !== "side") return [{ x: 0, y: 0, width, height }];
    if (width < height) {
      const half = height / 2;
      return [{ x: 0, y: half, width, height: half }, { x: 0, y: 0, width, height: half }];
    }
    return [{ x: 0, y: 0, width: width / 2, height }, { x: width / 2, y: 0, width: width / 2, height }];
  }

  draw({ frame, layout, colors, wire, dots }) {
    this.layout = layout;
    this.renderer.setSize(this.canvas.clientWidth, this.canvas.clientHeight, false);
    for (const view of [this.original, this.level]) if (view) view.show(frame, colors);
    const shown = { side: [[this.original], [this.level]], over: [[this.level, this.original]], original: [[this.original]], level: [[this.level]] }[layout];
    this.panes(layout).forEach((pane, index) => {
      this.renderer.setViewport(pane.x, pane.y, pane.width, pane.height);
      this.renderer.setScissor(pane.x, pane.y, pane.width, pane.height);
      this.camera.aspect = pane.width / pane.height;
      this.camera.updateProjectionMatrix();
      this.scene.children.filter((child) => child.isMesh || child.isPoints).forEach((child) => this.scene.remove(child));
      for (const view of shown[index].filter(Boolean)) {
        // Overlaid, the original is a glass around the simplified mesh.
        const glass = layout === "over" && view === this.original;
        view.material.transparent = glass;
        view.material.opacity = glass ? 0.35 : 1;
        view.material.depthWrite = !glass;
        view.solid.renderOrder = glass ? 1 : 0;
        view.lines.material.color.set(LINES[view.drawn]);
        this.scene.add(view.solid);
        if (wire && !glass) this.scene.add(view.lines);
        if (dots && !glass) this.scene.add(view.dots);
      }
      this.renderer.render(this.scene, this.camera);
    });
  }
}
