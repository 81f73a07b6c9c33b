// The table of the chosen artifact's seeds.
const SEED_COLUMNS = ["seed", "score", "coverage", "iou", "coverage_final", "steps", "decisions", "success"];
const WHOLE = new Set(["seed", "steps", "decisions"]);
const sorting = { column: "seed", way: 1, artifact: -1 };

const cellText = (column, value) => {
  if (column === "success") return value ? "yes" : "no";
  // Four digits: a coverage of 0.9496 is no success, and should not look like one.
  return WHOLE.has(column) ? String(value) : digits(value, 4);
};

const seedCell = (column, value, artifact, rollout) => {
  const cell = html("td", { class: "figure", "data-column": column, "data-value": value });
  if (column === "seed" && isShown(artifact, rollout)) {
    const button = html("button", { type: "button", class: "link", title: "Show in the viewer" }, cellText(column, value));
    button.addEventListener("click", () => {
      selectRollout(artifact, rollout);
      byId("viewer").scrollIntoView({ block: "start" });
    });
    cell.append(button);
  } else {
    cell.append(cellText(column, value));
  }
  return cell;
};

const fillSeeds = () => {
  const { artifact } = selection;
  const { rollouts, label, noun } = REPORT.artifacts[artifact];
  const numbers = rollouts.seed.map((_, rollout) => rollout);
  const values = rollouts[sorting.column];
  numbers.sort((a, b) => sorting.way * (values[a] - values[b]) || rollouts.seed[a] - rollouts.seed[b]);
  const rows = numbers.map((rollout) =>
    html("tr", { "data-seed": rollouts.seed[rollout], "data-rollout": rollout },
      ...SEED_COLUMNS.map((column) => seedCell(column, rollouts[column][rollout], artifact, rollout))));
  byId("seeds").tBodies[0].replaceChildren(...rows);
  byId("seeds-of").textContent = label;
  byId("seeds").querySelector("th button[data-column=seed]").textContent = titled(noun);
  sorting.artifact = artifact;
  for (const button of byId("seeds").querySelectorAll("th button")) {
    const sorted = button.dataset.column === sorting.column;
    button.parentNode.setAttribute("aria-sort", sorted ? (sorting.way > 0 ? "ascending" : "descending") : "none");
  }
};

const showSeed = () => {
  if (sorting.artifact !== selection.artifact) fillSeeds();
  for (const row of byId("seeds").tBodies[0].rows) {
    row.classList.toggle("selected", Number(row.dataset.rollout) === selection.rollout);
  }
};

const setUpSeeds = () => {
  for (const button of byId("seeds").querySelectorAll("th button")) {
    button.addEventListener("click", () => {
      const { column } = button.dataset;
      Object.assign(sorting, { column, way: sorting.column === column ? -sorting.way : 1 });
      fillSeeds();
      showSeed();
    });
  }
  listeners.rollout.push(showSeed);
};
