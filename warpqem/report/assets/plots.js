// Line plots as SVG.

const SVG = "http://www.w3.org/2000/svg";
// Told apart with the usual colour blindnesses (Okabe and Ito, "Color Universal Design", 2008), light and dark.
const LINE_COLORS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00"];

function svgNode(parent, name, attributes, text) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  parent.append(node);
  return node;
}

function short(value) {
  if (Number.isInteger(value)) return String(value);
  return Number(value.toPrecision(3)).toString();
}

// Round steps between low and high: 1, 2 or 5 times a power of ten.
function ticks(low, high, about) {
  const rough = (high - low) / about || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) found.push(k * step);
  return found;
}

// Those of some values whose labels have room beside each other.
function apart(values, place) {
  const kept = [];
  for (const value of values) {
    if (kept.every((other) => Math.abs(place(other) - place(value)) > 38)) kept.push(value);
  }
  return kept;
}

// A plot of series {name, x, y} from zero up; returns a function that moves the line of the current x.
// `pick` is called with the index of the x nearest to where the plot is clicked.
function plotCard(parent, { title, unit, xName, series, logX = false, dots = false, pick }) {
  const card = document.createElement("div");
  card.className = "card";
  parent.append(card);
  const heading = document.createElement("h2");
  heading.textContent = `${title}, ${unit}`;
  card.append(heading);
  const [width, height, left, bottom, top] = [460, 200, 46, 34, 8];
  const svg = svgNode(card, "svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": title });
  const xs = [...new Set(series.flatMap((one) => one.x))];
  // Nothing lies between two counts.
  const whole = dots && xs.every(Number.isInteger);
  const onX = (value) => (logX ? Math.log(value) : value);
  let [low, high] = [Math.min(...xs), Math.max(...xs)].map(onX);
  if (low === high) [low, high] = [low - 0.5, high + 0.5];
  const most = Math.max(...series.flatMap((one) => one.y)) * 1.05 || 1;
  const placeX = (value) => left + ((onX(value) - low) / (high - low)) * (width - left - 12);
  const placeY = (value) => top + (1 - value / most) * (height - top - bottom);
  for (const value of ticks(0, most, 4)) {
    svgNode(svg, "line", { class: "grid", x1: left, x2: width - 12, y1: placeY(value), y2: placeY(value) });
    svgNode(svg, "text", { x: left - 6, y: placeY(value) + 4, "text-anchor": "end" }, short(value));
  }
  for (const value of logX ? apart(xs, placeX) : ticks(low, high, 7).filter((at) => !whole || Number.isInteger(at))) {
    svgNode(svg, "text", { x: placeX(value), y: height - bottom + 16, "text-anchor": "middle" }, short(value));
  }
  svgNode(svg, "text", { x: (left + width) / 2, y: height - 3, "text-anchor": "middle" }, xName);
  const now = svgNode(svg, "line", { class: "now", visibility: "hidden", x1: 0, x2: 0, y1: top, y2: height - bottom });
  series.forEach((one, index) => {
    const color = LINE_COLORS[index % LINE_COLORS.length];
    // A frame without a value parts the line.
    const known = (i) => i >= 0 && one.y[i] !== null;
    const point = (x, i) => `${known(i - 1) ? "L" : "M"}${placeX(x).toFixed(1)} ${placeY(one.y[i]).toFixed(1)}`;
    const line = one.x.map((x, i) => (known(i) ? point(x, i) : "")).join("");
    svgNode(svg, "path", { d: line, fill: "none", stroke: color, "stroke-width": 1.8, "stroke-linejoin": "round" });
    if (dots || one.x.length === 1) {
      one.x.forEach((x, i) => svgNode(svg, "circle", { cx: placeX(x), cy: placeY(one.y[i]), r: 3, fill: color }));
    }
  });
  const key = document.createElement("div");
  key.className = "key";
  series.forEach((one, index) => {
    const entry = document.createElement("span");
    const stroke = document.createElement("i");
    stroke.style.background = LINE_COLORS[index % LINE_COLORS.length];
    entry.append(stroke, one.name);
    key.append(entry);
  });
  card.append(key);
  if (pick) {
    svg.style.cursor = "pointer";
    svg.addEventListener("click", (event) => {
      const box = svg.getBoundingClientRect();
      const at = ((event.clientX - box.left) / box.width) * width;
      const gaps = xs.map((x) => Math.abs(placeX(x) - at));
      pick(gaps.indexOf(Math.min(...gaps)));
    });
  }
  return (x) => {
    now.setAttribute("visibility", "visible");
    now.setAttribute("x1", placeX(x));
    now.setAttribute("x2", placeX(x));
  };
}
