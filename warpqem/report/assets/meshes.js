// The list of meshes: which are shown, how well each came out, and a way to look at one.

// From so many on there is a field to search in.
const SEARCHABLE = 8;
const RANKS = { poor: 0, look: 1, good: 2 };

function meshNames(data) {
  const meshes = [data.original, ...data.levels].map((one) => one.mesh).filter(Boolean);
  return [...new Set(meshes.flatMap((mesh) => mesh.parts.map((part) => part.name)))];
}

// Returns what is called when the level or what is hidden changed; actions: toggle(name), only(name), all().
function addMeshList(parent, data, actions) {
  const names = meshNames(data);
  if (names.length < 2) return () => {};
  parent.hidden = false;
  const head = element(parent, "div", undefined, "list-head");
  element(head, "h2", `${names.length} meshes`);
  const all = element(head, "button", "Show all", "small");
  all.type = "button";
  all.addEventListener("click", actions.all);
  let search = null;
  if (names.length >= SEARCHABLE) {
    search = element(parent, "input");
    search.type = "search";
    search.placeholder = "Name";
    search.setAttribute("aria-label", "Meshes whose path has this text");
  }
  const list = element(parent, "ul", undefined, "list");
  // What all paths begin with says nothing.
  const parts = names.map((name) => name.split("/"));
  let common = 0;
  while (parts.every((one) => one.length > common + 1 && one[common] === parts[0][common])) common += 1;
  const faces = (mesh, name) => (mesh ? mesh.parts.filter((part) => part.name === name).reduce((sum, part) => sum + part.count, 0) : null);
  const found = (level, name) => (level && level.meshes && level.meshes[name]) || null;
  const rank = (name) => Math.min(...data.levels.map((level) => RANKS[found(level, name)?.verdict] ?? 3), 3);
  const worst = (name) => Math.max(...data.levels.map((level) => found(level, name)?.hausdorff ?? 0), 0);
  const ordered = names.map((name, index) => ({ name, label: parts[index].slice(common).join("/") || name }));
  ordered.sort((a, b) => rank(a.name) - rank(b.name) || worst(b.name) - worst(a.name));
  const rows = ordered.map(({ name, label }) => {
    const item = element(list, "li");
    const box = element(item, "input");
    box.type = "checkbox";
    box.setAttribute("aria-label", `Show ${label}`);
    box.addEventListener("change", () => actions.toggle(name));
    const button = element(item, "button", undefined, "mesh");
    button.type = "button";
    button.title = `${name}: look at it`;
    // The end of a path says more than its start: the line is cut off at its left.
    element(element(button, "span", undefined, "mesh-name"), "bdi", label);
    const facts = element(button, "span", "", "mesh-facts");
    button.addEventListener("click", () => actions.only(name));
    return { name, label, item, box, facts };
  });
  const filter = () => {
    const wanted = search ? search.value.toLowerCase() : "";
    for (const { name, item } of rows) item.hidden = !name.toLowerCase().includes(wanted);
  };
  if (search) search.addEventListener("input", filter);
  return (state) => {
    const level = data.levels[state.level];
    for (const { name, box, facts, item } of rows) {
      box.checked = !state.hidden.has(name);
      item.classList.toggle("chosen", state.chosen === name);
      const counts = [faces(data.original.mesh, name), level ? faces(level.mesh, name) : null].filter((count) => count !== null);
      facts.textContent = counts.map((count) => grouped(count)).join(" → ");
      const errors = found(level, name);
      if (errors) {
        const mark = element(facts, "b", errors.verdict, verdictClass(errors.verdict));
        mark.title = errors.reason || `Hausdorff ${upperFigure(errors.hausdorff)} %`;
      }
    }
    all.disabled = !state.hidden.size;
  };
}
