// The meshes in three.js: one camera for both panes, so that they turn together.

// Part of the picture that is left free around what it is aimed at, as a factor.
const MARGIN = 1.12;
// Points that a view is fitted to, and frames that they are of.
const FIT_POINTS = 6000;
const FIT_FRAMES = 12;
// One notch of a wheel (100 pixels) takes the camera nearer by this factor; the size is what browsers use for a step.
const ZOOM_STEP = 0.85;
const NOTCH = 100;
// A double click takes the camera so much nearer.
const FOCUS_STEP = 0.5;

// Strength of the light from all sides and of that from the viewer's shoulder; colours that stand for numbers are to be
// read in the shade, too.
const FILL_LIGHT = 0.7;
const LIGHTS = { look: [0.95, 2.2], plain: [0.95, 2.2], heat: [2, 1.1], features: [1.6, 1.5] };

class SceneView {
  constructor(canvas, data) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    // Part of the screen's pixels along each side that are drawn.
    this.detail = 1;
    this.renderer.setScissorTest(true);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(30, 1, 0.1, 10);
    this.up = data.up;
    if (data.up === "z") this.camera.up.set(0, 0, 1);
    // A bright light from over the viewer's left shoulder, a weak one from the right that lifts the dark side.
    this.lamps = [[-0.5, 0.65, 0.9], [0.9, 0.1, 0.3]].map((place) => {
      const light = new THREE.DirectionalLight(0xffffff, FILL_LIGHT);
      light.position.set(...place);
      this.camera.add(light, light.target);
      light.target.position.set(0, 0, -1);
      return light;
    });
    this.sky = new THREE.HemisphereLight(0xffffff, 0x7f7a74);
    this.sky.position.copy(this.camera.up);
    this.scene.add(this.camera, this.sky);
    // Before those of the controls, which would zoom to the middle of the canvas.
    canvas.addEventListener("wheel", (event) => this.zoomToCursor(event), { capture: true, passive: false });
    canvas.addEventListener("dblclick", (event) => this.focus(event));
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.addEventListener("start", () => { this.moved = true; });
    this.moved = false;
    this.insets = { top: 0, bottom: 0 };
    this.layout = "side";
    this.skeletons = [];
    this.levelJoints = null;
    this.changed = () => {};
    this.controls.addEventListener("change", () => this.changed());
    setColorTables(data);
  }

  // Textures of the data, when their images are there.
  static textures(entries) {
    return Promise.all(entries.map(async ({ address, repeats }) => {
      const image = new Image();
      image.src = address;
      await image.decode();
      const texture = new THREE.Texture(image);
      const wrap = (repeat) => (repeat ? THREE.RepeatWrapping : THREE.ClampToEdgeWrapping);
      [texture.wrapS, texture.wrapT] = repeats.map(wrap);
      texture.colorSpace = THREE.SRGBColorSpace;
      texture.anisotropy = 4;
      texture.needsUpdate = true;
      return texture;
    }));
  }

  get views() {
    return [this.original, this.level].filter(Boolean);
  }

  // Look at the meshes from the front, a little from the side and from above, so that all frames fit in.
  aim(frameCount) {
    const [a, e] = [(35 * Math.PI) / 180, (12 * Math.PI) / 180];
    const [right, above, front] = [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)];
    const toward = this.up === "z" ? new THREE.Vector3(right, -front, above) : new THREE.Vector3(right, above, front);
    const stride = Math.max(1, Math.floor(frameCount / FIT_FRAMES));
    const frames = Array.from({ length: Math.ceil(frameCount / stride) }, (_, i) => i * stride);
    this.fit(frames, toward);
    this.moved = false;
  }

  // Come as near as the meshes in these frames allow, without turning unless a direction is given.
  fit(frames, toward = this.camera.position.clone().sub(this.controls.target)) {
    const view = this.layout === "level" ? this.level || this.original : this.original || this.level;
    if (!view) return;
    const points = view.samples(frames, FIT_POINTS);
    if (!points.length) return;
    toward.normalize();
    const across = new THREE.Vector3().crossVectors(this.camera.up, toward).normalize();
    const upward = new THREE.Vector3().crossVectors(toward, across);
    const pane = this.panes(this.layout)[0];
    const height = Math.max(pane.height, 1);
    const slope = Math.tan((this.camera.fov * Math.PI) / 360) / MARGIN;
    const wide = slope * (pane.width / height);
    // Labels and buttons at the borders cover nothing.
    const { top, bottom } = this.insets;
    const free = (inset) => slope * Math.max(0.2, 1 - (2 * inset) / height);
    const axes = [across, upward, toward];
    const place = axes.map((axis) => {
      const found = new Float64Array(points.length / 3);
      for (let i = 0; i < found.length; i += 1) found[i] = axis.x * points[3 * i] + axis.y * points[3 * i + 1] + axis.z * points[3 * i + 2];
      return found;
    });
    const span = place.map((values) => values.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]));
    // Lines of sight at the two borders that touch the points: where they cross is the nearest place of the camera.
    const cross = (values, low, high) => {
      let [below, above] = [-Infinity, -Infinity];
      for (let i = 0; i < values.length; i += 1) {
        below = Math.max(below, low * place[2][i] - values[i]);
        above = Math.max(above, high * place[2][i] + values[i]);
      }
      // Further back there is room on both sides, half of it on each.
      return { depth: (below + above) / (low + high), at: (depth) => (above - high * depth + low * depth - below) / 2 };
    };
    const [level, upright] = [cross(place[0], wide, wide), cross(place[1], free(bottom), free(top))];
    const radius = Math.max(...span.map(([low, high]) => (high - low) / 2), 1e-9);
    const middle = (span[2][0] + span[2][1]) / 2;
    const depth = Math.max(level.depth, upright.depth, span[2][1] + 0.05 * radius);
    this.radius = Math.max(this.radius || 0, radius);
    const target = new THREE.Vector3().addScaledVector(across, level.at(depth)).addScaledVector(upward, upright.at(depth)).addScaledVector(toward, middle);
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(toward, depth - middle);
    this.controls.update();
    this.changed();
  }

  // The ray under a place of the window.
  rayAt(clientX, clientY) {
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [clientX - box.left, box.bottom - clientY];
    const panes = this.panes(this.layout);
    const inside = (pane) => x >= pane.x && x < pane.x + pane.width && y >= pane.y && y < pane.y + pane.height;
    const index = Math.max(0, panes.findIndex(inside));
    const pane = panes[index];
    this.camera.aspect = pane.width / pane.height;
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    const through = new THREE.Vector3((2 * (x - pane.x)) / pane.width - 1, (2 * (y - pane.y)) / pane.height - 1, 0.5).unproject(this.camera);
    const origin = this.camera.position.clone();
    return { origin, direction: through.sub(origin).normalize(), views: this.shownIn(index) };
  }

  // The point of a mesh there; null where there is none.
  pointAt(clientX, clientY) {
    const { origin, direction, views } = this.rayAt(clientX, clientY);
    const distance = Math.min(...views.map((view) => view.hit(origin, direction)), Infinity);
    return distance < Infinity ? origin.addScaledVector(direction, distance) : null;
  }

  // The point there, or where the ray crosses the plane through the target.
  anchorAt(clientX, clientY) {
    const found = this.pointAt(clientX, clientY);
    if (found) return found;
    const { origin, direction } = this.rayAt(clientX, clientY);
    const forward = this.controls.target.clone().sub(origin);
    const distance = forward.lengthSq() / Math.max(forward.dot(direction), 1e-12);
    return origin.addScaledVector(direction, distance);
  }

  scaleAbout(anchor, factor) {
    for (const point of [this.camera.position, this.controls.target]) point.sub(anchor).multiplyScalar(factor).add(anchor);
    this.moved = true;
    this.controls.update();
    this.changed();
  }

  zoomToCursor(event) {
    event.preventDefault();
    event.stopImmediatePropagation();
    const pixels = event.deltaY * (event.deltaMode === 1 ? 16 : 1);
    this.scaleAbout(this.anchorAt(event.clientX, event.clientY), ZOOM_STEP ** (-pixels / NOTCH));
  }

  zoom(factor) {
    this.scaleAbout(this.controls.target.clone(), factor);
  }

  // Turn about the point under the cursor from now on, and come nearer.
  focus(event) {
    const point = this.pointAt(event.clientX, event.clientY);
    if (!point) return;
    const away = this.camera.position.clone().sub(this.controls.target).multiplyScalar(FOCUS_STEP);
    this.controls.target.copy(point);
    this.camera.position.copy(point).add(away);
    this.moved = true;
    this.controls.update();
    this.changed();
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

  // What is drawn in a pane.
  shownIn(index) {
    const shown = { side: [[this.original], [this.level]], over: [[this.level, this.original]], original: [[this.original]], level: [[this.level]] };
    return shown[this.layout][index].filter(Boolean);
  }

  draw({ frame, layout, colors, shading, wire, dots, bones }, heatEnd) {
    this.layout = layout;
    this.resize();
    [this.sky.intensity, this.lamps[0].intensity] = LIGHTS[colors];
    for (const view of this.views) view.show(frame, colors, shading, heatEnd);
    // Near and far follow the camera, so that neither cuts anything off and depths stay fine.
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.camera.near = Math.max(distance / 200, 1e-6);
    this.camera.far = distance + 8 * this.radius;
    const pixels = this.canvas.clientHeight / (2 * Math.tan((this.camera.fov * Math.PI) / 360) * distance);
    this.panes(layout).forEach((pane, index) => {
      this.renderer.setViewport(pane.x, pane.y, pane.width, pane.height);
      this.renderer.setScissor(pane.x, pane.y, pane.width, pane.height);
      this.camera.aspect = pane.width / pane.height;
      this.camera.updateProjectionMatrix();
      this.scene.children.filter((child) => child.isMesh || child.isPoints || child.isLineSegments).forEach((child) => this.scene.remove(child));
      for (const view of this.shownIn(index)) {
        // Overlaid, the original is a glass around the simplified mesh.
        const glass = layout === "over" && view === this.original;
        for (const material of view.materials) {
          material.transparent = glass;
          material.opacity = glass ? 0.35 : 1;
          material.depthWrite = !glass;
        }
        view.solid.renderOrder = glass ? 1 : 0;
        const line = view.lines.material[0];
        line.color.set(LINES[view.drawn]);
        line.opacity = LINE_OPACITY[view.drawn] * Math.min(1, (view.edgeLength * pixels) / LINE_LENGTH);
        this.scene.add(view.solid);
        if (wire && !glass) this.scene.add(view.lines);
        if (dots && !glass) this.scene.add(view.dots);
      }
      if (bones) {
        const ofLevel = this.shownIn(index)[0] === this.level && this.levelJoints;
        this.skeletons.forEach((skeleton, i) => this.scene.add(...skeleton.show(frame, ofLevel ? ofLevel[i] : null)));
      }
      this.renderer.render(this.scene, this.camera);
    });
  }

  // Buffers are as large as the canvas; making them anew takes longer than to draw.
  resize() {
    const wanted = [this.canvas.clientWidth, this.canvas.clientHeight, this.detail * Math.min(window.devicePixelRatio, 2)];
    if (String(wanted) === this.size) return;
    this.size = String(wanted);
    this.renderer.setPixelRatio(wanted[2]);
    this.renderer.setSize(wanted[0], wanted[1], false);
  }

  // Numbers from which `look` finds the same view again.
  get pose() {
    return [...this.camera.position.toArray(), ...this.controls.target.toArray()];
  }

  look(pose) {
    this.camera.position.fromArray(pose);
    this.controls.target.fromArray(pose, 3);
    this.moved = true;
    this.controls.update();
  }
}
