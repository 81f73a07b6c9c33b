// The plots of all rollouts.
const UNIT_TICKS = [0, 0.2, 0.4, 0.6, 0.8, 1];
const MEASURES = { score: "scaled score", coverage: "raw coverage", iou: "IoU" };

const markPath = (artifact, x, y, extra, scale = 1) =>
  svg("path", { d: MARKS[markOf(artifact)], transform: `translate(${near(x)} ${near(y)}) scale(${scale})`, ...extra });

const drawBudgets = (host, width) => {
  const measure = checked("budget-measure");
  const maxSteps = Math.max(...REPORT.artifacts.map((artifact) => artifact.max_steps));
  const spacing = [10, 20, 50, 100, 200, 500].find((gap) => maxSteps / gap <= Math.min(6, width / 60)) ?? 1000;
  const ticks = [];
  for (let tick = 0; tick <= maxSteps; tick += spacing) ticks.push([tick, String(tick)]);
  const { root, place } = chartFrame(width, {
    height: 300, left: 36, right: 14, top: 12, bottom: 40,
    y: [0, 1], yTicks: UNIT_TICKS, x: [0, maxSteps], xTicks: ticks, xLabel: "step budget",
    name: `Mean running maximum of the ${MEASURES[measure]} by step budget; the table of budgets below has the values`,
  });
  REPORT.artifacts.forEach(({ curve, label }, number) => {
    const group = svg("g", { class: `series series-${markOf(number)}` });
    group.append(svg("path", { class: "curve", d: line(curve.steps.map((step, i) => [place.x(step), place.y(curve[`${measure}_line`][i])])) }));
    curve.budgets.forEach((budget, i) => {
      const { value, low, high } = curve[measure][i];
      const x = place.x(budget);
      group.append(
        svg("line", { class: "whisker", x1: x, x2: x, y1: place.y(low), y2: place.y(high) }),
        markPath(number, x, place.y(value), { class: "point" }),
        svg("rect", { class: "target", x: x - 10, y: place.y(high) - 8, width: 20, height: place.y(low) - place.y(high) + 16 },
          svg("title", {}, `${label}, ${budget} steps: ${digits(value)} [${digits(low)}, ${digits(high)}]`)),
      );
    });
    root.append(group);
  });
  host.replaceChildren(root);
};

// The marks of all rollouts as [artifact, rollout, position on the x axis]: by rank within the artifact, or by seed over all
// artifacts.
const orderedMarks = (measure, order) => {
  const seeds = new Map();
  if (order === "seed") {
    const all = new Set(REPORT.artifacts.flatMap((artifact) => artifact.rollouts.seed));
    [...all].sort((a, b) => a - b).forEach((seed, i) => seeds.set(seed, i));
  }
  return REPORT.artifacts.flatMap(({ rollouts }, artifact) => {
    const numbers = rollouts.seed.map((_, rollout) => rollout);
    if (order === "seed") return numbers.map((rollout) => [artifact, rollout, seeds.get(rollouts.seed[rollout])]);
    numbers.sort((a, b) => rollouts[measure][a] - rollouts[measure][b] || rollouts.seed[a] - rollouts.seed[b]);
    return numbers.map((rollout, rank) => [artifact, rollout, (rank + 0.5) / numbers.length]);
  });
};

const seedTicks = (marks, width) => {
  const bySeed = new Map(marks.map(([artifact, rollout, x]) => [x, REPORT.artifacts[artifact].rollouts.seed[rollout]]));
  const places = [...bySeed.keys()].sort((a, b) => a - b);
  const count = Math.min(places.length, Math.max(2, Math.floor(width / 90)));
  return Array.from({ length: count }, (_, i) => {
    const x = places[Math.round((i * (places.length - 1)) / Math.max(1, count - 1))];
    return [x, String(bySeed.get(x))];
  });
};

const drawSeeds = (host, width) => {
  const focused = host.contains(document.activeElement);
  const [measure, order] = [checked("measure"), checked("order")];
  const marks = orderedMarks(measure, order);
  const bySeed = order === "seed";
  const last = Math.max(0, ...marks.map(([, , x]) => x));
  const { root, place } = chartFrame(width, {
    height: 300, left: 36, right: 14, top: 12, bottom: 40,
    y: [0, 1], yTicks: UNIT_TICKS,
    x: bySeed ? [-0.5, last + 0.5] : [0, 1],
    xTicks: bySeed ? seedTicks(marks, width) : [[0.005, "minimum"], [0.5, "median"], [0.96, "maximum"]],
    xLabel: bySeed ? "seed" : "fraction of rollouts",
    name: `${titled(MEASURES[measure])} of every rollout; the table of rollouts below has the values. The arrow keys select a rollout.`,
  });
  root.setAttribute("tabindex", "0");
  root.setAttribute("role", "application");
  const maxRollouts = Math.max(...REPORT.artifacts.map(({ rollouts }) => rollouts.seed.length));
  const scale = near(clamp((width - 50) / maxRollouts / 5, 0.55, 1));
  for (const [artifact, rollout, x] of marks) {
    const { rollouts, label, noun } = REPORT.artifacts[artifact];
    const kinds = ["point", rollouts.success[rollout] ? "success" : "failure", isShown(artifact, rollout) ? "" : "absent"];
    const mark = markPath(artifact, place.x(x), place.y(rollouts[measure][rollout]), {
      class: `${kinds.join(" ")} series-${markOf(artifact)}`,
      "data-artifact": artifact, "data-rollout": rollout,
    }, scale);
    const ending = isShown(artifact, rollout) ? "" : " (not in the viewer of this page)";
    mark.append(svg("title", {}, `${label}, ${noun} ${rollouts.seed[rollout]}: ${MEASURES[measure]} ${digits(rollouts[measure][rollout])}${ending}`));
    mark.addEventListener("click", () => selectRollout(artifact, rollout));
    root.append(mark);
  }
  host.replaceChildren(root);
  markSelected();
  if (focused) root.focus();
};

const markSelected = () => {
  const host = byId("seed-plot");
  for (const mark of host.querySelectorAll(".point.selected")) mark.classList.remove("selected");
  const { artifact, rollout } = selection;
  const mark = host.querySelector(`.point[data-artifact="${artifact}"][data-rollout="${rollout}"]`);
  if (mark === null) return;
  mark.classList.add("selected");
  mark.parentNode.append(mark);
};

const walkMarks = (event) => {
  const direction = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (direction === undefined) return;
  event.preventDefault();
  const order = orderedMarks(checked("measure"), checked("order"))
    .filter(([artifact, rollout]) => artifact === selection.artifact && isShown(artifact, rollout))
    .sort((a, b) => a[2] - b[2])
    .map(([, rollout]) => rollout);
  const next = order[order.indexOf(selection.rollout) + direction];
  if (next !== undefined) selectRollout(selection.artifact, next);
};

const setUpOverview = () => {
  byId("scene").append(SCENE.root);
  byId("demo").append(DEMO.root);
  const seeds = byId("seed-plot");
  const budgets = byId("budget-plot");
  const again = (host, draw) => () => draw(host, Math.floor(host.clientWidth));
  onWidth(seeds, (width) => drawSeeds(seeds, width));
  onWidth(budgets, (width) => drawBudgets(budgets, width));
  onChoice("measure", again(seeds, drawSeeds));
  onChoice("order", again(seeds, drawSeeds));
  onChoice("budget-measure", again(budgets, drawBudgets));
  seeds.addEventListener("keydown", walkMarks);
  listeners.rollout.push(markSelected);
};
