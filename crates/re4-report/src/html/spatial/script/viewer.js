// What is shown of the chosen rollout and of the chosen step.
const CONTROL_RATE = 20;

const showStep = () => {
  const { data, step } = selection;
  const number = decisionInForce(data, step);
  showDecision(data, step, number);
  const over = step === data.length;
  const phase = byId("phase");
  const now = over ? (data.success ? "success" : "out of steps") : data.phase[step];
  phase.textContent = now;
  phase.className = `badge ${over ? (data.success ? "good" : "bad") : now}`;
  byId("scrubber").value = step;
  byId("scrubber").setAttribute("aria-valuetext", `step ${step} of ${data.length}`);
  const { demo, name } = data.decisions[number] ?? {};
  const height = heightOf(data.artifact, data.object[step][2]);
  const text = byId("step-text");
  text.dataset.step = step;
  text.dataset.demo = demo === undefined ? "" : name;
  text.dataset.height = height;
  text.dataset.fingers = data.fingers[step];
  text.replaceChildren(
    html("b", {}, `Step ${step}`), ` of ${data.length}`,
    demo === undefined ? " · on the way home" : html("span", {}, " · ", html("i", { class: "swatch", style: demoStyle(demo) }), " ", html("b", {}, name)),
    ` · fingers ${millimetres(data.fingers[step], 0)} apart · object ${digits(100 * height, 1)} cm above the table`,
  );
  scene.root.setAttribute("aria-label", `Scene of seed ${data.seed} at step ${step} of ${data.length}, from above and from behind the robot`);
  movePlayhead();
};

const showRollout = () => {
  const { artifact, rollout, data } = selection;
  const { shown, rollouts } = REPORT.artifacts[artifact];
  const picker = byId("pick-seed");
  if (picker.dataset.artifact !== String(artifact)) {
    picker.replaceChildren(...shown.map((number) => html("option", { value: number }, String(rollouts.seed[number]))));
    picker.dataset.artifact = artifact;
  }
  picker.value = rollout;
  byId("pick-artifact").value = artifact;
  byId("scrubber").max = data.length;
  byId("scene-caption").textContent = `seed ${data.seed} · ${data.success ? `success after ${data.length} steps` : `no success in ${data.length} steps`} · ${times(rollouts.demos[rollout], "demonstration", "demonstrations")}`;
  drawTimeline();
};
