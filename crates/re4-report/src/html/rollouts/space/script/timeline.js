// The timeline of retrieved demonstrations (paper, Figure 2): one band per run of steps with the same demonstration; below it the
// phase, the mode and the gripper command of each step, the finger separation and the height of the object.
const PARTS = { label: 15, band: 30, thin: 9, plot: 58 };
const PLACE = (() => {
  let y = 0;
  const next = (height, gap) => {
    const top = y;
    y += height + gap;
    return top;
  };
  const places = {};
  for (const [name, height, gap] of [
    ["demosLabel", PARTS.label, 12], ["demos", PARTS.band, 3], ["phase", PARTS.thin, 2], ["mode", PARTS.thin, 2], ["gripper", PARTS.thin, 14],
    ["fingersLabel", PARTS.label, 2], ["fingers", PARTS.plot, 12], ["heightLabel", PARTS.label, 2], ["height", PARTS.plot, 4], ["ticks", 16, 0],
  ]) places[name] = next(height, gap);
  return { ...places, end: y };
})();
const TIMELINE = {
  pad: 10,
  height: PLACE.end,
  playhead: [PLACE.demos - 3, PLACE.ticks],
  name: "Demonstrations followed over the steps, with phases, modes and gripper commands; below, the finger separation and the height of the object",
};
// The height above the top of the table, or above the floor of the bins, in m.
const heightOf = (artifact, z) => {
  const { centre, half } = REPORT.artifacts[artifact].fixtures.find(({ kind }) => kind === "table");
  return z - centre[2] - half[2];
};

const legendOf = (y, parts) => {
  const text = svg("text", { class: "tick", x: TIMELINE.pad, y: y + 11 });
  for (const [kind, words] of parts) text.append(svg("tspan", { class: kind }, words));
  return text;
};

const bands = (data, x) => {
  const group = svg("g", {});
  const rect = (run, y, height, kind, title, style) => {
    const width = Math.max(0.75, x(run.end) - x(run.start) - 0.5);
    group.append(svg("rect", { class: kind, x: near(x(run.start)), y, width: near(width), height, style }, svg("title", {}, title)));
    return width;
  };
  const span = (run) => `steps ${run.start} to ${run.end}`;
  for (const run of runs(data, (i) => data.decisions[data.decisionOf[i]]?.demo)) {
    const home = run.value === undefined;
    const { name } = data.decisions[data.decisionOf[run.start]] ?? {};
    const words = home ? "return to the initial pose" : name;
    const width = rect(run, PLACE.demos, PARTS.band, home ? "demo none" : "demo", `${words}, ${span(run)}`, home ? null : demoStyle(run.value));
    const label = home ? "home" : name;
    if (width > 7.5 * label.length + 8) {
      group.append(svg("text", { class: "demo-label", x: near(x(run.start) + 5), y: PLACE.demos + 20 }, label));
    }
  }
  for (const run of runs(data, (i) => data.phase[i])) rect(run, PLACE.phase, PARTS.thin, `phase ${run.value}`, `${run.value}, ${span(run)}`);
  for (const run of runs(data, (i) => data.decisions[data.decisionOf[i]]?.transfer)) {
    rect(run, PLACE.mode, PARTS.thin, run.value ? "mode transfer" : "mode transit", `${run.value ? "transfer" : "transit"}, ${span(run)}`);
  }
  for (const run of runs(data, (i) => data.closing[i])) {
    rect(run, PLACE.gripper, PARTS.thin, run.value ? "grip closing" : "grip opening", `gripper commanded to ${run.value ? "close" : "open"}, ${span(run)}`);
  }
  data.decisions.forEach(({ step, kind }, number) => {
    const at = near(x(step));
    const strong = kind !== "continue";
    group.append(svg("path", { class: `decision ${kind}`, d: strong ? `M${at} ${PLACE.demos - 2}V${PLACE.gripper + PARTS.thin}` : `M${at} ${PLACE.demos + PARTS.band - 7}v7` },
      svg("title", {}, `decision ${number + 1}: ${KINDS[kind] ?? kind}`)));
    if (kind === "grasp_lost") group.append(svg("path", { class: "loss", d: `M${near(at - 4)} ${PLACE.demos - 9}l8 8m-8 0l8 -8` }));
  });
  return group;
};

const curve = (values, [low, high], top, x, kind, width, unit) => {
  const y = (value) => top + PARTS.plot - ((value - low) / (high - low || 1)) * PARTS.plot;
  const group = svg("g", {});
  for (const value of [low, high]) {
    group.append(
      svg("line", { class: "grid", x1: TIMELINE.pad, x2: width - TIMELINE.pad, y1: y(value), y2: y(value) }),
      svg("text", { class: "tick", x: width - TIMELINE.pad, y: y(value) + (value === low ? -3 : 12), "text-anchor": "end" }, `${digits(value, 0)} ${unit}`),
    );
  }
  group.append(svg("path", { class: `curve ${kind}`, d: line(values.map((value, i) => [x(i), y(value)]).filter(([, at]) => Number.isFinite(at))) }));
  return group;
};

// The range of the object's heights over all rollouts of the artifact, in cm.
const heightsOf = remember((number) => {
  let high = 0.01;
  const { starts, steps } = traces(number);
  for (let i = 9; i < starts.length; i += 14) high = Math.max(high, heightOf(number, starts[i]));
  for (let i = 2; i < steps.object.length; i += 7) high = Math.max(high, heightOf(number, steps.object[i]));
  return [0, Math.ceil(100 * high)];
});

const timelineParts = (data, x, width) => {
  const heights = data.object.map((pose) => 100 * heightOf(data.artifact, pose[2]));
  const intro = width < 520 ? [] : [["", "demonstration; below: "]];
  return [
    legendOf(PLACE.demosLabel, [...intro, ["bridge", "bridge "], ["replay", "replay "], ["home", "home"],
      ["", " · "], ["transit", "transit "], ["transfer", "transfer"], ["", " · "], ["opening", "open "], ["closing", "close"]]),
    bands(data, x),
    legendOf(PLACE.fingersLabel, [["", "finger separation"]]),
    curve(data.fingers.map((value) => 1000 * value), [0, 80], PLACE.fingers, x, "fingers", width, "mm"),
    legendOf(PLACE.heightLabel, [["", "object height above the table"]]),
    curve(heights, heightsOf(data.artifact), PLACE.height, x, "height", width, "cm"),
    svg("text", { class: "tick", x: TIMELINE.pad, y: PLACE.ticks + 12 }, "0"),
    svg("text", { class: "tick", x: width - TIMELINE.pad, y: PLACE.ticks + 12, "text-anchor": "end" }, counted(data.length, "step")),
  ];
};
