// The texts and values of a decision and of a step.
const SIDES = ", from above and from behind the robot";

const captionOf = (rollouts, rollout, ending) => `${ending} · ${counted(rollouts.demos[rollout], "demonstration")}`;

const inCentimetres = ([x, y, z]) => `${[x, y, z].map((value) => digits(100 * value, 1)).join(", ")} cm`;

const KINDS = {
  retrieve: "retrieved", continue: "continued", grasp_lost: "grasp lost: return to the initial pose", demo_ended: "demonstration ended: return to the initial pose",
};

const chosenFacts = (decision) => [
  fact("d_q", digits(decision.dq, 4), "d_q", decision.dq, "Distance between the object-augmented states, dimensionless"),
  fact("d_o", digits(decision.do, 4), "d_o", decision.do, "Distance between the object poses only"),
  fact("d_e", digits(decision.de, 4), "d_e", decision.de, "Distance between the end-effector poses in the object's frame"),
  fact("Compared", counted(decision.compared, "demonstration"), "compared", decision.compared),
  fact("δ", `${inCentimetres(decision.delta)}, ${degrees(Math.hypot(...decision.delta.slice(3)))}`, "delta", decision.delta.join(" "),
    "Rigid motion from the demonstration's object to the observed one: translation, and angle of the rotation about the world origin"),
  fact("Symmetry rotation", degrees(decision.symmetryRotation), "symmetry_rotation", decision.symmetryRotation, "Rotation about the object's symmetry axis"),
];

const decisionFacts = (decision) => [
  fact("Decision", KINDS[decision.kind] ?? decision.kind.replaceAll("_", " "), "kind", decision.kind),
  ...(decision.detailed ? [fact("Mode", decision.transfer ? "transfer: the object is held" : "transit", "mode", decision.transfer ? "transfer" : "transit")] : []),
  ...demoFacts(decision),
  ...(decision.detailed ? detailFacts(decision) : []),
];

const detailFacts = (decision) => [
  ...(decision.demo === undefined ? [] : chosenFacts(decision)),
  fact("Set point", inCentimetres(decision.setPoint), "set_point", decision.setPoint.join(" ")),
  fact("Fingers", `${millimetres(decision.fingers)} apart`, "finger_separation", decision.fingers),
  ...(decision.demo === undefined ? [] : [fact("Chunk", counted(decision.replaySteps, "action"), "replay_steps", decision.replaySteps)]),
  fact("Excluded", counted(decision.banned, "demonstration"), "banned", decision.banned),
];

const stepFacts = (data, step) => {
  if (!data.seen?.[step]?.every(Number.isFinite)) return [];
  const distance = apart(data.seen[step], data.object[step]);
  return [fact("Pose error", millimetres(distance), "pose_error", distance)];
};

const showEvidence = (data, decision, chunk, lacking) => {
  showImage(data, decision);
  byId("demo-note").textContent = decision?.demo === undefined || chunk !== undefined ? "" : `The recording of ${decision.name} ${lacking}`;
};

const stepWords = (data, step, { demo, name } = {}) => {
  const height = heightOf(data.artifact, data.object[step][2]);
  const fingers = data.fingers[step];
  return {
    summary: { demo: demo === undefined ? "" : name, height, fingers },
    words: [
      demo === undefined ? " · returning to the initial pose" : html("span", {}, " · ", html("i", { class: "swatch", style: demoStyle(demo) }), " ", html("b", {}, name)),
      ` · fingers ${millimetres(fingers, 0)} apart · object ${digits(100 * height, 1)} cm above the table`,
    ],
  };
};
