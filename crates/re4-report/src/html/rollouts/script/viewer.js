// Shows the selected rollout, step and decision. The scene's script defines SIDES, captionOf, stepWords, drawScene,
// decisionFacts, stepFacts and showEvidence, and LEGEND, legendShape and isDrawn for its legend.
const fact = (name, words, key, value, title) => [html("dt", {}, name), html("dd", key === undefined ? {} : { "data-fact": key, "data-value": value, title }, words)];

const demoFacts = ({ demo, name, first, last }) =>
  (demo === undefined ? [] : [fact("Demonstration", `${name}, frames ${first}–${last}`, "demo_name", name)]);

let shownDecision = "";
const showDecision = (data, step, number) => {
  const decision = data.decisions[number];
  const { index } = REPORT.artifacts[data.artifact];
  const chunk = decision === undefined ? undefined : loadChunk(index, decision);
  const root = drawScene(data, step, number, chunk);
  root.setAttribute("aria-label", `Scene of ${REPORT.artifacts[data.artifact].noun} ${data.seed} at step ${step} of ${data.length}${SIDES}`);
  byId("summary").replaceChildren(...(decision === undefined ? [] : [...decisionFacts(decision), ...stepFacts(data, step)].flat()));
  const key = [data.artifact, data.rollout, number].join();
  if (key === shownDecision) return;
  shownDecision = key;
  byId("decision-title").textContent = decision === undefined ? "No decision" : `Decision ${number + 1} of ${data.decisions.length}, taken at step ${decision.step}`;
  byId("reason").textContent = decision === undefined ? "" : `${decision.reason}.`;
  showEvidence(data, decision, chunk, `cannot be shown: the index artifact index/${index.slice(0, 16)} was not found when this page was made.`);
};

const showStep = () => {
  const { data, step } = selection;
  const number = decisionInForce(data, step);
  showDecision(data, step, number);
  const phase = byId("phase");
  const over = step === data.length;
  phase.textContent = over ? (data.success ? "success" : "out of steps") : data.phase[step];
  phase.className = `badge ${over ? (data.success ? "good" : "bad") : data.phase[step]}`;
  byId("scrubber").value = step;
  byId("scrubber").setAttribute("aria-valuetext", `step ${step} of ${data.length}`);
  const text = byId("step-text");
  const { summary, words } = stepWords(data, step, data.decisions[number]);
  Object.assign(text.dataset, { step, ...summary });
  text.replaceChildren(html("b", {}, `Step ${step}`), ` of ${data.length}`, ...words);
  movePlayhead();
};

const showRollout = () => {
  const { artifact, rollout, data } = selection;
  const { shown, rollouts, noun } = REPORT.artifacts[artifact];
  const picker = byId("pick-seed");
  if (picker.dataset.artifact !== String(artifact)) {
    picker.replaceChildren(...shown.map((number) => html("option", { value: number }, String(rollouts.seed[number]))));
    picker.dataset.artifact = artifact;
  }
  picker.value = rollout;
  byId("pick-artifact").value = artifact;
  byId("scrubber").max = data.length;
  byId("seed-noun").textContent = titled(noun);
  const ending = data.success ? `success after ${data.length} steps` : `no success in ${data.length} steps`;
  const disturbed = data.disturbance ? ` · ${data.disturbance[1]} before step ${data.disturbance[0]}` : "";
  byId("scene-caption").textContent = `${noun} ${data.seed} · ${captionOf(rollouts, rollout, ending)}${disturbed}`;
  drawTimeline();
};

// The path of a chunk, with an arrow head at its end.
const arrow = (points) => {
  const path = line(points);
  const [x, y] = points[points.length - 1];
  const from = points.findLast(([u, v]) => Math.hypot(x - u, y - v) > 6);
  if (from === undefined) return path;
  const angle = Math.atan2(y - from[1], x - from[0]);
  const barb = (offset) => [x - 10 * Math.cos(angle + offset), y - 10 * Math.sin(angle + offset)];
  return `${path}${line([barb(0.45), [x, y], barb(-0.45)])}`;
};

const cross = ([x, y]) => `M${near(x - 5)} ${near(y)}H${near(x + 5)}M${near(x)} ${near(y - 5)}V${near(y + 5)}`;

// The path of the end effector up to a state, by layer: one layer per phase, separate for the current and for older decisions.
const trails = (data, step, decision, view = (point) => point) => {
  const parts = {};
  for (let i = 0; i < step; i += 1) {
    const layer = `trail ${data.phase[i]}${data.decisionOf[i] === decision ? "" : " old"}`;
    parts[layer] = (parts[layer] ?? "") + line([view(data.eef[i]), view(data.eef[i + 1])]);
  }
  return parts;
};

const setUpLegend = () => {
  for (const [layer, words] of LEGEND) {
    if (!isDrawn(layer)) continue;
    byId("legend").append(html("li", {}, svg("svg", { class: "plane sample", viewBox: "0 0 24 18", "aria-hidden": "true" }, ...legendShape(layer)), words));
  }
};
