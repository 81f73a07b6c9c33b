// Every rollout as a cell of a grid and as a row of a table; one filter and one order for both.
const FILTERS = {
  all: () => true,
  failure: ({ success }, i) => !success[i],
  lost: ({ losses }, i) => losses[i] > 0,
  several: ({ demos }, i) => demos[i] > 1,
};
const COLUMNS = ["seed", "success", "steps", "decisions", "demos", "losses", "banned"];
const sorting = { column: "seed", way: 1 };

const filtered = (artifact) => {
  const { rollouts } = REPORT.artifacts[artifact];
  const keep = FILTERS[checked("filter")];
  return rollouts.seed.map((_, i) => i).filter((i) => keep(rollouts, i));
};

const ordered = (artifact) => {
  const { rollouts } = REPORT.artifacts[artifact];
  const numbers = filtered(artifact);
  if (checked("order") === "steps") {
    // Failures last, whatever they took.
    const rank = (i) => (rollouts.success[i] ? 0 : 1e9) + rollouts.steps[i];
    numbers.sort((a, b) => rank(a) - rank(b) || rollouts.seed[a] - rollouts.seed[b]);
  } else {
    numbers.sort((a, b) => rollouts.seed[a] - rollouts.seed[b]);
  }
  return numbers;
};

const times = (count, one, many) => (count === 1 ? `1 ${one}` : `${count} ${many}`);

const inWords = ({ rollouts, label }, i) =>
  `${label}, seed ${rollouts.seed[i]}: ${rollouts.success[i] ? "succeeded" : "failed"} after ${times(rollouts.steps[i], "step", "steps")}, ` +
  `${times(rollouts.demos[i], "demonstration", "demonstrations")} followed, grasp lost ${times(rollouts.losses[i], "time", "times")}`;

// Bars are as high as the longest rollout of all.
const LONGEST = Math.max(1, ...REPORT.artifacts.flatMap(({ rollouts }) => rollouts.steps));

const cellOf = (number, i) => {
  const artifact = REPORT.artifacts[number];
  const { rollouts } = artifact;
  const kinds = ["cell", rollouts.success[i] ? "success" : "failure", rollouts.losses[i] > 0 ? "lost" : "", `series-${markOf(number)}`];
  const words = inWords(artifact, i) + (isShown(number, i) ? "" : " (not embedded in this page)");
  const share = Math.max(6, (100 * rollouts.steps[i]) / LONGEST);
  const cell = html("button", { type: "button", class: kinds.join(" "), title: words, "aria-label": words, tabindex: -1, "data-rollout": i },
    html("i", { style: `--share:${near(share)}%` }));
  cell.disabled = !isShown(number, i);
  cell.addEventListener("click", () => selectRollout(number, i));
  return cell;
};

const drawCells = () => {
  for (const host of document.querySelectorAll(".cells")) {
    const number = Number(host.dataset.artifact);
    const numbers = ordered(number);
    host.replaceChildren(...numbers.map((i) => cellOf(number, i)));
    if (numbers.length === 0) host.append(html("p", { class: "hint" }, "None."));
    const all = REPORT.artifacts[number].rollouts.seed.length;
    document.querySelector(`[data-count-of="${number}"]`).textContent = numbers.length === all ? `${all}` : `${numbers.length} of ${all}`;
  }
  markCell();
};

const markCell = () => {
  for (const host of document.querySelectorAll(".cells")) {
    const here = Number(host.dataset.artifact) === selection.artifact;
    let reachable;
    for (const cell of host.querySelectorAll("button")) {
      const chosen = here && Number(cell.dataset.rollout) === selection.rollout;
      cell.classList.toggle("selected", chosen);
      cell.setAttribute("aria-pressed", chosen);
      cell.tabIndex = -1;
      if (chosen || reachable === undefined) reachable = cell;
    }
    if (reachable) reachable.tabIndex = 0;
  }
};

const walkCells = (event) => {
  const cells = [...event.currentTarget.querySelectorAll("button:not(:disabled)")];
  const at = cells.indexOf(document.activeElement);
  const beside = cells.findIndex((cell, i) => i > 0 && cell.offsetTop > cells[0].offsetTop);
  const columns = beside < 0 ? cells.length : beside;
  const way = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -columns, ArrowDown: columns }[event.key];
  if (way === undefined || at < 0) return;
  event.preventDefault();
  const next = cells[at + way];
  if (next === undefined) return;
  next.click();
  next.focus();
};

const cellText = (column, value) => (column === "success" ? (value ? "yes" : "no") : String(value));

const fillTable = () => {
  const { artifact } = selection;
  const { rollouts, label } = REPORT.artifacts[artifact];
  const values = rollouts[sorting.column];
  const numbers = filtered(artifact);
  numbers.sort((a, b) => sorting.way * (values[a] - values[b]) || rollouts.seed[a] - rollouts.seed[b]);
  const rows = numbers.map((i) => html("tr", { "data-seed": rollouts.seed[i], "data-rollout": i }, ...COLUMNS.map((column) => {
    const text = cellText(column, rollouts[column][i]);
    const cell = html("td", { class: "figure", "data-column": column, "data-value": rollouts[column][i] });
    if (column !== "seed" || !isShown(artifact, i)) {
      cell.append(text);
      return cell;
    }
    const button = html("button", { type: "button", class: "link", title: "Show in the viewer" }, text);
    button.addEventListener("click", () => {
      selectRollout(artifact, i);
      byId("viewer").scrollIntoView({ block: "start" });
    });
    cell.append(button);
    return cell;
  })));
  byId("seeds").tBodies[0].replaceChildren(...rows);
  byId("seeds-of").textContent = label;
  for (const button of byId("seeds").querySelectorAll("th button")) {
    const sorted = button.dataset.column === sorting.column;
    button.parentNode.setAttribute("aria-sort", sorted ? (sorting.way > 0 ? "ascending" : "descending") : "none");
  }
  markRow();
};

const markRow = () => {
  for (const line of byId("seeds").tBodies[0].rows) line.classList.toggle("selected", Number(line.dataset.rollout) === selection.rollout);
};

const setUpGrid = () => {
  let tableOf = 0;
  const all = () => {
    drawCells();
    fillTable();
  };
  onChoice("filter", all);
  onChoice("order", drawCells);
  for (const host of document.querySelectorAll(".cells")) host.addEventListener("keydown", walkCells);
  for (const button of byId("seeds").querySelectorAll("th button")) {
    button.addEventListener("click", () => {
      const { column } = button.dataset;
      Object.assign(sorting, { column, way: sorting.column === column ? -sorting.way : 1 });
      fillTable();
    });
  }
  listeners.rollout.push(() => {
    markCell();
    if (tableOf !== selection.artifact) fillTable();
    tableOf = selection.artifact;
    markRow();
  });
  all();
};
