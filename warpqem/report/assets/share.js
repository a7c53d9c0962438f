// A picture of what is shown, and a link to it.

const STRIP = 34;

// The state of the view as the part of an address behind the #.
function stateToHash(state, data, pose) {
  const level = data.levels[state.level];
  const parts = { frame: state.frame + 1, layout: state.layout, color: state.colors, shading: state.shading };
  if (level) parts.level = level.name;
  if (state.wire) parts.lines = 1;
  if (state.chosen) parts.mesh = state.chosen;
  if (pose) parts.camera = pose.map((value) => Number(value.toPrecision(6))).join(",");
  return new URLSearchParams(parts).toString();
}

// What of a hash can be used; unknown values are left out.
function hashToState(hash, data, choices) {
  const parts = new URLSearchParams(hash.replace(/^#/, ""));
  const found = {};
  const frame = Number(parts.get("frame"));
  if (Number.isInteger(frame) && frame >= 1 && frame <= data.original.frames) found.frame = frame - 1;
  const level = data.levels.findIndex((one) => one.name === parts.get("level"));
  if (level >= 0) found.level = level;
  for (const [key, name] of [["layout", "layout"], ["colors", "color"], ["shading", "shading"]]) {
    if (choices[name].includes(parts.get(name))) found[key] = parts.get(name);
  }
  if (parts.has("lines")) found.wire = parts.get("lines") === "1";
  if (parts.has("mesh")) found.chosen = parts.get("mesh");
  const camera = (parts.get("camera") || "").split(",").map(Number);
  if (camera.length === 6 && camera.every(Number.isFinite)) found.camera = camera;
  return found;
}

// The canvas as a PNG with its captions in a strip above and the legend below, as a Blob.
function pictureOf(canvas, captions, legend) {
  const style = getComputedStyle(document.documentElement);
  const ratio = canvas.width / canvas.clientWidth;
  const picture = document.createElement("canvas");
  const foot = legend ? STRIP + 12 : 0;
  picture.width = canvas.width;
  picture.height = canvas.height + (STRIP + foot) * ratio;
  const context = picture.getContext("2d");
  context.fillStyle = style.getPropertyValue("--view");
  context.fillRect(0, 0, picture.width, picture.height);
  context.drawImage(canvas, 0, STRIP * ratio);
  context.scale(ratio, ratio);
  const width = canvas.clientWidth;
  context.fillStyle = style.getPropertyValue("--panel");
  context.fillRect(0, 0, width, STRIP);
  context.fillStyle = style.getPropertyValue("--ink");
  context.font = "14px system-ui, sans-serif";
  context.textBaseline = "middle";
  captions.forEach((text, index) => context.fillText(text, 12 + (index * width) / captions.length, STRIP / 2, width / captions.length - 20));
  if (legend) {
    const top = STRIP + canvas.clientHeight;
    context.fillStyle = style.getPropertyValue("--panel");
    context.fillRect(0, top, width, foot);
    const long = Math.min(360, width - 40);
    context.drawImage(legend.bar, 16, top + 8, long, 10);
    context.fillStyle = style.getPropertyValue("--ink");
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    for (const { at, text } of legend.ticks) context.fillText(text, 16 + at * long, top + 30);
    context.textAlign = "left";
    context.fillText(legend.title, 34 + long, top + 13, Math.max(10, width - long - 40));
  }
  return new Promise((resolve) => picture.toBlob(resolve, "image/png"));
}

function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
