// Plays rollouts, and steps through them. The scene's script defines CONTROL_RATE, the number of control steps per second.
const player = { playing: false, last: 0, owed: 0 };

const setPlaying = (playing) => {
  if (playing && selection.step === selection.data.length) selectStep(0);
  Object.assign(player, { playing, last: performance.now(), owed: 0 });
  byId("play").textContent = playing ? "Pause" : "Play";
  byId("reason").setAttribute("aria-live", playing ? "off" : "polite");
  if (playing) requestAnimationFrame(advance);
};

const advance = (now) => {
  if (!player.playing) return;
  player.owed += ((now - player.last) / 1000) * CONTROL_RATE * Number(byId("speed").value);
  player.last = now;
  const steps = Math.floor(player.owed);
  player.owed -= steps;
  selectStep(selection.step + Math.max(0, steps));
  if (selection.step === selection.data.length) setPlaying(false);
  else requestAnimationFrame(advance);
};

const KEYS = {
  ArrowLeft: () => selectStep(selection.step - 1),
  ArrowRight: () => selectStep(selection.step + 1),
  ArrowUp: () => selectDecision(-1),
  ArrowDown: () => selectDecision(1),
  "[": () => selectDecision(-1),
  "]": () => selectDecision(1),
  Home: () => selectStep(0),
  End: () => selectStep(selection.data.length),
  k: () => setPlaying(!player.playing),
};

const onKey = (event) => {
  const act = KEYS[event.key];
  if (act === undefined || event.target.tagName === "SELECT" || event.altKey || event.ctrlKey || event.metaKey) return;
  event.preventDefault();
  act();
};

const walkSeeds = (direction) => {
  const { shown } = REPORT.artifacts[selection.artifact];
  const next = shown[shown.indexOf(selection.rollout) + direction];
  if (next !== undefined) selectRollout(selection.artifact, next);
};

// Selects another policy on the same seed, or on its first seed if it has no rollout of that seed.
const pickArtifact = (artifact) => {
  const { rollouts, shown } = REPORT.artifacts[artifact];
  const same = shown.find((rollout) => rollouts.seed[rollout] === selection.data.seed);
  selectRollout(artifact, same ?? shown[0]);
  byId("pick-artifact").value = selection.artifact;
};

const setUpViewer = () => {
  REPORT.artifacts.forEach(({ shown }, number) => {
    byId("pick-artifact").options[number].disabled = shown.length === 0;
  });
  const press = (id, act) => byId(id).addEventListener("click", act);
  press("previous-step", KEYS.ArrowLeft);
  press("next-step", KEYS.ArrowRight);
  press("previous-decision", KEYS.ArrowUp);
  press("next-decision", KEYS.ArrowDown);
  press("play", KEYS.k);
  press("previous-seed", () => walkSeeds(-1));
  press("next-seed", () => walkSeeds(1));
  byId("scrubber").addEventListener("input", (event) => selectStep(Number(event.target.value)));
  byId("pick-artifact").addEventListener("change", (event) => pickArtifact(Number(event.target.value)));
  byId("pick-seed").addEventListener("change", (event) => selectRollout(selection.artifact, Number(event.target.value)));
  byId("viewer").addEventListener("keydown", onKey);
  const timeline = byId("timeline");
  const seek = (event) => selectStep(stepAt(event.clientX - timeline.getBoundingClientRect().left, timeline.clientWidth));
  timeline.addEventListener("pointerdown", (event) => {
    timeline.setPointerCapture(event.pointerId);
    seek(event);
  });
  timeline.addEventListener("pointermove", (event) => {
    if (timeline.hasPointerCapture(event.pointerId)) seek(event);
  });
  onWidth(timeline, drawTimeline);
  listeners.rollout.push(() => setPlaying(false), showRollout);
  listeners.step.push(showStep, writeAddress);
};
