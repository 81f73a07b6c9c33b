// The scene from above and, below it, from behind the robot. The y axis points left in both views, so that a point has the same
// horizontal position in both. In the upper view, x points up, away from the robot.
const VIEW = { width: 620, gap: 26, pad: 12, maxAspect: 1.25 };
const TOP = ([x, y]) => [-y, -x];
const BACK = ([, y, z]) => [-y, -z];

// The bounds of both views: they contain everything that moves in any rollout of the artifact, and the object's goal.
const boundsOf = remember((number) => {
  const artifact = REPORT.artifacts[number];
  const { starts, steps } = traces(number);
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  const add = (values, at) => {
    for (let k = 0; k < 3; k += 1) {
      low[k] = Math.min(low[k], values[at + k]);
      high[k] = Math.max(high[k], values[at + k]);
    }
  };
  for (let i = 0; i < starts.length; i += 7) add(starts, i);
  for (let i = 0; i < steps.eef.length; i += 7) {
    add(steps.eef, i);
    add(steps.object, i);
  }
  for (const { kind, centre, half } of artifact.fixtures) {
    if (kind !== "goal") continue;
    add(centre.map((value, k) => value - half[k]), 0);
    add(centre.map((value, k) => value + half[k]), 0);
  }
  // The margin also keeps the views from being empty if nothing moves along an axis.
  const margin = [0.05, 0.05, 0.04];
  return { low: low.map((value, k) => value - margin[k]), high: high.map((value, k) => value + margin[k]) };
});

// The scale and the positions of both views, in units of the image.
const planOf = remember((number) => {
  const { low, high } = boundsOf(number);
  const size = high.map((value, k) => value - low[k]);
  const wide = Math.max(size[1], (size[0] + size[2]) / VIEW.maxAspect);
  const scale = (VIEW.width - 2 * VIEW.pad) / wide;
  const left = VIEW.width / 2 + (scale * (low[1] + high[1])) / 2;
  const above = { top: VIEW.pad, height: scale * size[0] };
  const behind = { top: VIEW.pad + above.height + VIEW.gap, height: scale * size[2] };
  const topAt = above.top + scale * high[0];
  const backAt = behind.top + scale * high[2];
  return {
    scale, above, behind,
    height: behind.top + behind.height + VIEW.pad,
    views: [
      (point) => [left + scale * TOP(point)[0], topAt + scale * TOP(point)[1]],
      (point) => [left + scale * BACK(point)[0], backAt + scale * BACK(point)[1]],
    ],
  };
});

// The convex hull of points in the plane (Andrew's monotone chain).
const hull = (points) => {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const crossProduct = (o, a, b) => (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
  const half = (from) => {
    const side = [];
    for (const point of from) {
      while (side.length > 1 && crossProduct(side[side.length - 2], side[side.length - 1], point) <= 0) side.pop();
      side.push(point);
    }
    return side.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
};

const ROUND = Array.from({ length: 20 }, (_, i) => [Math.cos((i * Math.PI) / 10), Math.sin((i * Math.PI) / 10)]);
const CORNERS = [[-1, -1], [1, -1], [1, 1], [-1, 1]];
const outline = ({ centre, half, round }) =>
  (round ? ROUND : CORNERS).flatMap(([a, b]) => [-1, 1].map((c) => [centre[0] + a * half[0], centre[1] + b * half[1], centre[2] + c * half[2]]));

const solidAt = (solids, pose, view) =>
  solids.map((solid) => `${line(hull(outline(solid).map((point) => view(pose ? placed(pose, point) : point))))}Z`).join("");

const LAYERS = [
  ["trail bridge old", "path"], ["trail replay old", "path"], ["trail home old", "path"],
  ["object-trail", "path"], ["trail bridge", "path"], ["trail replay", "path"], ["trail home", "path"],
  ["recorded", "path"], ["delta", "path"], ["seen", "path"], ["object", "path"],
  ["axis x", "path"], ["axis y", "path"], ["axis z", "path"],
  ["chunk", "path"], ["set-point", "path"], ["fingers", "path"], ["command", "path"],
];

let scene;
const setUpScene = (number) => {
  const { fixtures } = REPORT.artifacts[number];
  const { above, behind, height, views } = planOf(number);
  const root = svg("svg", { class: "plane", viewBox: `0 0 ${VIEW.width} ${near(height)}`, role: "img", "aria-label": "Scene" });
  const names = ["from above", "from behind the robot"];
  const groups = [above, behind].map(({ top, height: tall }, k) => {
    const id = `view-${k}`;
    root.append(svg("clipPath", { id }, svg("rect", { x: 0, y: near(top), width: VIEW.width, height: near(tall), rx: 8 })));
    const group = svg("g", { "clip-path": `url(#${id})` }, svg("rect", { class: "floor", x: 0, y: near(top), width: VIEW.width, height: near(tall) }));
    for (const order of ["table", "wall", "goal"]) {
      for (const solid of fixtures) if (solid.kind === order) group.append(svg("path", { class: `fixture ${order}`, d: solidAt([solid], undefined, views[k]) }));
    }
    const named = {};
    for (const [layer, kind] of LAYERS) {
      named[layer] = svg(kind, { class: layer });
      group.append(named[layer]);
    }
    root.append(group, svg("text", { class: "view-name", x: 10, y: near(top + 18) }, names[k]));
    return named;
  });
  scene = { number, root, groups, ruler: drawRuler(root, number) };
  byId("scene").replaceChildren(root);
};

const drawRuler = (root, number) => {
  const { scale, height } = planOf(number);
  const [x, y] = [VIEW.width - 14, height - 18];
  root.append(
    svg("path", { class: "ruler", d: `M${near(x - 0.1 * scale)} ${near(y)}H${x}M${near(x - 0.1 * scale)} ${near(y - 4)}v8M${x} ${near(y - 4)}v8` }),
    svg("text", { class: "view-name", x: near(x - 0.05 * scale), y: near(y - 7), "text-anchor": "middle" }, "10 cm"),
  );
};

const ring = ([x, y], r = 5) => `M${near(x - r)} ${near(y)}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0Z`;

// The gripper: its fingers move along the x axis of the grip site and point along its z axis.
const fingersAt = (pose, apart, view) => {
  const half = Number.isFinite(apart) ? apart / 2 : 0.04;
  const at = (x, z) => view(placed(pose, [x, 0, z]));
  const finger = (x) => line([at(x, -0.05), at(x, 0.01)]);
  return `${finger(half)}${finger(-half)}${line([at(half, -0.05), at(-half, -0.05)])}${line([at(0, -0.05), at(0, -0.09)])}`;
};

const drawScene = (data, step, number, chunk) => {
  if (scene?.number !== data.artifact) setUpScene(data.artifact);
  const { object } = REPORT.artifacts[data.artifact];
  const { views } = planOf(data.artifact);
  const decision = data.decisions[number];
  scene.groups.forEach((named, k) => {
    const view = views[k];
    const paths = trails(data, step, number, view);
    const pose = data.object[step];
    paths.object = solidAt(object, pose, view);
    paths["object-trail"] = line(data.object.slice(0, step + 1).map((at) => view(at)));
    ["x", "y", "z"].forEach((axis, i) => {
      paths[`axis ${axis}`] = line([view(pose), view(placed(pose, [0, 1, 2].map((j) => (i === j ? 0.045 : 0))))]);
    });
    paths.fingers = fingersAt(data.eef[step], data.fingers[step], view);
    paths.command = step < data.length ? cross(view(data.goal[step])) : "";
    paths.seen = data.seen?.[step]?.every(Number.isFinite) ? solidAt(object, data.seen[step], view) : "";
    paths["set-point"] = decision?.detailed ? ring(view(decision.setPoint)) : "";
    // In transit, the chunk is reframed to the observed object; in transfer, it is replayed where it was recorded.
    const carried = decision?.detailed && chunk?.map(({ eef }) => view(decision.transfer ? eef : moved(decision.delta, eef)));
    paths.chunk = carried && carried.length > 0 ? arrow(carried) : "";
    paths.recorded = chunk ? solidAt(object, chunk[0].object, view) : "";
    paths.delta = chunk && apart(chunk[0].object, decision.object) > 0.004 ? arrow([view(chunk[0].object), view(decision.object)]) : "";
    for (const [layer] of LAYERS) named[layer].setAttribute("d", paths[layer] ?? "");
    for (const layer of ["chunk", "recorded", "delta"]) named[layer].setAttribute("style", decision?.demo === undefined ? "" : demoStyle(decision.demo));
  });
  return scene.root;
};

const LEGEND = [
  ["object", "object"], ["axis", "axes of the object"], ["goal", "goal"], ["fingers", "gripper"],
  ["trail bridge", "path so far: bridge"], ["trail replay", "path so far: replay"], ["trail home", "path so far: home"], ["object-trail", "path of the object"],
  ["chunk", "reframed demonstration"], ["recorded", "recorded object, and δ"], ["set-point", "set point"], ["command", "next command"],
  ["seen", "observed object pose"],
];

const legendShape = (layer) => {
  const box = "M4 3H20V15H4Z";
  const shapes = {
    object: box, goal: box, recorded: box, seen: box,
    fingers: "M6 16V8H18V16M12 8V2", "set-point": ring([12, 9]), command: cross([12, 9]), chunk: arrow([[1, 9], [8, 9], [22, 9]]),
  };
  if (layer === "axis") return [["x", "M4 14H14"], ["y", "M4 14L11 7"], ["z", "M4 14V3"]].map(([axis, d]) => svg("path", { class: `axis ${axis}`, d }));
  return [svg("path", { class: layer === "goal" ? "fixture goal" : layer, d: shapes[layer] ?? "M1 9H23", style: layer === "chunk" || layer === "recorded" ? demoStyle(0) : null })];
};

const isDrawn = (layer) => layer !== "seen" || REPORT.artifacts.some(({ steps }) => "seen" in steps);
