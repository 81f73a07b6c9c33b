// Traces of rollouts and the frames that decisions retrieved, unpacked where they are needed. The scene gives START and FRAME,
// the numbers of a first state and of a recorded frame, decisionAt, statesOf and frameOf.
const PHASES = ["plan", "bridge", "replay", "home"];
const NONE = 0xffffffff;
const row = (values, count, i) => Array.from(values.subarray(count * i, count * i + count));

// Columns of an artifact's traces, and where each rollout's rows begin.
const traces = remember((number) => {
  const artifact = REPORT.artifacts[number];
  const places = new Map();
  let step = 0;
  let decision = 0;
  artifact.shown.forEach((rollout, place) => {
    places.set(rollout, { place, step, decision });
    step += artifact.rollouts.steps[rollout];
    decision += artifact.rollouts.decisions[rollout];
  });
  return { places, starts: unpack(artifact.starts), steps: unpackAll(artifact.steps), decisions: unpackAll(artifact.decisions) };
});

// A decision, with what the scene has of it; `detailed` says whether RE4 took it, and so whether there is more than what it followed.
const readDecision = (columns, i) => ({
  row: i,
  step: columns.step[i],
  demo: columns.demo[i] === NONE ? undefined : columns.demo[i],
  name: columns.demo_name[i],
  first: columns.demo_frame[i],
  last: columns.demo_end[i],
  kind: columns.kind[i],
  detailed: columns.detailed[i] === 1,
  transfer: columns.transfer[i] === 1,
  compared: columns.compared[i],
  replaySteps: columns.replay_steps[i],
  reason: columns.reason[i],
  ...decisionAt(columns, i),
});

// One rollout: states 0 to `length` (before each step, and the last), the steps between them, and the decisions.
// Undefined where the page does not hold it.
const loadRollout = (artifact, rollout) => {
  const { places, starts, steps, decisions } = traces(artifact);
  const place = places.get(rollout);
  if (place === undefined) return undefined;
  const figures = REPORT.artifacts[artifact].rollouts;
  const length = figures.steps[rollout];
  const rows = Array.from({ length }, (_, i) => place.step + i);
  const decided = Array.from({ length: figures.decisions[rollout] }, (_, i) => readDecision(decisions, place.decision + i));
  return {
    artifact,
    rollout,
    seed: figures.seed[rollout],
    success: figures.success[rollout] === 1,
    length,
    decisionOf: rows.map((i) => steps.decision[i]),
    phase: rows.map((i) => PHASES[steps.phase[i]]),
    decisions: decided,
    ...statesOf(row(starts, START, place.place), steps, rows, decided),
  };
};

const demonstrationsOf = remember((key) => {
  const packed = REPORT.demonstrations[key];
  if (packed === undefined) return undefined;
  const frames = unpack(packed.frames);
  const demos = new Map();
  let at = 0;
  packed.number.forEach((number, i) => {
    demos.set(number, frames.subarray(FRAME * at, FRAME * (at + packed.length[i])));
    at += packed.length[i];
  });
  return demos;
});

// Frames of a decision's chunk as {eef, object}; undefined where the page does not hold them.
const loadChunk = (index, { demo, first, last }) => {
  const frames = demo === undefined ? undefined : demonstrationsOf(index)?.get(demo);
  if (frames === undefined || FRAME * (last + 1) > frames.length) return undefined;
  return Array.from({ length: last - first + 1 }, (_, i) => frameOf(row(frames, FRAME, first + i)));
};
