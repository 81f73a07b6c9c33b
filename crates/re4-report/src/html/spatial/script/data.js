// The page's data, unpacked where it is needed. Metres; poses are position and quaternion x, y, z, w.
const REPORT = JSON.parse(document.getElementById("report-data").textContent);
const NO_DEMO = 0xffffffff;
const PHASES = ["bridge", "replay", "home"];

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

const row = (values, count, i) => Array.from(values.subarray(count * i, count * i + count));

const decisionAt = (columns, i) => ({
  row: i,
  step: columns.step[i],
  kind: columns.kind[i],
  transfer: columns.transfer[i] === 1,
  bridge: columns.bridge[i] === 1,
  banned: columns.banned[i],
  fingers: columns.fingers[i],
  object: row(columns.object, 7, i),
  setPoint: row(columns.set_point, 7, i),
  reason: columns.reason[i],
  demo: columns.demo[i] === NO_DEMO ? undefined : columns.demo[i],
  name: columns.demo_name[i],
  first: columns.demo_frame[i],
  last: columns.demo_end[i],
  compared: columns.compared[i],
  replaySteps: columns.replay_steps[i],
  dq: columns.d_q[i],
  do: columns.d_o[i],
  de: columns.d_e[i],
  turn: columns.turn[i],
  delta: row(columns.delta, 6, i),
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
  const start = row(starts, 14, place.place);
  const decided = Array.from({ length: figures.decisions[rollout] }, (_, i) => decisionAt(decisions, place.decision + i));
  return {
    artifact,
    rollout,
    seed: figures.seed[rollout],
    success: figures.success[rollout] === 1,
    length,
    eef: [start.slice(0, 7), ...rows.map((i) => row(steps.eef, 7, i))],
    object: [start.slice(7), ...rows.map((i) => row(steps.object, 7, i))],
    fingers: [decided[0]?.fingers ?? NaN, ...rows.map((i) => steps.fingers[i])],
    goal: rows.map((i) => row(steps.goal, 3, i)),
    closing: rows.map((i) => steps.closing[i] === 1),
    phase: rows.map((i) => PHASES[steps.phase[i]]),
    decisionOf: rows.map((i) => steps.decision[i]),
    seen: steps.seen ? rows.map((i) => row(steps.seen, 7, i)) : undefined,
    decisions: decided,
  };
};

const demonstrationsOf = remember((key) => {
  const packed = REPORT.demonstrations[key];
  if (packed === undefined) return undefined;
  const frames = unpack(packed.frames);
  const demos = new Map();
  let at = 0;
  packed.number.forEach((number, i) => {
    demos.set(number, frames.subarray(10 * at, 10 * (at + packed.length[i])));
    at += packed.length[i];
  });
  return demos;
});

// Frames of a decision's chunk as {eef, object}; undefined where the page does not hold them.
const loadChunk = (index, { demo, first, last }) => {
  const frames = demo === undefined ? undefined : demonstrationsOf(index)?.get(demo);
  if (frames === undefined || 10 * last + 10 > frames.length) return undefined;
  return Array.from({ length: last - first + 1 }, (_, i) => {
    const values = row(frames, 10, first + i);
    return { eef: values.slice(0, 3), object: values.slice(3) };
  });
};

// Turns a vector by a quaternion x, y, z, w.
const turned = ([x, y, z, w], [a, b, c]) => {
  const [s, t, u] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [a + w * s + y * u - z * t, b + w * t + z * s - x * u, c + w * u + x * t - y * s];
};

// A point of a body's frame in the world.
const placed = (pose, point) => turned(pose.slice(3), point).map((value, i) => value + pose[i]);

// The motion [translation, rotation vector] turns about the world's origin and then moves.
const moved = (motion, point) => {
  const [x, y, z] = motion.slice(3);
  const angle = Math.hypot(x, y, z);
  const s = angle === 0 ? 0 : Math.sin(angle / 2) / angle;
  return turned([s * x, s * y, s * z, Math.cos(angle / 2)], point).map((value, i) => value + motion[i]);
};

const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
const millimetres = (value, count = 1) => `${digits(1000 * value, count)} mm`;

// A colour for each demonstration: neighbouring ones differ most; the name stands beside it where there is room.
const demoStyle = (demo) => `--hue:${near((demo * 137.508) % 360)};--shade:${(Math.floor(demo / 5) % 3) * 7 - 7}%`;
