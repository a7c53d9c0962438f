// Tables, and what their figures mean.

const DEFINITIONS = {
  faces: "Triangles.",
  verdict: "Good, look or poor, by RMS, Hausdorff and flips against fixed limits: whether it is worth a look. The reason is in the notes and under the pointer.",
  RMS: "Root mean square distance of the two surfaces, of the two directions the larger, as a mean over the frames, in % of the diagonal of the original's bounding box.",
  mean: "Mean distance of the two surfaces, over both directions and all frames, in % of the diagonal.",
  Hausdorff: "The largest distance of any point of either surface from the other, in any frame, in % of the diagonal.",
  normals: "Mean angle between the normals of a point's face and of the face nearest to it, in degrees.",
  flips: "Simplified faces that oppose the face of the original nearest to them, as a mean over the frames.",
  jitter: "How unsteady the surface is over time: second difference of its offsets from the original, in % of the diagonal.",
  slide: "How much vertices move over the material: second difference of their offsets from the points that they stand for, in % of the diagonal.",
  "slide 95": "The same at the vertex that slides more than 95 % of them: a few vertices leave it alone.",
  edge: "Root mean square relative error of the lengths of edges, in %.",
  "connected components": "Pieces of the mesh that no edge connects.",
  "Euler number": "Vertices minus edges plus faces: 2 for a closed surface without a hole, 2 less for each handle.",
  "border edges": "Edges with one face.",
  "non-manifold edges": "Edges with more than two faces.",
  "non-manifold vertices": "Vertices at which the faces are not one fan.",
  "repeated faces": "Faces with the same three vertices as another.",
  "collapsed faces": "Faces that name a vertex twice.",
  "flipped faces": "The most faces in one frame that oppose the original.",
  "faces without area": "The most faces in one frame whose corners lie on a line.",
  stopped: "Why simplification ended: at the target, at the error limit, or since no legal collapse was left.",
  seconds: "Wall-clock time, in seconds.",
  swim: "How much the texture moves over the surface between frames, in % of the texture.",
  "seam drift": "How far seams of the texture lie from where they were, in % of the diagonal.",
  stretch: "How much the texture is stretched against the original.",
  joints: "Joints that move the mesh.",
  influences: "The most joints that move one point.",
  shapes: "Blend shapes of the mesh.",
  KB: "Size of the level's values in the file, before compression.",
};

// A table of more rows scrolls in itself, below its heads.
const TALL = 16;

const definitionOf = (name) => {
  const key = Object.keys(DEFINITIONS).filter((key) => name.toLowerCase().startsWith(key.toLowerCase()));
  return key.length ? DEFINITIONS[key.reduce((a, b) => (b.length > a.length ? b : a))] : null;
};

const figure = (value) => grouped(Number.isInteger(value) ? value : Number(value.toPrecision(4)));
// Thousands apart by a narrow space, which no language reads as a decimal mark.
function grouped(value) {
  const [whole, part] = String(value).split(".");
  const spaced = /e/.test(whole) || whole.replace("-", "").length < 5 ? whole : whole.replace(/\B(?=(\d{3})+$)/g, "\u202f");
  return part === undefined ? spaced : `${spaced}.${part}`;
}
// What nothing is above is rounded up, as in the commands' tables.
const upperFigure = (value) => {
  const near = Number(value.toPrecision(4));
  const step = 10 ** (Math.floor(Math.log10(Math.abs(value))) - 3);
  return figure(near < value ? Number((near + step).toPrecision(4)) : near);
};
const shownValue = (value, show = figure) =>
  value === null || value === undefined ? "–" : typeof value === "number" ? show(value) : String(value);

function element(parent, name, text, className) {
  const node = document.createElement(name);
  if (text !== undefined) node.textContent = text;
  if (className) node.className = className;
  parent.append(node);
  return node;
}

// Text with places to break a line at, after the slashes of a path.
function addBreakable(cell, text) {
  text.split(/(?<=\/)(?=.)/).forEach((part, index) => {
    if (index) cell.append(document.createElement("wbr"));
    cell.append(part);
  });
}

// A heading that says what it means when it is pressed.
function addTerm(cell, name, say) {
  const meaning = definitionOf(name);
  if (!meaning) {
    addBreakable(cell, name);
    return;
  }
  const button = element(cell, "button", name, "term");
  button.type = "button";
  button.title = meaning;
  button.addEventListener("click", () => say(name, meaning));
}

// A region that can be scrolled sideways, by keys too, with a hint as long as there is more to see.
function addScroll(parent, label) {
  const hint = element(parent, "p", "More columns: scroll sideways →", "hint");
  const scroll = element(parent, "div", undefined, "scroll");
  scroll.setAttribute("role", "region");
  scroll.setAttribute("aria-label", label);
  const update = () => {
    const more = scroll.scrollWidth > scroll.clientWidth + 1;
    const down = scroll.scrollHeight > scroll.clientHeight + 1;
    hint.hidden = !more || scroll.scrollLeft + scroll.clientWidth > scroll.scrollWidth - 2;
    if (more || down) scroll.tabIndex = 0;
    else scroll.removeAttribute("tabindex");
  };
  scroll.addEventListener("scroll", update, { passive: true });
  new ResizeObserver(update).observe(scroll);
  return scroll;
}

// options: wide, className(row, column), title(row, column), pick(row)
function addTable(parent, title, head, rows, options = {}) {
  const card = element(parent, "div", undefined, options.wide ? "card wide" : "card");
  element(card, "h2", title);
  const scroll = addScroll(card, title);
  if (rows.length > TALL) scroll.classList.add("tall");
  const meaning = element(card, "p", "", "meaning");
  meaning.setAttribute("role", "status");
  const say = (name, text) => { meaning.textContent = meaning.textContent.startsWith(`${name}: `) ? "" : `${name}: ${text}`; };
  const table = element(scroll, "table");
  const isNumber = head.map((_, column) => column > 0 && rows.every((row) => row[column] === null || typeof row[column] === "number"));
  if (head.some((name) => name !== "")) {
    const line = element(element(table, "thead"), "tr");
    head.forEach((name, column) => {
      // A head without text is none.
      const cell = element(line, name === "" ? "td" : "th", undefined, isNumber[column] ? "number" : "");
      if (name !== "") cell.scope = "col";
      addTerm(cell, name, say);
    });
  }
  const body = element(table, "tbody");
  for (const row of rows) {
    const line = element(body, "tr");
    row.forEach((value, column) => {
      const cell = element(line, column ? "td" : "th", undefined, [isNumber[column] ? "number" : "", options.className ? options.className(row, column) : ""].filter(Boolean).join(" "));
      if (column === 0) cell.scope = "row";
      const text = shownValue(value === "" ? null : value, head[column].startsWith("Hausdorff") ? upperFigure : figure);
      if (column === 0 && options.pick && options.pick(row)) {
        const button = element(cell, "button", text, "term");
        button.type = "button";
        button.addEventListener("click", options.pick(row));
      } else if (column === 0) addTerm(cell, text, say);
      else cell.textContent = text;
      const told = options.title ? options.title(row, column) : null;
      if (told) cell.title = told;
    });
  }
  return card;
}

const verdictClass = (value) => (["good", "look", "poor"].includes(value) ? `verdict ${value}` : "");

function addTables(parent, data, setLevel) {
  const measured = data.levels.filter((one) => one.measures);
  if (measured.length) {
    const head = ["level", "faces", "vertices", "verdict", "RMS %", "mean %", "Hausdorff %", "normals °", "flips a frame", "jitter %", "slide %", "slide 95 %", "edge length %"];
    const rows = measured.map((one) => {
      const m = one.measures;
      return [one.name, one.faces, one.vertices, m.verdict, m.rms, m.mean, m.hausdorff, m.normals, m.flips, m.jitter, m.slide, m.slideP95, m.edgeLength];
    });
    addTable(parent, "Distance from the original", head, [["original", data.original.faces, data.original.vertices, ...Array(head.length - 3).fill(null)], ...rows], {
      wide: true,
      className: (row, column) => (column === 3 ? verdictClass(row[3]) : ""),
      title: (row, column) => (column === 3 && measured.find((one) => one.name === row[0])?.measures.reason) || null,
      pick: (row) => {
        const index = data.levels.findIndex((one) => one.name === row[0]);
        return data.levels.length > 1 && index >= 0 ? () => setLevel(index) : null;
      },
    });
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
    const bad = (row, column) => (column > 1 && faults.includes(row[0]) && row[column] > row[1] ? "bad" : "");
    addTable(parent, "Validity", ["", "original", ...measured.map((one) => one.name)], figures, { wide: measured.length > 4, className: bad });
  }
  for (const table of data.tables) {
    addTable(parent, table.title, table.head, table.rows, {
      wide: table.head.length > 3,
      className: (row, column) => (table.head[column] === "verdict" ? verdictClass(row[column]) : ""),
    });
  }
}
