// The overview of many assets: sorted by a click on a column, limited by status and text.

(() => {
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("data").textContent);
  const share = (asset) => (asset.faces ? (100 * asset.faces_after) / asset.faces : null);
  const short = (value) => (Number.isInteger(value) ? String(value) : Number(value.toPrecision(4)).toString());
  // What nothing is above is rounded up, as in the commands' tables.
  const upper = (value) => {
    const near = Number(value.toPrecision(4));
    const step = 10 ** (Math.floor(Math.log10(Math.abs(value))) - 3);
    return Number((near < value ? near + step : near).toPrecision(4)).toString();
  };
  // Name, value to sort by, unit.
  const columns = [
    ["asset", (asset) => asset.name, ""],
    ["status", (asset) => asset.status, ""],
    ["faces", (asset) => asset.faces, ""],
    ["after", (asset) => asset.faces_after, ""],
    ["kept", share, " %"],
    ["verdict", (asset) => asset.verdict || null, ""],
    ["RMS", (asset) => asset.rms, " %"],
    ["Hausdorff", (asset) => asset.hausdorff, " %"],
    ["flips", (asset) => asset.flips, ""],
    ["time", (asset) => asset.seconds, " s"],
  ];
  const state = { column: null, down: false, status: "all", text: "" };
  window.warpqem = { state };

  function element(parent, name, text, className) {
    const node = document.createElement(name);
    if (text !== undefined) node.textContent = text;
    if (className) node.className = className;
    parent.append(node);
    return node;
  }

  function compare(a, b) {
    const value = columns[state.column][1];
    const [x, y] = [value(a), value(b)];
    // What is not known stands last, whichever way.
    if (x === null || y === null) return (x === null) - (y === null);
    const order = typeof x === "number" ? x - y : x.localeCompare(y);
    return state.down ? -order : order;
  }

  function show() {
    const head = document.querySelector("#assets thead tr");
    [...head.children].forEach((cell, index) => {
      const sorted = index === state.column;
      cell.setAttribute("aria-sort", sorted ? (state.down ? "descending" : "ascending") : "none");
    });
    for (const button of byId("status").children) {
      button.setAttribute("aria-checked", String(button.dataset.value === state.status));
    }
    const wanted = state.text.toLowerCase();
    const shown = data.assets.filter(
      (asset) =>
        (state.status === "all" || asset.status === state.status) &&
        `${asset.name} ${asset.message}`.toLowerCase().includes(wanted)
    );
    if (state.column !== null) shown.sort(compare);
    const body = document.querySelector("#assets tbody");
    body.replaceChildren();
    for (const asset of shown) {
      const row = element(body, "tr");
      columns.forEach(([name, value, unit], index) => {
        const found = value(asset);
        const cell = element(row, "td", undefined, typeof found === "number" || index > 1 ? "number" : "");
        if (index === 0) {
          if (asset.link) element(cell, "a", found).href = asset.link;
          else element(cell, "span", found);
          if (asset.message) element(cell, "p", asset.message, "message");
          const pictures = asset.pictures.length ? element(cell, "div", undefined, "pictures") : null;
          asset.pictures.forEach((source, place) => {
            const picture = element(pictures, "img");
            picture.src = source;
            picture.alt = `${asset.name} ${place ? "after" : "before"}`;
            picture.loading = "lazy";
          });
        } else if (name === "status") {
          cell.textContent = found;
          if (found === "failed" || found === "partial") cell.className = "bad";
        } else if (name === "verdict") {
          cell.textContent = found ?? "–";
          if (found === "poor") cell.className = "bad";
          if (asset.reason) cell.title = asset.reason;
        } else {
          cell.textContent = found === null ? "–" : (name === "Hausdorff" && !Number.isInteger(found) ? upper : short)(found) + unit;
        }
      });
    }
    byId("facts").textContent = `${shown.length} of ${data.assets.length} assets`;
  }

  const head = document.querySelector("#assets thead tr");
  columns.forEach(([name], index) => {
    const cell = element(head, "th", undefined, index > 1 ? "number" : "");
    const button = element(cell, "button", name, "sort");
    button.addEventListener("click", () => {
      state.down = state.column === index ? !state.down : false;
      state.column = index;
      show();
    });
  });
  for (const value of ["all", ...new Set(data.assets.map((asset) => asset.status))]) {
    const button = element(byId("status"), "button", value);
    button.dataset.value = value;
    button.setAttribute("role", "radio");
    button.addEventListener("click", () => {
      state.status = value;
      show();
    });
  }
  byId("search").addEventListener("input", (event) => {
    state.text = event.target.value;
    show();
  });
  for (const note of data.notes) element(byId("notes"), "p", note);
  show();
})();
