// The page: what is chosen and what plays.

// In pixels.
const TAG_ROOM = 34;
const BUTTON_ROOM = 64;
// Milliseconds from one picture to the next that are too many while it plays, so many times in a row, and what part of
// the pixels along each side is left then.
const SLOW = 45;
const SLOW_FRAMES = 6;
const DETAIL_STEP = 0.75;
const LEAST_DETAIL = 0.5;

(async () => {
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("data").textContent);
  const frameCount = data.original.frames;
  const coarsest = data.levels.length - 1;
  const state = {
    frame: 0, level: data.firstLevel || 0, layout: "side", colors: "plain", shading: "smooth", wire: false, bones: false,
    dots: (data.markers || []).length > 0, hidden: new Set(), chosen: null, playing: false, dirty: true,
  };
  // What tests and curious readers look at.
  const seen = { state, ready: false, firstFrame: null, drawn: 0 };
  window.warpqem = seen;
  const marks = [];
  let view = null;
  let textures = [];
  let levelLoad = 0;
  let showMeshes = () => {};

  const percent = (value, show = figure) => (value === null || value === undefined ? "–" : `${show(value)} %`);
  const level = () => data.levels[state.level];
  const tell = (text) => { byId("told").textContent = text; };

  function addPlots() {
    const measured = data.levels.filter((one) => one.measures);
    const parent = byId("plots");
    if (data.curve) {
      const series = [{ name: "largest RMS over key frames", x: data.curve.faces, y: data.curve.error }];
      const move = plotCard(parent, { title: "Error over levels", unit: "% of the diagonal", xName: "faces", logX: true, series, pick: setLevel });
      marks.push(() => move(level().faces));
    }
    if (measured.length) addErrorPlots(parent, measured);
    for (const curve of data.curves || []) plotCard(parent, { ...curve, dots: true });
  }

  function addErrorPlots(parent, measured) {
    const several = measured.length > 1;
    if (frameCount > 1) {
      for (const [key, title] of [["rms", "RMS distance"], ["hausdorff", "Largest distance"]]) {
        const series = measured.map((one) => ({ name: several ? `${one.name}, ${grouped(one.faces)} faces` : one.name, x: data.times, y: one.measures.perFrame[key] }));
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

  function showNoPicture(text) {
    byId("message").textContent = text;
    byId("message").hidden = false;
    byId("canvas").style.visibility = "hidden";
    byId("corner").hidden = true;
  }

  function refresh() {
    state.dirty = true;
    byId("scrub").value = state.frame;
    byId("scrub").setAttribute("aria-valuetext", `frame ${state.frame + 1} of ${frameCount}`);
    byId("time").textContent = frameCount > 1 ? `${data.times[state.frame]} (${state.frame + 1}/${frameCount})` : "one pose";
    for (const [id, value] of [["layout", state.layout], ["color", state.colors], ["shading", state.shading]]) markChoice(byId(id), value);
    for (const key of ["wire", "dots", "bones"]) byId(key).setAttribute("aria-pressed", String(state[key]));
    const label = state.playing ? "Pause" : "Play";
    if (byId("play").getAttribute("aria-label") !== label || !byId("play").firstElementChild) {
      // Drawn: not every font has these signs.
      const shape = state.playing ? "M3 2h4v12H3zM9 2h4v12H9z" : "M3 1.5l11 6.5-11 6.5z";
      byId("play").innerHTML = `<svg viewBox="0 0 16 16" width="16" height="16" aria-hidden="true"><path fill="currentColor" d="${shape}"/></svg>`;
      byId("play").setAttribute("aria-label", label);
    }
    const one = level();
    byId("level").value = coarsest - state.level;
    byId("level-name").textContent = one ? `${one.name}, ${grouped(one.faces)} faces` : "";
    byId("level").setAttribute("aria-valuetext", byId("level-name").textContent);
    byId("legend").hidden = !heatShown();
    byId("worst").hidden = frameCount < 2 || !view || !view.level || view.level.mesh.heat === null;
    marks.forEach((mark) => mark());
    showMeshes(state);
    placeTags();
  }

  const heatShown = () => state.colors === "heat" && view && view.level && state.layout !== "original";

  // Radio buttons: one is in the order of the tab key, arrows go on to the others.
  function markChoice(group, value) {
    const buttons = [...group.children];
    const chosen = buttons.find((button) => button.dataset.value === value) || buttons[0];
    for (const button of buttons) {
      button.setAttribute("role", "radio");
      button.setAttribute("aria-checked", String(button.dataset.value === value));
      button.tabIndex = button === chosen ? 0 : -1;
    }
  }

  const captions = () => {
    const original = `original, ${grouped(data.original.faces)} faces`;
    const simplified = level() ? `${level().name}, ${grouped(level().faces)} faces` : "";
    return { side: [original, simplified], over: [`${simplified}, in the original`], original: [original], level: [simplified] }[state.layout];
  };

  function placeTags() {
    const [left, right] = [byId("tag-left"), byId("tag-right")];
    const texts = captions();
    const stage = byId("stage");
    const across = state.layout === "side" && stage.clientWidth < stage.clientHeight;
    [left.textContent, right.textContent] = [texts[0], texts[1] || ""];
    right.hidden = texts.length < 2;
    stage.classList.toggle("two", texts.length > 1);
    stage.classList.toggle("stacked", across);
  }

  // What is left free for the labels above and the buttons below, if those are in the picture.
  function setInsets() {
    if (!view) return;
    const inside = getComputedStyle(byId("corner")).position === "absolute";
    view.insets = { top: TAG_ROOM, bottom: inside ? BUTTON_ROOM : 0 };
  }

  function setFrame(frame) {
    state.frame = ((frame % frameCount) + frameCount) % frameCount;
    refresh();
  }

  async function setLevel(index) {
    state.level = Math.max(0, Math.min(coarsest, index));
    const wanted = (levelLoad += 1);
    const chosen = level();
    byId("level").value = coarsest - state.level;
    if (chosen && !chosen.decoded) {
      if (!chosen.mesh && chosen.url) {
        byId("level-name").textContent = `${chosen.name}, ${grouped(chosen.faces)} faces …`;
        Object.assign(chosen, await (await fetch(chosen.url)).json());
      }
      if (chosen.mesh) chosen.decoded = await decodeMesh(chosen.mesh, frameCount);
    }
    // A later choice may have come first.
    if (wanted !== levelLoad || !view) return;
    // One that is too large for the page has no mesh.
    view.setMeshes(view.original, chosen && chosen.decoded ? new MeshView(chosen.decoded, data.grid, "level", chosen.markers, textures) : null);
    view.views.forEach((one) => one.hide(state.hidden));
    refresh();
  }

  function choose(key, value) {
    state[key] = value;
    if (key === "layout" && view) {
      view.layout = value;
      if (!view.moved) view.aim(frameCount);
    }
    refresh();
  }

  function hide(names, chosen) {
    state.hidden = names;
    state.chosen = chosen;
    if (view) view.views.forEach((one) => one.hide(names));
    refresh();
  }

  const meshActions = {
    toggle: (name) => {
      const hidden = new Set(state.hidden);
      if (!hidden.delete(name)) hidden.add(name);
      hide(hidden, null);
    },
    // Alone and close; once more for all of them again.
    only: (name) => {
      const again = state.chosen === name;
      hide(new Set(again ? [] : meshNames(data).filter((other) => other !== name)), again ? null : name);
      if (!view) return;
      if (again) view.aim(frameCount);
      else view.fit([state.frame]);
    },
    all: () => {
      hide(new Set(), null);
      if (view) view.aim(frameCount);
    },
  };

  function toggleBones() {
    choose("bones", !state.bones);
    tell(state.bones ? "Blue joints move the mesh, red ones moved the original alone, grey ones move nothing." : "");
  }

  function goToWorst() {
    const found = view && view.level ? view.level.worstFrame : null;
    if (found === null) return;
    state.playing = false;
    setFrame(found);
    tell(`Frame ${found + 1}: a vertex is farther from the original than in any other.`);
  }

  // Draws at once: the picture of WebGL is gone when the browser has shown it.
  async function savePicture() {
    drawNow();
    const legend = heatShown() ? { bar: byId("legend-bar"), ticks: legendTicks(), title: byId("legend-title").textContent } : null;
    const blob = await pictureOf(byId("canvas"), captions(), legend);
    download(blob, `${document.title.replace(/[^\w.-]+/g, "_")}_${state.frame + 1}.png`);
    tell("The picture is saved.");
  }

  async function copyLink() {
    history.replaceState(null, "", `#${stateToHash(state, data, view && view.moved ? view.pose : null)}`);
    try {
      await navigator.clipboard.writeText(location.href);
      tell("The link to this view is copied.");
    } catch {
      tell("The address of this page now leads to this view.");
    }
  }

  function connect() {
    for (const [id, key] of [["layout", "layout"], ["color", "colors"], ["shading", "shading"]]) {
      for (const button of byId(id).children) button.addEventListener("click", () => choose(key, button.dataset.value));
      byId(id).addEventListener("keydown", (event) => stepChoice(event, byId(id), key));
    }
    for (const key of ["wire", "dots"]) byId(key).addEventListener("click", () => choose(key, !state[key]));
    byId("bones").addEventListener("click", toggleBones);
    byId("play").addEventListener("click", () => choose("playing", !state.playing));
    byId("scrub").addEventListener("input", (event) => {
      state.playing = false;
      setFrame(Number(event.target.value));
    });
    byId("level").addEventListener("input", (event) => setLevel(coarsest - Number(event.target.value)));
    byId("fit").addEventListener("click", () => view && view.fit([state.frame]));
    byId("reset").addEventListener("click", () => view && view.aim(frameCount));
    byId("worst").addEventListener("click", goToWorst);
    byId("picture").addEventListener("click", savePicture);
    byId("link").addEventListener("click", copyLink);
    document.addEventListener("keydown", useKey);
    new ResizeObserver(() => {
      setInsets();
      if (view && !view.moved) view.aim(frameCount);
      refresh();
    }).observe(byId("stage"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", refresh);
    window.addEventListener("hashchange", () => applyHash());
  }

  function stepChoice(event, group, key) {
    const steps = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };
    if (!(event.key in steps)) return;
    const buttons = [...group.children].filter((button) => !button.disabled);
    const at = buttons.findIndex((button) => button.dataset.value === state[key]);
    const next = buttons[(at + steps[event.key] + buttons.length) % buttons.length];
    choose(key, next.dataset.value);
    next.focus();
    event.preventDefault();
    event.stopPropagation();
  }

  // What a focused control does with a key goes before what the page does.
  function takesKey(target, name) {
    const kind = target.tagName;
    if (kind === "SELECT" || kind === "TEXTAREA" || (kind === "INPUT" && !["range", "checkbox"].includes(target.type))) return true;
    if (name === " " || name === "Enter") return ["BUTTON", "INPUT", "SUMMARY", "A"].includes(kind);
    const moves = /^(Arrow|Page|Home|End)/.test(name);
    return moves && ((kind === "INPUT" && target.type === "range") || target.classList.contains("scroll"));
  }

  function useKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (takesKey(event.target, name)) return;
    const toggle = (value) => canColor(value) && choose("colors", state.colors === value ? baseColors() : value);
    const layouts = { 1: "side", 2: "over", 3: "original", 4: "level" };
    const actions = {
      " ": () => choose("playing", !state.playing && frameCount > 1),
      ArrowLeft: () => { state.playing = false; setFrame(state.frame - 1); },
      ArrowRight: () => { state.playing = false; setFrame(state.frame + 1); },
      ArrowUp: () => data.levels.length > 1 && setLevel(state.level - 1),
      ArrowDown: () => data.levels.length > 1 && setLevel(state.level + 1),
      w: () => choose("wire", !state.wire),
      l: () => canColor("look") && choose("colors", "look"),
      p: () => choose("colors", "plain"),
      h: () => toggle("heat"),
      j: () => toggle("features"),
      s: () => choose("shading", state.shading === "flat" ? "smooth" : "flat"),
      b: () => !byId("bones").hidden && toggleBones(),
      x: goToWorst,
      f: () => view && view.fit([state.frame]),
      r: () => view && view.aim(frameCount),
      "+": () => view && view.zoom(ZOOM_STEP),
      "-": () => view && view.zoom(1 / ZOOM_STEP),
    };
    if (layouts[name]) {
      if (!byId("layout").querySelector(`[data-value=${layouts[name]}]`).disabled) choose("layout", layouts[name]);
    } else if (actions[name]) actions[name]();
    else return;
    event.preventDefault();
  }

  const canColor = (name) => !byId("color").querySelector(`[data-value=${name}]`).disabled;
  const baseColors = () => (canColor("look") ? "look" : "plain");

  function limitChoices() {
    byId("scrub").max = frameCount - 1;
    byId("transport").style.display = frameCount < 2 ? "none" : "";
    byId("level").max = Math.max(0, coarsest);
    byId("level-row").style.display = data.levels.length > 1 ? "" : "none";
    const off = (id, value) => { byId(id).querySelector(`[data-value=${value}]`).disabled = true; };
    if (!data.original.mesh) ["side", "over", "original"].forEach((value) => off("layout", value));
    if (!data.levels.length) ["side", "over", "level"].forEach((value) => off("layout", value));
    state.layout = !data.levels.length ? "original" : data.original.mesh ? "side" : "level";
    const meshes = [data.original, ...data.levels];
    const any = (key) => meshes.some((one) => (one.mesh && one.mesh[key]) || (one.has && one.has[key]));
    const looks = meshes.some((one) => one.mesh && (one.mesh.colors || one.mesh.parts.some((part) => part.texture !== null)));
    byId("dots").hidden = !state.dots;
    byId("dots").textContent = `${data.markers.length} points`;
    byId("dots").title = data.markers.join(", ");
    if (!looks) off("color", "look");
    if (!any("heat")) off("color", "heat");
    if (!any("features")) off("color", "features");
    state.colors = baseColors();
    drawLegend();
  }

  // Where the marks of the one scale of all levels are, as shares of it.
  function legendTicks() {
    const end = data.heatEnd || 0;
    if (!end) return [{ at: 0, text: "0" }];
    // A part of the end that is a number of one digit, see SCALE_ENDS of data.py.
    const steps = [4, 5, 3].map((parts) => ({ parts, step: Number((end / parts).toPrecision(1)) }));
    const exact = steps.filter(({ parts, step }) => Math.abs(step * parts - end) < 1e-6 * end);
    // One of 1, 2 or 5 is read most easily.
    const count = (exact.find(({ step }) => /^0*[125]0*$/.test(String(step).replace(".", ""))) || exact[0] || steps[0]).parts;
    const text = (value) => Number(value.toPrecision(3)).toString();
    return Array.from({ length: count + 1 }, (_, i) => ({ at: i / count, text: (i === count ? "≥ " : "") + text((end * i) / count) }));
  }

  function drawLegend() {
    const bar = byId("legend-bar");
    const context = bar.getContext("2d");
    for (let x = 0; x < bar.width; x += 1) {
      context.fillStyle = `rgb(${mapColor(data.colorMap, x / (bar.width - 1)).map((c) => Math.round(255 * c))})`;
      context.fillRect(x, 0, 1, 1);
    }
    byId("legend-title").textContent = "Distance, % of the diagonal";
    byId("legend-title").title = "One scale for all levels. It ends above 99 in 100 vertices of all frames of the worst level.";
    for (const { at, text } of legendTicks()) {
      const tick = element(byId("legend-ticks"), "span", text);
      tick.style.left = `${100 * at}%`;
    }
  }

  function addFacts() {
    const original = grouped(data.original.faces);
    const parts = [`${original} faces`];
    if (data.curve) parts[0] = `${grouped(data.levels.at(-1).faces)} to ${original} faces`;
    else if (data.levels.length) parts[0] = `${original} → ${data.levels.map((one) => grouped(one.faces)).join(", ")} faces`;
    parts.push(frameCount > 1 ? `${frameCount} frames` : "one pose");
    byId("facts").textContent = parts.join(" · ");
    if (data.levels.length === 1 && level().measures) {
      const { rms, hausdorff, verdict, reason } = level().measures;
      byId("facts").append(` · RMS ${percent(rms)}, Hausdorff ${percent(hausdorff, upperFigure)} of the diagonal · `);
      element(byId("facts"), "b", verdict, verdictClass(verdict)).title = reason || "";
      if (reason) byId("facts").append(` ${reason}`);
    }
    let place = byId("notes");
    if (data.notes.length > 2) {
      place = element(place, "details");
      element(place, "summary", `${data.notes.length} notes`);
    }
    for (const note of data.notes) element(place, "p", note);
  }

  function applyHash() {
    const values = (id) => [...byId(id).children].filter((button) => !button.disabled).map((button) => button.dataset.value);
    const found = hashToState(location.hash, data, { layout: values("layout"), color: values("color"), shading: values("shading") });
    if (!Object.keys(found).length) return;
    const { camera, level: wanted, chosen, ...rest } = found;
    Object.assign(state, rest, { playing: false });
    if (view) view.layout = state.layout;
    if (chosen && meshNames(data).includes(chosen)) meshActions.only(chosen);
    else if (view) view.aim(frameCount);
    if (camera && view) view.look(camera);
    if (wanted !== undefined && wanted !== state.level) setLevel(wanted);
    refresh();
  }

  function drawNow() {
    state.dirty = false;
    view.levelJoints = level() ? level().joints : null;
    view.draw(state, data.heatEnd || 0);
    seen.drawn += 1;
  }

  async function openView() {
    if (typeof DecompressionStream === "undefined") {
      showNoPicture("This browser is too old to unpack the meshes (it has no DecompressionStream); plots and tables are below.");
      return false;
    }
    try {
      view = new SceneView(byId("canvas"), data);
    } catch (error) {
      showNoPicture("This browser shows no WebGL, so the meshes cannot be drawn; plots and tables are below.");
      return false;
    }
    view.layout = state.layout;
    setInsets();
    textures = await SceneView.textures(data.textures || []);
    const original = data.original.mesh ? await decodeMesh(data.original.mesh, frameCount) : null;
    view.setMeshes(original ? new MeshView(original, data.grid, "original", data.original.markers, textures) : null, null);
    const joints = await Promise.all((data.skeletons || []).map((skeleton) => inflate(skeleton.points)));
    view.skeletons = joints.map((bytes, i) => new SkeletonView(data.skeletons[i], bytes));
    byId("bones").hidden = !view.skeletons.length;
    await setLevel(state.level);
    if (!view.views.length) {
      showNoPicture("The meshes are too large for this page; plots and tables are below.");
      view = null;
      return false;
    }
    view.aim(frameCount);
    view.changed = () => { state.dirty = true; };
    byId("canvas").addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      tell("The browser has taken the graphics memory away; reload the page to see the meshes again.");
    });
    return true;
  }

  async function start() {
    limitChoices();
    addFacts();
    addPlots();
    addTables(byId("tables"), data, setLevel);
    showMeshes = addMeshList(byId("meshes"), data, meshActions);
    connect();
    refresh();
    if (!(await openView())) return;
    const linked = location.hash.length > 1;
    applyHash();
    refresh();
    let last = null;
    let elapsed = 0;
    let slow = 0;
    const tick = (now) => {
      if (state.playing && last !== null) {
        elapsed += (now - last) * 0.001 * data.framesPerSecond * Number(byId("speed").value);
        const steps = Math.floor(elapsed);
        elapsed -= steps;
        if (steps) setFrame(state.frame + steps);
      }
      // A picture that plays smoothly is worth more than its last pixels; it has them all when it stands still.
      slow = state.playing && last !== null && now - last > SLOW ? slow + 1 : Math.max(0, slow - 1);
      if (slow > SLOW_FRAMES && view.detail > LEAST_DETAIL) {
        view.detail = Math.max(LEAST_DETAIL, view.detail * DETAIL_STEP);
        slow = 0;
      }
      if (!state.playing && view.detail < 1) {
        view.detail = 1;
        state.dirty = true;
      }
      last = state.playing ? now : null;
      if (state.dirty) {
        drawNow();
        if (!seen.ready) {
          seen.firstFrame = performance.now();
          seen.ready = true;
          state.playing = !linked && frameCount > 1 && !matchMedia("(prefers-reduced-motion: reduce)").matches;
          refresh();
        }
      }
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  await start();
})();
