// The texts and values next to the scene, and the timeline of coverage.
const SIDES = "";

const numbersOf = (artifact) => REPORT.artifacts[artifact].rollouts.seed.map((_, rollout) => rollout);

const captionOf = (rollouts, rollout, ending) => `scaled score ${digits(rollouts.score[rollout])} · ${ending}`;

const point = ([x, y]) => `${digits(x, 1)}, ${digits(y, 1)} px`;

const PLAN_WORDS = { direct: "straight", planned: "around the block", failed: "no free path found, straight", off: "off" };

const distanceFacts = ({ dq, do: d_o, predictedCoverage, selector, compared }) => [
  ...(dq === null ? [fact("Rule", "by outcome")] : [
    fact("d_q", digits(dq, 4), "d_q", dq, "Distance between the states, normalised"),
    fact("d_o", digits(d_o, 4), "d_o", d_o, "Distance between the object poses, normalised"),
  ]),
  fact("Predicted coverage", digits(predictedCoverage), "predicted_coverage", predictedCoverage),
  fact("Compared", `${compared} ${selector === "outcome" ? "chunks" : "demonstrations"}`, "compared", compared),
];

const decisionFacts = (decision) => [
  ...demoFacts(decision),
  ...(decision.detailed ? detailFacts(decision) : []),
];

const detailFacts = (decision) => [
  ...distanceFacts(decision),
  fact("δ", `${point(decision.delta)}, ${degrees(wrapAngle(decision.delta[2]))}`, "delta", decision.delta.join(" "),
    "Rigid motion from the demonstration's block to the observed one: translation, rotation about the world origin"),
  fact("Set-point", point(decision.setPoint), "set_point", decision.setPoint.join(" ")),
  fact("Plan", PLAN_WORDS[decision.plan] ?? decision.plan, "plan", decision.plan),
  fact("Plan steps, nodes", `${decision.planSteps}, ${decision.planNodes}`, "plan_steps", `${decision.planSteps} ${decision.planNodes}`),
  fact("Replay", counted(decision.replaySteps, "step"), "replay_steps", decision.replaySteps),
];

const stepFacts = (data, step) => {
  const estimate = estimateAt(data, step);
  if (estimate === undefined) return [];
  const { distance, angle, confidence, flag } = estimate;
  const summary = [fact("Pose error", `${digits(distance, 2)} px, ${digits((angle * 180) / Math.PI, 2)}°`, "pose_error", `${distance} ${angle}`)];
  if (flag) summary.push(fact("Estimator flag", flag.replaceAll("_", " "), "pose_flag", flag));
  if (confidence !== null) summary.push(fact("Confidence", digits(confidence), "pose_confidence", confidence));
  return summary;
};

const showEvidence = (data, decision, chunk, lacking) => {
  drawDemo(chunk);
  if (decision?.demo === undefined) return;
  byId("demo-note").textContent = chunk
    ? `Recording of ${decision.name}: frame ${decision.first}, with the path of the pusher and the block (dashed) until frame ${decision.last}.`
    : `The recording of ${decision.name}, frame ${decision.first}, ${lacking}`;
};

const stepWords = (data, step) => {
  if (step === 0) return { summary: { coverage: "" }, words: [] };
  const [coverage, best] = [data.coverage[step - 1], data.best[step - 1]];
  return {
    summary: { coverage },
    words: [
      html("span", {}, ` · coverage `, html("b", {}, digits(coverage))),
      html("span", {}, ` · best `, html("b", {}, digits(best)), ` (score ${digits(scoreOf(best))})`),
    ],
  };
};

const STRIP = { top: 16, floor: 96, height: 14 };
const TIMELINE = { pad: 8, height: 132, playhead: [STRIP.top - 10, STRIP.floor + STRIP.height + 6], name: "Coverage over steps, and the decisions" };

const timelineParts = (data, x, width) => {
  const { pad, height } = TIMELINE;
  const { top, floor } = STRIP;
  const y = (value) => floor - value * (floor - top);
  const parts = [
    svg("line", { class: "grid", x1: pad, x2: width - pad, y1: y(0), y2: y(0) }),
    svg("line", { class: "grid threshold", x1: pad, x2: width - pad, y1: y(SUCCESS), y2: y(SUCCESS) }),
    svg("text", { class: "tick", x: width - pad, y: y(SUCCESS) - 5, "text-anchor": "end" }, `success above ${SUCCESS}`),
  ];
  for (const { start, end } of runs(data, (i) => `${data.phase[i]} ${data.decisionOf[i]}`)) {
    parts.push(svg("rect", { class: `phase ${data.phase[start]}`, x: x(start), y: floor + 4, width: Math.max(0.75, x(end) - x(start) - 1), height: STRIP.height },
      svg("title", {}, `decision ${data.decisionOf[start] + 1}: ${data.phase[start]}, steps ${start} to ${end}`)));
  }
  for (const { step } of data.decisions) {
    parts.push(svg("path", { class: "decision", d: `M${near(x(step))} ${floor + 2}v${STRIP.height + 4}` }));
  }
  for (const [name, values] of [["best", data.best], ["coverage", data.coverage]]) {
    parts.push(svg("path", { class: name, d: line(values.map((value, i) => [x(i + 1), y(value)])) }));
  }
  for (const step of [0, data.length]) {
    parts.push(svg("text", { class: "tick", x: x(step), y: height - 3, "text-anchor": step === 0 ? "start" : "end" }, step === 0 ? "0" : `${step} steps`));
  }
  return parts;
};
