// The words and figures of a decision.
const fact = (name, value, attributes = {}) => [html("dt", {}, name), html("dd", attributes, value)];
const said = (name, words, key, value, title) => fact(name, words, { "data-fact": key, "data-value": value, title });

const inCentimetres = ([x, y, z]) => `${[x, y, z].map((value) => digits(100 * value, 1)).join(", ")} cm`;

const KINDS = {
  retrieve: "retrieved", continue: "followed further", grasp_lost: "grasp lost: back to the start", demo_ended: "demonstration ended: back to the start",
};

const chosenFacts = (decision) => [
  said("Demonstration", `${decision.name}, frames ${decision.first}–${decision.last}`, "demo_name", decision.name),
  said("d_q", digits(decision.dq, 4), "d_q", decision.dq, "Distance of the full object-augmented states, without unit"),
  said("d_o", digits(decision.do, 4), "d_o", decision.do, "Distance of the object poses alone"),
  said("d_e", digits(decision.de, 4), "d_e", decision.de, "Distance of the end effectors as seen from the object"),
  said("Compared", times(decision.compared, "demonstration", "demonstrations"), "compared", decision.compared),
  said("δ", `${inCentimetres(decision.delta)}, ${degrees(Math.hypot(...decision.delta.slice(3)))}`, "delta", decision.delta.join(" "),
    "Motion that carries the demonstration's object onto ours: translation, and angle about the world's origin"),
  said("Symmetry turn", degrees(decision.turn), "symmetry_turn", decision.turn, "Turn about the object's symmetry axis"),
];

const decisionFacts = (decision) => [
  said("Decided", KINDS[decision.kind] ?? decision.kind.replaceAll("_", " "), "kind", decision.kind),
  said("Mode", decision.transfer ? "transfer: the object is held" : "transit", "mode", decision.transfer ? "transfer" : "transit"),
  ...(decision.demo === undefined ? [] : chosenFacts(decision)),
  said("Set point", inCentimetres(decision.setPoint), "set_point", decision.setPoint.join(" ")),
  said("Fingers", `${millimetres(decision.fingers)} apart`, "finger_separation", decision.fingers),
  ...(decision.demo === undefined ? [] : [said("Chunk", times(decision.replaySteps, "action", "actions"), "replay_steps", decision.replaySteps)]),
  said("Not followed again", times(decision.banned, "demonstration", "demonstrations"), "banned", decision.banned),
];

const seenFacts = (data, step) => {
  if (data.seen === undefined || step >= data.length) return [];
  const away = apart(data.seen[step], data.object[step]);
  return [said("Pose told", `off by ${millimetres(away)}`, "pose_error", away)];
};

let shownDecision = "";
const showDecision = (data, step, number) => {
  const decision = data.decisions[number];
  const { index } = REPORT.artifacts[data.artifact];
  const chunk = decision === undefined ? undefined : loadChunk(index, decision);
  drawScene(data, step, number, chunk);
  byId("facts").replaceChildren(...(decision === undefined ? [] : [...decisionFacts(decision), ...seenFacts(data, step)].flat()));
  const key = [data.artifact, data.rollout, number].join();
  if (key === shownDecision) return;
  shownDecision = key;
  showPicture(data, decision);
  byId("decision-title").textContent = decision === undefined ? "No decision" : `Decision ${number + 1} of ${data.decisions.length}, taken at step ${decision.step}`;
  byId("reason").textContent = decision === undefined ? "" : `${decision.reason}.`;
  byId("demo-note").textContent = decision?.demo === undefined || chunk !== undefined ? ""
    : `The recording of ${decision.name} cannot be drawn: the index artifact index/${index.slice(0, 16)} was not beside the rollouts when this page was made.`;
};
