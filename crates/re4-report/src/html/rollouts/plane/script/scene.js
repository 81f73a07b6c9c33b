const blockAt = (pose) => `${line(WORLD.outline.map((corner) => carry(pose, corner)))}Z`;

// The workspace as an SVG image: floor, walls and goal, with named layers on top whose content is set for each state.
const plane = (name, layers) => {
  const { side, wall } = WORLD;
  const root = svg("svg", { class: "plane", viewBox: `0 0 ${side} ${side}`, role: "img", "aria-label": name });
  root.append(
    svg("rect", { class: "floor", width: side, height: side }),
    svg("rect", { class: "walls", x: wall, y: wall, width: side - 2 * wall, height: side - 2 * wall }),
  );
  const named = { goal: svg("path", { class: "goal", d: blockAt(WORLD.goal) }) };
  root.append(named.goal);
  for (const [layer, kind] of layers) {
    named[layer] = svg(kind, { class: layer, ...(kind === "circle" ? { r: layer === "pusher" ? WORLD.pusher_radius : 5 } : {}) });
    root.append(named[layer]);
  }
  return { root, named };
};

const setPath = (element, path) => element.setAttribute("d", path);
const setCircle = (element, [x, y]) => {
  element.setAttribute("cx", near(x));
  element.setAttribute("cy", near(y));
};
const setShown = (element, shown) => element.classList.toggle("gone", !shown);

const TRAILS = ["trail plan old", "trail replay old", "trail plan", "trail replay"].map((layer) => [layer, "path"]);
const SCENE = plane("Scene", [
  ...TRAILS, ["before", "path"], ["block", "path"], ["predicted", "path"], ["observed", "path"],
  ["plan-path", "path"], ["chunk", "path"], ["set-point", "circle"], ["pusher", "circle"], ["command", "path"],
]);
const DEMO = plane("Retrieved demonstration", [
  ["block", "path"], ["predicted", "path"], ["chunk", "path"], ["set-point", "circle"], ["pusher", "circle"],
]);

// The estimated pose that the policy observed before its next action, if there is one, and its error.
const estimateAt = (data, step) => {
  const pose = data.observed[step];
  if (!pose) return undefined;
  const truth = data.object[step];
  const distance = Math.hypot(pose[0] - truth[0], pose[1] - truth[1]);
  const angle = Math.abs(wrapAngle(pose[2] - truth[2]));
  return { pose, distance, angle, confidence: data.confidence[step], flag: data.flag[step], differs: distance > 1e-3 || angle > 1e-4 };
};

const drawScene = (data, step, number, chunk) => {
  const decision = data.decisions[number];
  const { root, named } = SCENE;
  const paths = trails(data, step, number);
  for (const [layer] of TRAILS) setPath(named[layer], paths[layer] ?? "");
  const estimate = estimateAt(data, step);
  setPath(named.goal, blockAt(data.goal ?? WORLD.goal));
  setPath(named.block, blockAt(data.object[step]));
  setPath(named.observed, estimate?.differs ? blockAt(estimate.pose) : "");
  setCircle(named.pusher, data.eef[step]);
  setPath(named.command, step < data.length ? cross(data.action[step]) : "");
  setShown(named["set-point"], decision?.detailed === true);
  for (const layer of ["before", "predicted", "plan-path", "chunk"]) setPath(named[layer], "");
  if (!decision?.detailed) return root;
  setPath(named.before, step > decision.step ? blockAt(decision.object) : "");
  setPath(named.predicted, blockAt(decision.predicted));
  setPath(named["plan-path"], decision.path.length > 1 ? line(decision.path) : "");
  const motion = decision.transfer ? [0, 0, 0] : decision.delta;
  setPath(named.chunk, chunk ? arrow(chunk.map(({ eef }) => carry(motion, eef))) : "");
  setCircle(named["set-point"], decision.setPoint);
  return root;
};

const drawDemo = (chunk) => {
  const { root, named } = DEMO;
  root.classList.toggle("gone", chunk === undefined);
  if (chunk === undefined) return;
  const [first, last] = [chunk[0], chunk[chunk.length - 1]];
  setPath(named.block, blockAt(first.object));
  setPath(named.predicted, blockAt(last.object));
  setPath(named.chunk, arrow(chunk.map(({ eef }) => eef)));
  setCircle(named["set-point"], first.eef);
  setCircle(named.pusher, first.eef);
};

const LEGEND = [
  ["block", "block"], ["goal", "goal"], ["pusher", "pusher"],
  ["trail plan", "path so far: plan"], ["trail replay", "path so far: replay"],
  ["plan-path", "plan"], ["chunk", "reframed chunk"], ["predicted", "predicted block after the chunk"],
  ["before", "block at the decision"], ["command", "next command"], ["observed", "estimated block pose"],
];

const legendShape = (layer) => {
  if (["block", "goal", "predicted", "before", "observed"].includes(layer)) {
    return [svg("path", { class: layer, d: "M3 3H21V8H14.5V15H9.5V8H3Z" })];
  }
  if (layer === "pusher") return [svg("circle", { class: layer, cx: 12, cy: 9, r: 6 })];
  if (layer === "command") return [svg("path", { class: layer, d: cross([12, 9]) })];
  return [svg("path", { class: layer, d: layer === "chunk" ? arrow([[1, 9], [8, 9], [22, 9]]) : "M1 9H23" })];
};

const isDrawn = (layer) => layer !== "observed" || REPORT.artifacts.some(({ steps }) => "observed" in steps);
