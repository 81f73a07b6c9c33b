// The traces of rollouts and the retrieved frames of demonstrations, unpacked when they are needed. The scene's script defines
// START and FRAME, how many numbers a first state and a recorded frame have, and decisionAt, statesOf and frameOf.
const PHASES = ["plan", "bridge", "replay", "home"];
const NONE = 0xffffffff;
const row = (values, count, i) => Array.from(values.subarray(count * i, count * i + count));

// The columns of an artifact's traces, and the index of each rollout's first rows.
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

// A decision, including the scene's own data. `detailed` is true if RE4 took it; other policies record only what they followed.
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

// One rollout: the states 0 to `length` (before each step, and after the last), the steps between them, and the decisions.
// Undefined if the viewer does not contain it.
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
    goal: figures.goal?.[rollout],
    // The number of steps before the disturbance, and the disturbance in words.
    disturbance: figures.disturbance?.[rollout] ?? undefined,
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

// The frames of a decision's chunk as {eef, object}; undefined if the page does not contain them.
const loadChunk = (index, { demo, first, last }) => {
  const frames = demo === undefined ? undefined : demonstrationsOf(index)?.get(demo);
  if (frames === undefined || FRAME * (last + 1) > frames.length) return undefined;
  return Array.from({ length: last - first + 1 }, (_, i) => frameOf(row(frames, FRAME, first + i)));
};
