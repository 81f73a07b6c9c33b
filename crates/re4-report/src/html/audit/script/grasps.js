// Plots of the grasps in the object's frame from several sides, and histograms of the lengths of segments.
const AXES = { x: 0, y: 1, z: 2 };
const OUTCOME_MARKS = {
  held: "M-3.6 0A3.6 3.6 0 1 0 3.6 0A3.6 3.6 0 1 0 -3.6 0Z",
  missed: "M-4.4 -3L-3 -4.4L0 -1.4L3 -4.4L4.4 -3L1.4 0L4.4 3L3 4.4L0 1.4L-3 4.4L-4.4 3L-1.4 0Z",
  lost: "M0 4.6L4.6 -3.6H-4.6Z",
  brief: "M-3.2 -3.2H3.2V3.2H-3.2Z",
};
const OUTCOME_WORDS = { held: "held", missed: "missed: closed on nothing", lost: "lost: slipped out", brief: "brief: too short to be judged", "": "contact begins" };
const outcomeOf = (outcome) => (outcome in OUTCOME_MARKS ? outcome : "held");
const OUTCOME_PATHS = Object.fromEntries(Object.entries(OUTCOME_MARKS).map(([name, path]) => [name, new Path2D(path)]));
// The order of drawing: rare outcomes come last, so that they are on top.
const OUTCOME_ORDER = ["", "held", "brief", "lost", "missed"];

// The mapping from object coordinates, in the unit of the page, to the canvas. Both axes have the same scale.
const graspScale = (canvas, width, height) => {
  const [across, up] = [...canvas.dataset.axes].map((axis) => AXES[axis]);
  const points = GRASPS.map(({ position }) => [position[across] * LENGTH.factor, position[up] * LENGTH.factor]);
  const outline = (REPORT.outline ?? []).map(([x, y]) => [x * LENGTH.factor, y * LENGTH.factor]);
  // The plot always contains the origin.
  const all = [...points, ...outline, [0, 0]].filter((point) => point.every(Number.isFinite));
  const minimum = (axis) => all.reduce((low, point) => Math.min(low, point[axis]), Infinity);
  const maximum = (axis) => all.reduce((high, point) => Math.max(high, point[axis]), -Infinity);
  const box = { left: 40, right: 14, top: 12, bottom: 34 };
  const middle = [(minimum(0) + maximum(0)) / 2, (minimum(1) + maximum(1)) / 2];
  const span = [maximum(0) - minimum(0) || 1, maximum(1) - minimum(1) || 1];
  const scale = 0.94 * Math.min((width - box.left - box.right) / span[0], (height - box.top - box.bottom) / span[1]);
  const centre = [(box.left + width - box.right) / 2, (box.top + height - box.bottom) / 2];
  // Push-T's y axis points down, as in images; elsewhere the vertical axis points up.
  const sign = REPORT.outline === null ? -1 : 1;
  return {
    box, points, outline, axes: canvas.dataset.axes,
    x: (value) => centre[0] + (value - middle[0]) * scale,
    y: (value) => centre[1] + sign * (value - middle[1]) * scale,
    low: (axis) => middle[axis] - (axis === 0 ? width : height) / scale / 2,
    high: (axis) => middle[axis] + (axis === 0 ? width : height) / scale / 2,
  };
};

const graspViews = new Map();

const drawGraspFrame = (context, place, width, height) => {
  const { box, axes } = place;
  context.font = `11.5px ${getComputedStyle(document.body).fontFamily}`;
  context.lineWidth = 1;
  context.strokeStyle = COLOURS.hair;
  context.fillStyle = COLOURS.faint;
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const tick of niceTicks(place.low(0), place.high(0), 5)) {
    const x = place.x(tick);
    if (x < box.left || x > width - box.right) continue;
    context.fillRect(Math.round(x), height - box.bottom, 1, 4);
    context.fillText(figure(tick, 3), x, height - box.bottom + 7);
  }
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const tick of niceTicks(place.low(1), place.high(1), 5)) {
    const y = place.y(tick);
    if (y < box.top || y > height - box.bottom) continue;
    context.fillRect(box.left - 4, Math.round(y), 4, 1);
    context.fillText(figure(tick, 3), box.left - 8, y);
  }
  context.strokeRect(box.left + 0.5, box.top + 0.5, width - box.left - box.right, height - box.top - box.bottom);
  context.fillStyle = COLOURS.soft;
  context.textAlign = "right";
  context.textBaseline = "bottom";
  context.fillText(`${axes[0]}, ${LENGTH.unit}`, width - box.right, height - 1);
  context.textAlign = "left";
  context.textBaseline = "top";
  context.fillText(`${axes[1]}, ${LENGTH.unit}`, box.left + 6, box.top + 5);
};

const drawGrasps = (canvas) => {
  const width = Math.floor(canvas.parentElement.clientWidth - 36);
  if (width <= 0) return;
  const height = Math.round(clamp(width * 0.86, 220, 420));
  const context = fitCanvas(canvas, width, height);
  context.clearRect(0, 0, width, height);
  const place = graspScale(canvas, width, height);
  graspViews.set(canvas, place);
  drawGraspFrame(context, place, width, height);
  if (place.outline.length > 0) {
    context.beginPath();
    for (const [x, y] of place.outline) context.lineTo(place.x(x), place.y(y));
    context.closePath();
    context.fillStyle = COLOURS.floor;
    context.fill();
    context.strokeStyle = COLOURS["block-line"];
    context.stroke();
  }
  context.strokeStyle = COLOURS.soft;
  context.beginPath();
  context.moveTo(place.x(0) - 7, place.y(0));
  context.lineTo(place.x(0) + 7, place.y(0));
  context.moveTo(place.x(0), place.y(0) - 7);
  context.lineTo(place.x(0), place.y(0) + 7);
  context.stroke();
  const inOrder = GRASPS.map((_, i) => i).sort((a, b) => OUTCOME_ORDER.indexOf(GRASPS[a].outcome) - OUTCOME_ORDER.indexOf(GRASPS[b].outcome) || a - b);
  const mark = (i, chosen) => {
    const [x, y] = place.points[i];
    const outcome = outcomeOf(GRASPS[i].outcome);
    context.save();
    context.translate(place.x(x), place.y(y));
    if (chosen) context.scale(1.7, 1.7);
    if (chosen) {
      context.lineJoin = "round";
      for (const [colour, wide] of [[COLOURS.card, 5], [COLOURS.ink, 2.6]]) {
        context.strokeStyle = colour;
        context.lineWidth = wide;
        context.stroke(OUTCOME_PATHS[outcome]);
      }
    }
    context.fillStyle = COLOURS[outcome];
    context.globalAlpha = chosen ? 1 : outcome === "held" ? 0.45 : 0.9;
    context.fill(OUTCOME_PATHS[outcome]);
    context.restore();
  };
  inOrder.filter((i) => GRASPS[i].demo !== selection.demo).forEach((i) => mark(i, false));
  inOrder.filter((i) => GRASPS[i].demo === selection.demo).forEach((i) => mark(i, true));
  canvas.dataset.marks = GRASPS.length;
};

const drawAllGrasps = () => {
  document.querySelectorAll("canvas.grasps").forEach(drawGrasps);
  const own = selection.demo < 0 ? [] : GRASPS_OF[selection.demo];
  for (const words of document.querySelectorAll(".grasp-words")) {
    words.textContent = own.length === 0 ? "" : `large marks: ${nameOf(selection.demo)}${own[0].outcome ? `, ${own.map(({ outcome }) => outcome).join(", ")}` : ""}`;
  }
};

const graspAt = (canvas, event) => {
  const place = graspViews.get(canvas);
  const box = canvas.getBoundingClientRect();
  const [x, y] = [event.clientX - box.left, event.clientY - box.top];
  let best = null;
  place?.points.forEach(([u, v], i) => {
    const away = Math.hypot(place.x(u) - x, place.y(v) - y);
    if (away <= 9 && (best === null || away <= best.away)) best = { i, away };
  });
  return best === null ? undefined : GRASPS[best.i];
};

const selectGrasp = (grasp) => {
  const frames = DEMOS.frames[grasp.demo];
  selectDemo(grasp.demo, { range: [Math.max(0, grasp.first - 12), Math.min(frames, grasp.end + 12)] });
};

const setUpGraspCanvas = (canvas) => {
  canvas.addEventListener("pointermove", (event) => {
    const grasp = graspAt(canvas, event);
    canvas.style.cursor = grasp ? "pointer" : "";
    canvas.title = grasp ? `${nameOf(grasp.demo)}, ${spanWords(grasp)}${grasp.outcome ? `: ${grasp.outcome}` : ""}` : "";
  });
  canvas.addEventListener("click", (event) => {
    const grasp = graspAt(canvas, event);
    if (grasp !== undefined) selectGrasp(grasp);
  });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (steps === undefined) return;
    event.preventDefault();
    const from = GRASPS.findIndex(({ demo, first }) => demo === selection.demo && (selection.range === null || first >= selection.range[0]));
    selectGrasp(GRASPS[clamp((from < 0 ? 0 : from) + steps, 0, GRASPS.length - 1)]);
  });
  onWidth(canvas.parentElement, () => drawGrasps(canvas));
};

const showGraspLegend = () => {
  const counts = new Map();
  for (const { outcome } of GRASPS) counts.set(outcome, (counts.get(outcome) ?? 0) + 1);
  const known = OUTCOME_ORDER.filter((outcome) => counts.has(outcome));
  const other = [...counts.keys()].filter((outcome) => !OUTCOME_ORDER.includes(outcome)).sort();
  byId("grasp-legend").replaceChildren(...[...known, ...other].map((outcome) => html("li", { "data-outcome": outcome, "data-count": counts.get(outcome) },
    svg("svg", { class: `outcome-mark ${outcomeOf(outcome)}`, viewBox: "-6 -6 12 12", width: 13, height: 13, "aria-hidden": "true" }, svg("path", { d: OUTCOME_MARKS[outcomeOf(outcome)] })),
    `${OUTCOME_WORDS[outcome] ?? outcome} (${counts.get(outcome)})`)));
};

const drawHistogram = (host, width) => {
  const transfer = host.dataset.mode === "transfer";
  const lengths = SEGMENTS.filter((segment) => (segment.transfer === 1) === transfer).map(({ first, end }) => end - first);
  if (lengths.length === 0) {
    host.replaceChildren(html("p", { class: "none" }, `There are no ${host.dataset.mode} segments.`));
    return;
  }
  const longest = lengths.reduce((high, length) => Math.max(high, length), 1);
  const gap = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((size) => longest / size <= Math.min(40, width / 12)) ?? 1000;
  const bins = new Array(Math.floor(longest / gap) + 1).fill(0);
  for (const length of lengths) bins[Math.floor(length / gap)] += 1;
  const high = Math.max(1, ...bins);
  const ticks = [];
  const spacing = tickGap(bins.length * gap, width - 60);
  for (let tick = 0; tick <= bins.length * gap; tick += spacing) ticks.push([tick, String(tick)]);
  const { root, place } = chartFrame(width, {
    height: 190, left: 36, right: 14, top: 14, bottom: 40,
    y: [0, high], yTicks: [], x: [0, bins.length * gap], xTicks: ticks, xLabel: `frames, ${gap} per bar`,
    name: `Lengths of ${counted(lengths.length, `${host.dataset.mode} segment`)}, 1 to ${longest} frames`,
  });
  for (const tick of niceTicks(0, high, 4).filter(Number.isInteger)) {
    root.append(svg("line", { class: "grid", x1: 36, x2: width - 14, y1: place.y(tick), y2: place.y(tick) }), svg("text", { class: "tick", x: 30, y: place.y(tick) + 4, "text-anchor": "end" }, String(tick)));
  }
  bins.forEach((count, bin) => {
    if (count === 0) return;
    const [x, wide] = [place.x(bin * gap), place.x(gap) - place.x(0)];
    root.append(svg("rect", { class: `bin ${host.dataset.mode}`, x: near(x + 0.5), y: near(place.y(count)), width: near(Math.max(1, wide - 1)), height: near(place.y(0) - place.y(count)) },
      svg("title", {}, `${gap === 1 ? bin : `${bin * gap} to ${(bin + 1) * gap - 1}`} frames: ${counted(count, "segment")}`)));
  });
  // The segments of the selected demonstration.
  for (const { first, end } of SEGMENTS_OF[selection.demo]?.filter((segment) => (segment.transfer === 1) === transfer) ?? []) {
    root.append(svg("path", { class: "own", d: "M0 0L4 -6H-4Z", transform: `translate(${near(place.x(end - first + (gap > 1 ? 0 : 0.5)))} ${place.y(0) + 8})` }));
  }
  host.replaceChildren(root);
};

const drawHistograms = () => {
  for (const host of document.querySelectorAll(".histogram")) {
    if (host.clientWidth > 0) drawHistogram(host, Math.floor(host.clientWidth));
  }
};

const setUpGrasps = () => {
  showGraspLegend();
  document.querySelectorAll("canvas.grasps").forEach(setUpGraspCanvas);
  for (const host of document.querySelectorAll(".histogram")) onWidth(host, (width) => drawHistogram(host, width));
  listeners.demo.push(drawAllGrasps, drawHistograms);
};
