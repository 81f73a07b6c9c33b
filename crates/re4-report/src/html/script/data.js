// The page's data, unpacked where it is needed.
const REPORT = JSON.parse(document.getElementById("report-data").textContent);
const WORLD = REPORT.world;

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
  const decisions = unpackAll(artifact.decisions);
  let at = 0;
  decisions.path_start = Array.from(decisions.path_length, (length) => {
    at += length;
    return at - length;
  });
  return { places, starts: unpack(artifact.starts), steps: unpackAll(artifact.steps), decisions };
});

const triple = (values, i) => [values[3 * i], values[3 * i + 1], values[3 * i + 2]];
const pair = (values, i) => [values[2 * i], values[2 * i + 1]];
const numberOrNull = (value) => (Number.isNaN(value) ? null : value);

const decisionAt = (columns, row) => {
  const path = [];
  for (let i = 0; i < columns.path_length[row]; i += 1) path.push(pair(columns.path, columns.path_start[row] + i));
  return {
    step: columns.step[row],
    demo: columns.demo[row],
    name: columns.demo_name[row],
    first: columns.demo_frame[row],
    last: columns.demo_end[row],
    compared: columns.compared[row],
    planSteps: columns.plan_steps[row],
    planNodes: columns.plan_nodes[row],
    replaySteps: columns.replay_steps[row],
    transfer: columns.transfer[row] === 1,
    dq: numberOrNull(columns.d_q[row]),
    do: numberOrNull(columns.d_o[row]),
    predictedCoverage: columns.predicted_coverage[row],
    delta: triple(columns.delta, row),
    setPoint: pair(columns.set_point, row),
    object: triple(columns.object, row),
    predicted: triple(columns.predicted, row),
    plan: columns.plan[row],
    selector: columns.selector[row],
    reason: columns.reason[row],
    path,
  };
};

const bestSoFar = (coverage) => {
  let most = 0;
  return coverage.map((value) => (most = Math.max(most, value)));
};

// One rollout: states 0 to `length` (before each step, and the last), the steps between them, and the decisions.
// Undefined where the page does not hold it.
const loadRollout = (artifact, rollout) => {
  const { places, starts, steps, decisions } = traces(artifact);
  const place = places.get(rollout);
  if (place === undefined) return undefined;
  const figures = REPORT.artifacts[artifact].rollouts;
  const length = figures.steps[rollout];
  const rows = Array.from({ length }, (_, i) => place.step + i);
  const start = starts.slice(5 * place.place, 5 * place.place + 5);
  const coverage = rows.map((row) => steps.coverage[row]);
  return {
    artifact,
    rollout,
    seed: figures.seed[rollout],
    success: figures.success[rollout] === 1,
    length,
    eef: [[start[0], start[1]], ...rows.map((row) => pair(steps.eef, row))],
    object: [[start[2], start[3], start[4]], ...rows.map((row) => triple(steps.object, row))],
    action: rows.map((row) => pair(steps.action, row)),
    replay: rows.map((row) => steps.replay[row] === 1),
    decisionOf: rows.map((row) => steps.decision[row]),
    observed: rows.map((row) => {
      const pose = steps.observed ? triple(steps.observed, row) : [NaN];
      return pose.some(Number.isNaN) ? null : pose;
    }),
    confidence: rows.map((row) => (steps.confidence ? numberOrNull(steps.confidence[row]) : null)),
    flag: rows.map((row) => (steps.flag ? steps.flag_words[steps.flag[row]] : "")),
    coverage,
    best: bestSoFar(coverage),
    decisions: Array.from({ length: figures.decisions[rollout] }, (_, i) => decisionAt(decisions, place.decision + i)),
  };
};

const demonstrationsOf = remember((key) => {
  const packed = REPORT.demonstrations[key];
  if (packed === undefined) return undefined;
  const frames = unpack(packed.frames);
  const demos = new Map();
  let at = 0;
  packed.number.forEach((number, i) => {
    demos.set(number, frames.subarray(5 * at, 5 * (at + packed.length[i])));
    at += packed.length[i];
  });
  return demos;
});

// Frames `first` to `last` of a demonstration as {eef, object}; undefined where the page does not hold it.
const loadChunk = (index, { demo, first, last }) => {
  const frames = demonstrationsOf(index)?.get(demo);
  if (frames === undefined || 5 * last + 5 > frames.length) return undefined;
  return Array.from({ length: last - first + 1 }, (_, i) => {
    const row = frames.subarray(5 * (first + i), 5 * (first + i) + 5);
    return { eef: [row[0], row[1]], object: [row[2], row[3], row[4]] };
  });
};

const SUCCESS = WORLD.success_coverage;
const scoreOf = (coverage) => Math.min(coverage / SUCCESS, 1);
