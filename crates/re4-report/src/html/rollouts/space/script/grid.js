// The grid with one cell per rollout. Its filter also applies to the table of rollouts.
const FILTERS = {
  all: () => true,
  failure: ({ success }, i) => !success[i],
  lost: ({ losses }, i) => losses[i] > 0,
  several: ({ demos }, i) => demos[i] > 1,
};

const numbersOf = (artifact) => {
  const { rollouts } = REPORT.artifacts[artifact];
  const keep = FILTERS[checked("filter")];
  return rollouts.seed.map((_, i) => i).filter((i) => keep(rollouts, i));
};

const ordered = (artifact) => {
  const { rollouts } = REPORT.artifacts[artifact];
  const numbers = numbersOf(artifact);
  if (checked("order") === "steps") {
    // Failures come last, regardless of their number of steps.
    const rank = (i) => (rollouts.success[i] ? 0 : 1e9) + rollouts.steps[i];
    numbers.sort((a, b) => rank(a) - rank(b) || rollouts.seed[a] - rollouts.seed[b]);
  } else {
    numbers.sort((a, b) => rollouts.seed[a] - rollouts.seed[b]);
  }
  return numbers;
};

const inWords = ({ rollouts, label }, i) =>
  `${label}, seed ${rollouts.seed[i]}: ${rollouts.success[i] ? "succeeded" : "failed"} after ${counted(rollouts.steps[i], "step")}, ` +
  `${counted(rollouts.demos[i], "demonstration")} followed, grasp lost ${counted(rollouts.losses[i], "time")}`;

// Bars are relative to the longest rollout of all artifacts.
const LONGEST = Math.max(1, ...REPORT.artifacts.flatMap(({ rollouts }) => rollouts.steps));

const cellOf = (number, i) => {
  const artifact = REPORT.artifacts[number];
  const { rollouts } = artifact;
  const kinds = ["cell", rollouts.success[i] ? "success" : "failure", rollouts.losses[i] > 0 ? "lost" : "", `series-${markOf(number)}`];
  const words = inWords(artifact, i) + (isShown(number, i) ? "" : " (not in the viewer of this page)");
  const height = Math.max(6, (100 * rollouts.steps[i]) / LONGEST);
  const cell = html("button", { type: "button", class: kinds.join(" "), title: words, "aria-label": words, tabindex: -1, "data-rollout": i },
    html("i", { style: `--height:${near(height)}%` }));
  cell.disabled = !isShown(number, i);
  cell.addEventListener("click", () => selectRollout(number, i));
  return cell;
};

const drawCells = () => {
  for (const host of document.querySelectorAll(".cells")) {
    const number = Number(host.dataset.artifact);
    const numbers = ordered(number);
    host.replaceChildren(...numbers.map((i) => cellOf(number, i)));
    if (numbers.length === 0) host.append(html("p", { class: "hint" }, "No rollouts."));
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
  // The number of columns depends on the width of the page: the first cell of the second row is lower than the first cell.
  const secondRow = cells.findIndex((cell, i) => i > 0 && cell.offsetTop > cells[0].offsetTop);
  const columns = secondRow < 0 ? cells.length : secondRow;
  const offset = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -columns, ArrowDown: columns }[event.key];
  if (offset === undefined || at < 0) return;
  event.preventDefault();
  const next = cells[at + offset];
  if (next === undefined) return;
  next.click();
  next.focus();
};

const setUpOverview = () => {
  onChoice("filter", () => {
    drawCells();
    fillTable();
  });
  onChoice("order", drawCells);
  for (const host of document.querySelectorAll(".cells")) host.addEventListener("keydown", walkCells);
  listeners.rollout.push(markCell);
  drawCells();
};
