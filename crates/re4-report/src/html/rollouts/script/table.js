// The table of the selected artifact's rollouts. The scene's script defines numbersOf, which returns the rollouts to list.
const sorting = { column: "seed", sign: 1 };
const sorters = [...byId("seeds").querySelectorAll("th button")];

const cellText = (column, value, precise) => {
  if (column === "success") return value ? "yes" : "no";
  // Four decimals, because a coverage of 0.9496 is not a success and must not be rounded to 0.95.
  return precise ? digits(value, 4) : String(value);
};

const tableCell = ({ column, precise }, value, artifact, rollout) => {
  const cell = html("td", { class: "figure", "data-column": column, "data-value": value });
  const text = cellText(column, value, precise !== undefined);
  if (column === "seed" && isShown(artifact, rollout)) {
    const button = html("button", { type: "button", class: "link", title: "Show in the viewer" }, text);
    button.addEventListener("click", () => {
      selectRollout(artifact, rollout);
      byId("viewer").scrollIntoView({ block: "start" });
    });
    cell.append(button);
  } else {
    cell.append(text);
  }
  return cell;
};

const fillTable = () => {
  const { artifact } = selection;
  const { rollouts, label, noun } = REPORT.artifacts[artifact];
  const values = rollouts[sorting.column];
  const numbers = numbersOf(artifact);
  numbers.sort((a, b) => sorting.sign * (values[a] - values[b]) || rollouts.seed[a] - rollouts.seed[b]);
  const rows = numbers.map((rollout) => html("tr", { "data-seed": rollouts.seed[rollout], "data-rollout": rollout },
    ...sorters.map(({ dataset }) => tableCell(dataset, rollouts[dataset.column][rollout], artifact, rollout))));
  byId("seeds").tBodies[0].replaceChildren(...rows);
  byId("seeds-of").textContent = label;
  for (const button of sorters) {
    if (button.dataset.column === "seed") button.textContent = titled(noun);
    const sorted = button.dataset.column === sorting.column;
    button.parentNode.setAttribute("aria-sort", sorted ? (sorting.sign > 0 ? "ascending" : "descending") : "none");
  }
  markRow();
};

const markRow = () => {
  for (const line of byId("seeds").tBodies[0].rows) line.classList.toggle("selected", Number(line.dataset.rollout) === selection.rollout);
};

const setUpTable = () => {
  let tableOf = selection.artifact;
  for (const button of sorters) {
    button.addEventListener("click", () => {
      const { column } = button.dataset;
      Object.assign(sorting, { column, sign: sorting.column === column ? -sorting.sign : 1 });
      fillTable();
    });
  }
  listeners.rollout.push(() => {
    if (tableOf !== selection.artifact) fillTable();
    tableOf = selection.artifact;
    markRow();
  });
  fillTable();
};
