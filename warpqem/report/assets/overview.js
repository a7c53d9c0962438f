// The overview of many assets: as a grid of pictures or a table, sorted, limited by status and text.

(() => {
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("data").textContent);
  // What failed has no faces after, and what was not opened none at all.
  const known = (value) => value || null;
  const share = (asset) => (asset.faces && asset.faces_after ? (100 * asset.faces_after) / asset.faces : null);
  const short = (value) => (Number.isInteger(value) ? String(value) : Number(value.toPrecision(3)).toString());
  const grouped = (value) => short(value).replace(/^\d{5,}(?=\.|$)/, (digits) => digits.replace(/\B(?=(\d{3})+$)/g, "\u202f"));
  const shown = (value, unit) => (value === null ? "–" : grouped(value) + unit);
  // What nothing is above is rounded up, as in the commands' tables.
  const upper = (value) => {
    if (value === null) return null;
    const near = Number(value.toPrecision(3));
    return near < value ? Number((near + 10 ** (Math.floor(Math.log10(value)) - 2)).toPrecision(3)) : near;
  };
  const WORST = ["poor", "look", "good"];
  const STATES = ["failed", "partial", "done", "skipped"];
  // Name, value to sort by, unit.
  const columns = [
    ["asset", (asset) => asset.name, ""],
    ["status", (asset) => asset.status, ""],
    ["faces", (asset) => known(asset.faces), ""],
    ["after", (asset) => known(asset.faces_after), ""],
    ["kept", share, " %"],
    ["verdict", (asset) => asset.verdict || null, ""],
    ["RMS", (asset) => asset.rms, " %"],
    ["Hausdorff", (asset) => asset.hausdorff, " %"],
    ["flips", (asset) => asset.flips, ""],
    ["time", (asset) => known(asset.seconds), " s"],
    ["reason", (asset) => reasonOf(asset) || null, ""],
  ];
  const reasonOf = (asset) => asset.message || asset.reason;
  const state = { column: null, down: false, status: "all", text: "", form: "grid" };
  window.warpqem = { state };

  function element(parent, name, text, className) {
    const node = document.createElement(name);
    if (text !== undefined) node.textContent = text;
    if (className) node.className = className;
    parent.append(node);
    return node;
  }

  // The worst first, where words have an order of their own.
  const placeOf = (words, value) => (words.includes(value) ? words.indexOf(value) : words.length);
  const sortable = (name, value) =>
    value === null ? null : name === "verdict" ? placeOf(WORST, value) : name === "status" ? placeOf(STATES, value) : value;

  function compare(a, b) {
    const [name, value] = columns[state.column];
    const [x, y] = [sortable(name, value(a)), sortable(name, value(b))];
    // What is not known stands last, whichever way.
    if (x === null || y === null) return (x === null) - (y === null);
    const order = typeof x === "number" ? x - y : x.localeCompare(y);
    return state.down ? -order : order;
  }

  function addName(parent, asset) {
    const target = asset.page || asset.link;
    const name = element(parent, target ? "a" : "span", asset.name, "asset-name");
    if (target) name.href = target;
    if (asset.page && asset.link) {
      parent.append(" ");
      element(parent, "a", "file", "soft").href = asset.link;
    }
  }

  function addMarks(parent, asset) {
    const failed = asset.status === "failed" || asset.status === "partial";
    element(parent, "b", asset.status, failed ? "verdict poor" : "soft");
    if (asset.verdict) element(parent, "b", asset.verdict, `verdict ${asset.verdict}`);
  }

  function addCard(asset) {
    const card = element(byId("grid"), "li", undefined, "card asset");
    const pictures = element(card, "div", undefined, "pictures");
    asset.pictures.forEach((source, place) => {
      const picture = element(pictures, "img");
      picture.src = source;
      picture.alt = `${asset.name} ${place ? "after" : "before"}`;
      picture.loading = "lazy";
    });
    if (!asset.pictures.length) element(pictures, "p", "no picture", "soft");
    addName(element(card, "p", undefined, "asset-head"), asset);
    const marks = element(card, "p", undefined, "asset-marks");
    addMarks(marks, asset);
    element(marks, "span", `${shown(known(asset.faces), "")} → ${shown(known(asset.faces_after), "")}`);
    const figures = element(card, "p", undefined, "asset-figures");
    figures.textContent = `RMS ${shown(asset.rms, " %")} · Hausdorff ${shown(upper(asset.hausdorff), " %")} · flips ${shown(asset.flips, "")} · ${shown(known(asset.seconds), " s")}`;
    if (reasonOf(asset)) element(card, "p", reasonOf(asset), "asset-reason");
  }

  function addRow(asset) {
    const row = element(document.querySelector("#assets tbody"), "tr");
    columns.forEach(([name, value, unit], index) => {
      const found = value(asset);
      const text = name === "reason" || index < 2 || name === "verdict";
      const cell = element(row, index ? "td" : "th", undefined, text ? "" : "number");
      if (index === 0) {
        cell.scope = "row";
        addName(cell, asset);
      } else if (text) {
        cell.textContent = found ?? "–";
        if (name === "verdict" && found) cell.className = `verdict ${found}`;
        if (name === "status" && (found === "failed" || found === "partial")) cell.className = "bad";
        if (name === "reason" && found) cell.className = "reason";
      } else cell.textContent = shown(name === "Hausdorff" ? upper(found) : found, unit);
    });
  }

  function show() {
    const head = document.querySelector("#assets thead tr");
    [...head.children].forEach((cell, index) => {
      const sorted = index === state.column;
      cell.setAttribute("aria-sort", sorted ? (state.down ? "descending" : "ascending") : "none");
    });
    for (const [id, key] of [["status", "status"], ["form", "form"]]) {
      for (const button of byId(id).children) button.setAttribute("aria-pressed", String(button.dataset.value === state[key]));
    }
    byId("order").value = state.column === null ? "" : `${state.column}${state.down ? "-" : "+"}`;
    const wanted = state.text.toLowerCase();
    const assets = data.assets.filter(
      (asset) =>
        (state.status === "all" || asset.status === state.status) &&
        `${asset.name} ${asset.message} ${asset.reason}`.toLowerCase().includes(wanted)
    );
    if (state.column !== null) assets.sort(compare);
    byId("grid").replaceChildren();
    document.querySelector("#assets tbody").replaceChildren();
    byId("grid").hidden = state.form !== "grid";
    byId("table-card").hidden = state.form !== "table";
    assets.forEach(state.form === "grid" ? addCard : addRow);
    const many = assets.length === data.assets.length ? `${assets.length}` : `${assets.length} of ${data.assets.length}`;
    byId("facts").textContent = `${many} assets`;
    updateHint();
  }

  function updateHint() {
    const scroll = document.querySelector("#table-card .scroll");
    const more = scroll.scrollWidth > scroll.clientWidth + 1;
    document.querySelector("#table-card .hint").hidden = !more || scroll.scrollLeft + scroll.clientWidth > scroll.scrollWidth - 2;
    if (more) scroll.tabIndex = 0;
    else scroll.removeAttribute("tabindex");
  }

  const head = document.querySelector("#assets thead tr");
  columns.forEach(([name], index) => {
    const cell = element(head, "th", undefined, index > 1 && name !== "verdict" && name !== "reason" ? "number" : "");
    cell.scope = "col";
    const button = element(cell, "button", name, "sort");
    button.type = "button";
    button.addEventListener("click", () => {
      state.down = state.column === index ? !state.down : false;
      state.column = index;
      show();
    });
  });
  element(byId("order"), "option", "the worst first").value = "";
  const orders = { asset: ["+"], faces: ["-", "+"], after: ["-"], RMS: ["-", "+"], Hausdorff: ["-", "+"], flips: ["-"], time: ["-"] };
  columns.forEach(([name], index) => {
    for (const way of orders[name] || []) {
      const text = name === "asset" ? "name" : `${name}, ${way === "-" ? "most" : "least"} first`;
      element(byId("order"), "option", text).value = `${index}${way}`;
    }
  });
  byId("order").addEventListener("change", (event) => {
    const value = event.target.value;
    state.column = value === "" ? null : parseInt(value, 10);
    state.down = value.endsWith("-");
    show();
  });
  for (const value of ["all", ...new Set(data.assets.map((asset) => asset.status))]) {
    const count = value === "all" ? data.assets.length : data.assets.filter((asset) => asset.status === value).length;
    const button = element(byId("status"), "button", `${value} ${count}`);
    button.type = "button";
    button.dataset.value = value;
  }
  for (const [id, key] of [["status", "status"], ["form", "form"]]) {
    for (const button of byId(id).children) {
      button.addEventListener("click", () => {
        state[key] = button.dataset.value;
        show();
      });
    }
  }
  byId("search").addEventListener("input", (event) => {
    state.text = event.target.value;
    show();
  });
  const scroll = document.querySelector("#table-card .scroll");
  scroll.addEventListener("scroll", updateHint, { passive: true });
  new ResizeObserver(updateHint).observe(scroll);
  for (const note of data.notes) element(byId("notes"), "p", note);
  show();
})();
