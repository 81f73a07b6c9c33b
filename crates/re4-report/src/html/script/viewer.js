// The words and figures beside the scene, and the timeline.
const fact = (name, value, attributes = {}) => [html("dt", {}, name), html("dd", attributes, value)];

const point = ([x, y]) => `${digits(x, 1)}, ${digits(y, 1)} px`;

const PLAN_WORDS = { direct: "straight", planned: "round the block", failed: "no free way, straight", off: "off" };

const distanceFacts = ({ dq, do: d_o, predictedCoverage, selector, compared }) => {
  const facts = dq === null
    ? [fact("Rule", "by outcome")]
    : [
        fact("d_q", digits(dq, 4), { "data-fact": "d_q", "data-value": dq, title: "Distance of the states, normalised" }),
        fact("d_o", digits(d_o, 4), { "data-fact": "d_o", "data-value": d_o, title: "Distance of the object poses, normalised" }),
      ];
  facts.push(
    fact("Expected coverage", digits(predictedCoverage), { "data-fact": "predicted_coverage", "data-value": predictedCoverage }),
    fact("Compared", `${compared} ${selector === "outcome" ? "chunks" : "demonstrations"}`, { "data-fact": "compared", "data-value": compared }),
  );
  return facts;
};

const decisionFacts = (decision) => [
  fact("Demonstration", `${decision.name}, frames ${decision.first}–${decision.last}`, { "data-fact": "demo_name", "data-value": decision.name }),
  ...distanceFacts(decision),
  fact("δ", `${point(decision.delta)}, ${degrees(around(decision.delta[2]))}`, {
    "data-fact": "delta", "data-value": decision.delta.join(" "),
    title: "Motion that carries the demonstration's block onto ours: translation, rotation about the world's origin",
  }),
  fact("Set-point", point(decision.setPoint), { "data-fact": "set_point", "data-value": decision.setPoint.join(" ") }),
  fact("Plan", PLAN_WORDS[decision.plan] ?? decision.plan, { "data-fact": "plan", "data-value": decision.plan }),
  fact("Plan steps, nodes", `${decision.planSteps}, ${decision.planNodes}`, { "data-fact": "plan_steps", "data-value": `${decision.planSteps} ${decision.planNodes}` }),
  fact("Replay", decision.replaySteps === 1 ? "1 step" : `${decision.replaySteps} steps`, { "data-fact": "replay_steps", "data-value": decision.replaySteps }),
];

const estimateFacts = (data, step) => {
  const estimate = estimateAt(data, step);
  if (estimate === undefined) return [];
  const { away, turn, confidence, flag } = estimate;
  const facts = [fact("Pose given", `off by ${digits(away, 2)} px, ${digits((turn * 180) / Math.PI, 2)}°`, { "data-fact": "pose_error", "data-value": `${away} ${turn}` })];
  if (flag) facts.push(fact("Estimator says", flag.replaceAll("_", " "), { "data-fact": "pose_flag", "data-value": flag }));
  if (confidence !== null) facts.push(fact("Confidence", digits(confidence), { "data-fact": "pose_confidence", "data-value": confidence }));
  return facts;
};

let shownDecision = "";
const showDecision = (data, step, number) => {
  const decision = data.decisions[number];
  const key = [data.artifact, data.rollout, number].join();
  const { index } = REPORT.artifacts[data.artifact];
  const chunk = decision === undefined ? undefined : loadChunk(index, decision);
  drawScene(data, step, number, chunk);
  byId("facts").replaceChildren(...(decision === undefined ? [] : [...decisionFacts(decision), ...estimateFacts(data, step)].flat()));
  if (key === shownDecision) return;
  shownDecision = key;
  byId("decision-title").textContent = decision === undefined ? "No decision" : `Decision ${number + 1} of ${data.decisions.length}, taken at step ${decision.step}`;
  byId("reason").textContent = decision === undefined ? "" : `${decision.reason}.`;
  drawDemo(chunk);
  showDemoWords(index, decision, chunk);
};

const showDemoWords = (index, decision, chunk) => {
  if (decision === undefined) return;
  byId("demo-note").textContent = chunk
    ? `As recorded in ${decision.name}: frame ${decision.first}, the pusher’s way and the block (dashed) up to frame ${decision.last}.`
    : `The recording of ${decision.name}, frame ${decision.first}, cannot be drawn: the index artifact index/${index.slice(0, 16)} was not beside the rollouts when this page was made.`;
};

const showStep = () => {
  const { data, step } = selection;
  const number = decisionInForce(data, step);
  showDecision(data, step, number);
  const coverage = step === 0 ? null : data.coverage[step - 1];
  const replaying = data.replay[Math.min(step, data.length - 1)];
  const phase = byId("phase");
  phase.textContent = step === data.length ? (data.success ? "success" : "out of steps") : replaying ? "replay" : "plan";
  phase.className = `badge ${step === data.length ? (data.success ? "good" : "") : replaying ? "replay" : "plan"}`;
  byId("scrubber").value = step;
  byId("scrubber").setAttribute("aria-valuetext", `step ${step} of ${data.length}`);
  const text = byId("step-text");
  text.dataset.step = step;
  text.dataset.coverage = coverage ?? "";
  text.replaceChildren(
    html("b", {}, `Step ${step}`), ` of ${data.length}`,
    ...(coverage === null ? [] : [
      html("span", {}, ` · coverage `, html("b", {}, digits(coverage))),
      html("span", {}, ` · best `, html("b", {}, digits(data.best[step - 1])), ` (score ${digits(scoreOf(data.best[step - 1]))})`),
    ]),
  );
  SCENE.root.setAttribute("aria-label", `Scene of ${REPORT.artifacts[data.artifact].noun} ${data.seed} at step ${step} of ${data.length}`);
  movePlayhead();
};

const TIMELINE = { height: 132, pad: 8, strip: 14, top: 16 };
let playhead;

const timelineX = (width) => {
  const { data } = selection;
  return (step) => TIMELINE.pad + (step / Math.max(1, data.length)) * (width - 2 * TIMELINE.pad);
};

const movePlayhead = () => {
  const width = byId("timeline").clientWidth;
  if (playhead === undefined || width === 0) return;
  const x = timelineX(width)(selection.step);
  playhead.setAttribute("transform", `translate(${near(x)} 0)`);
};

const phaseRuns = (data) => {
  const runs = [];
  for (let i = 0; i < data.length; i += 1) {
    const last = runs[runs.length - 1];
    if (last && last.replay === data.replay[i] && last.decision === data.decisionOf[i]) last.end = i + 1;
    else runs.push({ start: i, end: i + 1, replay: data.replay[i], decision: data.decisionOf[i] });
  }
  return runs;
};

const drawTimeline = () => {
  const host = byId("timeline");
  const width = Math.floor(host.clientWidth);
  const { data } = selection;
  if (width === 0 || data === undefined) return;
  const { height, pad, strip, top } = TIMELINE;
  const x = timelineX(width);
  const floor = height - strip - 22;
  const y = (value) => floor - value * (floor - top);
  const root = svg("svg", { class: "chart", width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "Coverage over steps, and the decisions" });
  root.append(
    svg("line", { class: "grid", x1: pad, x2: width - pad, y1: y(0), y2: y(0) }),
    svg("line", { class: "grid threshold", x1: pad, x2: width - pad, y1: y(SUCCESS), y2: y(SUCCESS) }),
    svg("text", { class: "tick", x: width - pad, y: y(SUCCESS) - 5, "text-anchor": "end" }, `success above ${SUCCESS}`),
  );
  for (const { start, end, replay, decision } of phaseRuns(data)) {
    root.append(svg("rect", { class: `phase ${replay ? "replay" : "plan"}`, x: x(start), y: floor + 4, width: Math.max(0.75, x(end) - x(start) - 1), height: strip },
      svg("title", {}, `decision ${decision + 1}: ${replay ? "replay" : "plan"}, steps ${start} to ${end}`)));
  }
  for (const { step } of data.decisions) {
    root.append(svg("path", { class: "decision", d: `M${near(x(step))} ${floor + 2}v${strip + 4}` }));
  }
  const curve = data.coverage.map((value, i) => [x(i + 1), y(value)]);
  const best = data.best.map((value, i) => [x(i + 1), y(value)]);
  root.append(svg("path", { class: "best", d: line(best) }), svg("path", { class: "coverage", d: line(curve) }));
  for (const step of [0, data.length]) {
    root.append(svg("text", { class: "tick", x: x(step), y: height - 3, "text-anchor": step === 0 ? "start" : "end" }, step === 0 ? "0" : `${step} steps`));
  }
  playhead = svg("g", { class: "playhead" }, svg("line", { x1: 0, x2: 0, y1: top - 10, y2: floor + strip + 6 }));
  root.append(playhead);
  host.replaceChildren(root);
  movePlayhead();
};

// The state at a place of the timeline.
const stepAt = (x, width) => {
  const share = (x - TIMELINE.pad) / (width - 2 * TIMELINE.pad);
  return Math.round(clamp(share, 0, 1) * selection.data.length);
};

const showRollout = () => {
  const { artifact, rollout, data } = selection;
  const picker = byId("pick-seed");
  if (picker.dataset.artifact !== String(artifact)) {
    const { shown, rollouts } = REPORT.artifacts[artifact];
    picker.replaceChildren(...shown.map((number) => html("option", { value: number }, String(rollouts.seed[number]))));
    picker.dataset.artifact = artifact;
  }
  picker.value = rollout;
  byId("pick-artifact").value = artifact;
  byId("scrubber").max = data.length;
  const { rollouts, noun } = REPORT.artifacts[artifact];
  byId("seed-noun").textContent = titled(noun);
  byId("scene-caption").textContent = `${noun} ${data.seed} · scaled score ${digits(rollouts.score[rollout])} · ${data.success ? `success after ${data.length} steps` : `no success in ${data.length} steps`}`;
  drawTimeline();
};

const CONTROL_RATE = 10;
