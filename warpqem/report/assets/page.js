// The page: what is chosen, what plays, and the tables.

(async () => {
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("data").textContent);
  const frameCount = data.original.frames;
  const state = { frame: 0, level: data.firstLevel || 0, layout: "side", colors: "plain", wire: false, dots: (data.markers || []).length > 0, playing: false, dirty: true };
  // What tests and curious readers look at.
  const seen = { state, ready: false, firstFrame: null, drawn: 0 };
  window.warpqem = seen;
  const marks = [];
  let view = null;
  let levelLoad = 0;

  const figure = (value) => Number(value.toPrecision(4)).toString();
  // What nothing is above is rounded up, as in the commands' tables.
  const upper = (value) => {
    const near = Number(value.toPrecision(4));
    const step = 10 ** (Math.floor(Math.log10(Math.abs(value))) - 3);
    return Number((near < value ? near + step : near).toPrecision(4)).toString();
  };
  const percent = (value) => (value === null || value === undefined ? "–" : `${figure(value)} %`);
  const level = () => data.levels[state.level];

  function element(parent, name, text, className) {
    const node = document.createElement(name);
    if (text !== undefined) node.textContent = text;
    if (className) node.className = className;
    parent.append(node);
    return node;
  }

  function addTable(title, head, rows, wide, bad = () => false) {
    const card = element(byId("tables"), "div", undefined, wide ? "card wide" : "card");
    element(card, "h2", title);
    const table = element(element(card, "div", undefined, "scroll"), "table");
    const isNumber = head.map((_, column) => column > 0 && rows.every((row) => row[column] === null || typeof row[column] === "number"));
    if (head.some((name) => name !== "")) {
      const line = element(element(table, "thead"), "tr");
      head.forEach((name, column) => element(line, "th", name, isNumber[column] ? "number" : ""));
    }
    const body = element(table, "tbody");
    for (const row of rows) {
      const line = element(body, "tr");
      row.forEach((value, column) => {
        const shown = head[column].startsWith("Hausdorff") ? upper : figure;
        const text = value === null ? "" : typeof value === "number" && !Number.isInteger(value) ? shown(value) : String(value);
        const names = [isNumber[column] ? "number" : "", bad(row, column) ? "bad" : ""];
        element(line, "td", text, names.filter(Boolean).join(" "));
      });
    }
  }

  function addTables() {
    const measured = data.levels.filter((one) => one.measures);
    if (measured.length) {
      const names = ["", "faces", "vertices", "verdict", "RMS %", "mean %", "Hausdorff %", "normals °", "flips a frame", "jitter %", "slide %", "slide 95 %", "edges %"];
      const rows = measured.map((one) => {
        const m = one.measures;
        return [one.name, one.faces, one.vertices, m.verdict, m.rms, m.mean, m.hausdorff, m.normals, m.flips, m.jitter, m.slide, m.slideP95, m.edgeLength];
      });
      addTable("Distance from the original", names, [["original", data.original.faces, data.original.vertices, ...Array(names.length - 3).fill(null)], ...rows], true);
      const original = measured[0].measures.originalTopology;
      const figures = [
        ["connected components", "components"], ["Euler number", "euler_number"], ["border edges", "border_edges"],
        ["non-manifold edges", "non_manifold_edges"], ["non-manifold vertices", "non_manifold_vertices"],
        ["repeated faces", "repeated_faces"], ["collapsed faces", "collapsed_faces"],
      ].map(([name, key]) => [name, original[key], ...measured.map((one) => one.measures.topology[key])]);
      for (const [name, key] of [["flipped faces, worst frame", "flips"], ["faces without area, worst frame", "degenerate_faces"]]) {
        figures.push([name, null, ...measured.map((one) => Math.max(...one.measures.perFrame[key]))]);
      }
      // More than the original has of what a mesh should have none of.
      const faults = ["non-manifold edges", "non-manifold vertices", "repeated faces", "collapsed faces"];
      const bad = (row, column) => column > 1 && faults.includes(row[0]) && row[column] > row[1];
      addTable("Validity", ["", "original", ...measured.map((one) => one.name)], figures, measured.length > 4, bad);
    }
    for (const table of data.tables) addTable(table.title, table.head, table.rows, table.head.length > 3);
  }

  function addPlots() {
    const measured = data.levels.filter((one) => one.measures);
    const parent = byId("plots");
    if (data.curve) {
      const series = [{ name: "largest RMS over key frames", x: data.curve.faces, y: data.curve.error }];
      const move = plotCard(parent, { title: "Error over levels", unit: "% of the diagonal", xName: "faces", logX: true, series, pick: setLevel });
      marks.push(() => move(level().faces));
    }
    if (!measured.length) return;
    const several = measured.length > 1;
    if (frameCount > 1) {
      for (const [key, title] of [["rms", "RMS distance"], ["hausdorff", "Largest distance"]]) {
        const series = measured.map((one) => ({ name: several ? `${one.name}, ${one.faces} faces` : one.name, x: data.times, y: one.measures.perFrame[key] }));
        const move = plotCard(parent, { title, unit: "% of the diagonal", xName: "time", series, pick: setFrame });
        marks.push(() => move(data.times[state.frame]));
      }
    }
    if (several) {
      const x = measured.map((one) => one.faces);
      const move = plotCard(parent, {
        title: "Error over levels", unit: "% of the diagonal", xName: "faces", logX: true, dots: true,
        series: [["RMS", "rms"], ["mean", "mean"]].map(([name, key]) => ({ name, x, y: measured.map((one) => one.measures[key]) })),
        pick: (index) => setLevel(data.levels.indexOf(measured[index])),
      });
      marks.push(() => level().measures && move(level().faces));
    }
  }

  function tell(text) {
    byId("message").textContent = text;
    byId("message").hidden = false;
    byId("canvas").style.visibility = "hidden";
  }

  function refresh() {
    state.dirty = true;
    byId("scrub").value = state.frame;
    byId("time").textContent = frameCount > 1 ? `${data.times[state.frame]} (${state.frame + 1}/${frameCount})` : "one pose";
    for (const [id, value] of [["layout", state.layout], ["color", state.colors]]) {
      for (const button of byId(id).children) {
        button.setAttribute("role", "radio");
        button.setAttribute("aria-checked", String(button.dataset.value === value));
      }
    }
    byId("wire").setAttribute("aria-pressed", String(state.wire));
    byId("dots").setAttribute("aria-pressed", String(state.dots));
    byId("play").textContent = state.playing ? "❚❚" : "▶";
    byId("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
    const one = level();
    byId("level").value = state.level;
    byId("level-name").textContent = one ? `${one.name}, ${one.faces} faces` : "";
    const heat = state.colors === "heat" && view && view.level && state.layout !== "original";
    byId("legend").hidden = !heat;
    if (heat) byId("legend-max").textContent = `${upper(view.level.mesh.heatScale)} % of the diagonal`;
    marks.forEach((mark) => mark());
    placeTags();
  }

  function placeTags() {
    const [left, right] = [byId("tag-left"), byId("tag-right")];
    const original = `original, ${data.original.faces} faces`;
    const simplified = level() ? `${level().name}, ${level().faces} faces` : "";
    const texts = { side: [original, simplified], over: [`${simplified}, in the original`, ""], original: [original, ""], level: [simplified, ""] }[state.layout];
    const stage = byId("stage");
    const across = state.layout === "side" && stage.clientWidth < stage.clientHeight;
    [left.textContent, right.textContent] = texts;
    right.hidden = texts[1] === "";
    left.style.cssText = "left:10px;top:10px";
    right.style.cssText = across ? "left:10px;top:calc(50% + 10px)" : "left:calc(50% + 10px);top:10px";
  }

  function setFrame(frame) {
    state.frame = ((frame % frameCount) + frameCount) % frameCount;
    refresh();
  }

  async function setLevel(index) {
    state.level = Math.max(0, Math.min(data.levels.length - 1, index));
    const wanted = (levelLoad += 1);
    const chosen = level();
    byId("level").value = state.level;
    if (chosen && !chosen.decoded) {
      if (!chosen.mesh && chosen.url) {
        byId("level-name").textContent = `${chosen.name}, ${chosen.faces} faces …`;
        Object.assign(chosen, await (await fetch(chosen.url)).json());
      }
      if (chosen.mesh) chosen.decoded = await decodeMesh(chosen.mesh, frameCount);
    }
    // A later choice may have come first.
    if (wanted !== levelLoad || !view) return;
    // One that is too large for the page has no mesh.
    view.setMeshes(view.original, chosen && chosen.decoded ? new MeshView(chosen.decoded, data.grid, "level", chosen.markers) : null);
    refresh();
  }

  function choose(key, value) {
    state[key] = value;
    refresh();
  }

  function connect() {
    for (const [id, key] of [["layout", "layout"], ["color", "colors"]]) {
      for (const button of byId(id).children) button.addEventListener("click", () => choose(key, button.dataset.value));
    }
    byId("wire").addEventListener("click", () => choose("wire", !state.wire));
    byId("dots").addEventListener("click", () => choose("dots", !state.dots));
    byId("play").addEventListener("click", () => choose("playing", !state.playing));
    byId("scrub").addEventListener("input", (event) => {
      state.playing = false;
      setFrame(Number(event.target.value));
    });
    byId("level").addEventListener("input", (event) => setLevel(Number(event.target.value)));
    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
      const layouts = { 1: "side", 2: "over", 3: "original", 4: "level" };
      const actions = {
        " ": () => choose("playing", !state.playing && frameCount > 1),
        ArrowLeft: () => { state.playing = false; setFrame(state.frame - 1); },
        ArrowRight: () => { state.playing = false; setFrame(state.frame + 1); },
        ArrowUp: () => data.levels.length > 1 && setLevel(state.level - 1),
        ArrowDown: () => data.levels.length > 1 && setLevel(state.level + 1),
        w: () => choose("wire", !state.wire),
        p: () => choose("colors", "plain"),
        h: () => canColor("heat") && choose("colors", state.colors === "heat" ? "plain" : "heat"),
        j: () => canColor("features") && choose("colors", state.colors === "features" ? "plain" : "features"),
        r: () => { if (view) view.aim(view.box); refresh(); },
      };
      const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
      if (layouts[name]) choose("layout", layouts[name]);
      else if (actions[name]) actions[name]();
      else return;
      event.preventDefault();
    });
    window.addEventListener("resize", refresh);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", refresh);
  }

  const canColor = (name) => !byId("color").querySelector(`[data-value=${name}]`).disabled;

  function limitChoices() {
    byId("scrub").max = frameCount - 1;
    byId("transport").hidden = frameCount < 2;
    byId("transport").style.display = frameCount < 2 ? "none" : "";
    byId("level").max = Math.max(0, data.levels.length - 1);
    byId("level-choice").style.display = data.levels.length > 1 ? "" : "none";
    const off = (id, value) => { byId(id).querySelector(`[data-value=${value}]`).disabled = true; };
    if (!data.original.mesh) ["side", "over", "original"].forEach((value) => off("layout", value));
    if (!data.levels.length) ["side", "over", "level"].forEach((value) => off("layout", value));
    state.layout = !data.levels.length ? "original" : data.original.mesh ? "side" : "level";
    const any = (key) => [data.original, ...data.levels].some((one) => (one.mesh && one.mesh[key]) || (one.has && one.has[key]));
    byId("dots").hidden = !state.dots;
    byId("dots").textContent = `${data.markers.length} points`;
    byId("dots").title = data.markers.join(", ");
    if (!any("heat")) off("color", "heat");
    if (!any("features")) off("color", "features");
    const bar = byId("legend-bar");
    const context = bar.getContext("2d");
    for (let x = 0; x < bar.width; x += 1) {
      context.fillStyle = `rgb(${mapColor(data.colorMap, x / (bar.width - 1)).map((c) => Math.round(255 * c))})`;
      context.fillRect(x, 0, 1, 1);
    }
  }

  function addFacts() {
    const parts = [`${data.original.faces} faces`];
    if (data.curve) parts[0] = `${data.levels.at(-1).faces} to ${data.original.faces} faces`;
    else if (data.levels.length) parts[0] = `${data.original.faces} → ${data.levels.map((one) => one.faces).join(", ")} faces`;
    parts.push(frameCount > 1 ? `${frameCount} frames` : "one pose");
    if (data.levels.length === 1 && level().measures) parts.push(`RMS ${percent(level().measures.rms)} of the diagonal`);
    byId("facts").textContent = parts.join(" · ");
    let place = byId("notes");
    if (data.notes.length > 4) {
      place = element(place, "details");
      element(place, "summary", `${data.notes.length} notes`);
    }
    for (const note of data.notes) element(place, "p", note);
  }

  function boxOf(mesh) {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i < mesh.nodes.length; i += 1) {
      const value = data.grid.low[i % 3] + data.grid.step * mesh.nodes[i];
      if (value < low[i % 3]) low[i % 3] = value;
      if (value > high[i % 3]) high[i % 3] = value;
    }
    return { low, high };
  }

  async function start() {
    limitChoices();
    addFacts();
    addPlots();
    addTables();
    connect();
    refresh();
    try {
      view = new SceneView(byId("canvas"), data);
    } catch (error) {
      tell("This browser shows no WebGL, so the meshes cannot be drawn; plots and tables are below.");
      return;
    }
    view.layout = state.layout;
    const original = data.original.mesh ? await decodeMesh(data.original.mesh, frameCount) : null;
    view.setMeshes(original ? new MeshView(original, data.grid, "original", data.original.markers) : null, null);
    await setLevel(state.level);
    const first = original || (view.level && view.level.mesh);
    if (!first) {
      tell("The meshes are too large for this page; plots and tables are below.");
      view = null;
      return;
    }
    view.aim(boxOf(first));
    view.controls.addEventListener("change", () => { state.dirty = true; });
    refresh();
    let last = null;
    let elapsed = 0;
    const tick = (now) => {
      if (state.playing && last !== null) {
        elapsed += (now - last) * 0.001 * data.framesPerSecond * Number(byId("speed").value);
        const steps = Math.floor(elapsed);
        elapsed -= steps;
        if (steps) setFrame(state.frame + steps);
      }
      last = state.playing ? now : null;
      if (state.dirty) {
        state.dirty = false;
        view.draw(state);
        seen.drawn += 1;
        if (!seen.ready) {
          seen.firstFrame = performance.now();
          seen.ready = true;
          state.playing = frameCount > 1 && !matchMedia("(prefers-reduced-motion: reduce)").matches;
          refresh();
        }
      }
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  await start();
})();
