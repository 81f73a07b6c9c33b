// The scores: the plot of two of them, and the selected demonstration's values and ranks.
const SCORE_ROW = new Map(REPORT.scores.demo.map((demo, row) => [demo, row]));
const scoreColumn = remember((name) => {
  const column = REPORT.scores.columns.find((candidate) => candidate.name === name);
  const at = (values) => (demo) => {
    const row = SCORE_ROW.get(demo);
    return row === undefined ? null : values[row];
  };
  return { ...column, valueOf: at(column.values), rankOf: at(column.ranks) };
});

const scoreTip = (demo) => `${nameOf(demo)}: ${["score-x", "score-y"].map((axis) => scoreColumn(byId(axis).value)).map(({ title, valueOf }) => `${title} ${figure(valueOf(demo))}`).join(", ")}`;

const sayScores = (demo) => {
  byId("score-words").textContent = SCORE_ROW.has(demo) ? scoreTip(demo) : "";
};

const drawScores = () => {
  const host = byId("score-plot");
  const width = host === null ? 0 : Math.floor(host.clientWidth);
  if (width === 0) return;
  const columns = [scoreColumn(byId("score-x").value), scoreColumn(byId("score-y").value)];
  const demos = REPORT.scores.demo.filter((demo) => columns.every(({ valueOf }) => valueOf(demo) !== null));
  const ranges = columns.map(({ valueOf }) => {
    const values = demos.map(valueOf);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const room = 0.05 * (high - low || Math.abs(high) || 1);
    return [low - room, high + room];
  });
  const frame = { height: 380, left: 62, right: 14, top: 12, bottom: 44 };
  const x = (value) => frame.left + ((value - ranges[0][0]) / (ranges[0][1] - ranges[0][0])) * (width - frame.left - frame.right);
  const y = (value) => frame.height - frame.bottom - ((value - ranges[1][0]) / (ranges[1][1] - ranges[1][0])) * (frame.height - frame.top - frame.bottom);
  const root = svg("svg", { class: "chart", width, height: frame.height, viewBox: `0 0 ${width} ${frame.height}`, role: "img", "aria-label": `${columns[1].title} against ${columns[0].title} of ${counted(demos.length, "demonstration")}` });
  for (const tick of niceTicks(...ranges[0], 6)) {
    root.append(svg("line", { class: "grid", x1: x(tick), x2: x(tick), y1: frame.top, y2: frame.height - frame.bottom }), svg("text", { class: "tick", x: x(tick), y: frame.height - frame.bottom + 16, "text-anchor": "middle" }, figure(tick)));
  }
  for (const tick of niceTicks(...ranges[1], 5)) {
    root.append(svg("line", { class: "grid", x1: frame.left, x2: width - frame.right, y1: y(tick), y2: y(tick) }), svg("text", { class: "tick", x: frame.left - 6, y: y(tick) + 4, "text-anchor": "end" }, figure(tick)));
  }
  root.append(svg("text", { class: "axis", x: width - frame.right, y: frame.height - 8, "text-anchor": "end" }, columns[0].title), svg("text", { class: "axis", x: frame.left, y: frame.top - 1 }, columns[1].title));
  // The selected demonstration comes last, on top.
  const order = [...demos].sort((a, b) => Number(a === selection.demo) - Number(b === selection.demo) || a - b);
  for (const demo of order) {
    const mark = svg("circle", { class: `score${keep.has(demo) ? "" : " dropped"}${demo === selection.demo ? " chosen" : ""}`, "data-demo": nameOf(demo), cx: near(x(columns[0].valueOf(demo))), cy: near(y(columns[1].valueOf(demo))), r: demo === selection.demo ? 6 : 4 });
    mark.addEventListener("click", () => selectDemo(demo));
    mark.addEventListener("pointerenter", () => sayScores(demo));
    mark.addEventListener("pointerleave", () => sayScores(selection.demo));
    root.append(mark);
  }
  host.replaceChildren(root);
  sayScores(selection.demo);
};

const showScores = () => {
  if (!SCORE_ROW.has(selection.demo)) {
    byId("evidence-scores").textContent = "";
    return;
  }
  const total = REPORT.scores.demo.length;
  const words = REPORT.scores.columns.map(({ name }) => scoreColumn(name)).filter(({ valueOf }) => valueOf(selection.demo) !== null);
  byId("evidence-scores").replaceChildren(`Scores, with rank of ${total}: `, ...words.flatMap(({ title, valueOf, rankOf }, i) => [i > 0 ? " · " : "", html("span", { class: "score-word" }, `${title} `, html("b", {}, figure(valueOf(selection.demo))), ` (${figure(rankOf(selection.demo))})`)]));
};

const setUpScores = () => {
  listeners.demo.push(showScores);
  if (REPORT.scores.demo.length === 0) return;
  for (const axis of ["score-x", "score-y"]) byId(axis).addEventListener("change", drawScores);
  onWidth(byId("score-plot"), drawScores);
  listeners.demo.push(drawScores);
  listeners.keep.push(drawScores);
};
