// The state of the page: the selected artifact, rollout and step.
const selection = { artifact: 0, rollout: 0, step: 0, data: undefined };
const listeners = { rollout: [], step: [] };
const notify = (what) => listeners[what].forEach((act) => act());

const isShown = (artifact, rollout) => traces(artifact).places.has(rollout);

const selectRollout = (artifact, rollout, step = 0) => {
  const data = loadRollout(artifact, rollout);
  if (data === undefined) return;
  Object.assign(selection, { artifact, rollout, data, step: clamp(step, 0, data.length) });
  notify("rollout");
  notify("step");
};

const selectStep = (step) => {
  const clamped = clamp(step, 0, selection.data.length);
  if (clamped === selection.step) return;
  selection.step = clamped;
  notify("step");
};

// The decision in force at a state: that of the action that follows, or the last decision at the last state.
const decisionInForce = (data, step) => data.decisionOf[Math.min(step, data.length - 1)] ?? 0;

const selectDecision = (direction) => {
  const { data, step } = selection;
  const starts = data.decisions.map((decision) => decision.step);
  const next = direction > 0 ? starts.find((start) => start > step) : starts.findLast((start) => start < step);
  selectStep(next ?? (direction > 0 ? data.length : 0));
};

// The fragment of the page's address: #rollout=<16 digits of the key>/<seed>/<step>. The short form #seed=<seed>&step=<step> is
// also accepted; it selects the first artifact with a rollout of that seed.
const addressOf = () => {
  const { key } = REPORT.artifacts[selection.artifact];
  return `#rollout=${key.slice(0, 16)}/${selection.data.seed}/${selection.step}`;
};

const readShortAddress = () => {
  const found = /^#seed=(\d+)(?:&step=(\d+))?$/.exec(location.hash);
  if (found === null) return false;
  for (const [artifact, { rollouts }] of REPORT.artifacts.entries()) {
    const rollout = rollouts.seed.indexOf(Number(found[1]));
    if (rollout >= 0 && isShown(artifact, rollout)) {
      selectRollout(artifact, rollout, Number(found[2] ?? 0));
      return true;
    }
  }
  return false;
};

const readAddress = () => {
  const found = /^#rollout=([0-9a-f]{16})\/(\d+)(?:\/(\d+))?$/.exec(location.hash);
  if (found === null) return readShortAddress();
  const artifact = REPORT.artifacts.findIndex(({ key }) => key.startsWith(found[1]));
  const rollout = artifact < 0 ? -1 : REPORT.artifacts[artifact].rollouts.seed.indexOf(Number(found[2]));
  if (rollout < 0 || !isShown(artifact, rollout)) return false;
  selectRollout(artifact, rollout, Number(found[3] ?? 0));
  return true;
};

let addressTimer = 0;
const writeAddress = () => {
  clearTimeout(addressTimer);
  addressTimer = setTimeout(() => {
    if (location.hash !== addressOf()) location.replace(addressOf());
  }, 400);
};
