// The data of Push-T rollouts. Lengths are in pixels, angles in radians; the y axis points down.
const WORLD = REPORT.artifacts[0]?.world;
const SUCCESS = WORLD?.success_coverage;
const CONTROL_RATE = 10;
const START = 5;
const FRAME = 5;

const numberOrNull = (value) => (Number.isNaN(value) ? null : value);
const scoreOf = (coverage) => Math.min(coverage / SUCCESS, 1);

const frameOf = (values) => ({ eef: values.slice(0, 2), object: values.slice(2) });

// The index of the first point of each decision's plan in the column of points.
const pathStarts = (columns) => {
  let at = 0;
  columns.path_start ??= Array.from(columns.path_length, (length) => {
    at += length;
    return at - length;
  });
  return columns.path_start;
};

const decisionAt = (columns, i) => ({
  planSteps: columns.plan_steps[i],
  planNodes: columns.plan_nodes[i],
  dq: numberOrNull(columns.d_q[i]),
  do: numberOrNull(columns.d_o[i]),
  predictedCoverage: columns.predicted_coverage[i],
  delta: row(columns.delta, 3, i),
  setPoint: row(columns.set_point, 2, i),
  object: row(columns.object, 3, i),
  predicted: row(columns.predicted, 3, i),
  plan: columns.plan[i],
  selector: columns.selector[i],
  path: Array.from({ length: columns.path_length[i] }, (_, k) => row(columns.path, 2, pathStarts(columns)[i] + k)),
});

const bestSoFar = (coverage) => {
  let best = 0;
  return coverage.map((value) => (best = Math.max(best, value)));
};

const statesOf = (start, steps, rows) => {
  const coverage = rows.map((i) => steps.coverage[i]);
  return {
    eef: [start.slice(0, 2), ...rows.map((i) => row(steps.eef, 2, i))],
    object: [start.slice(2), ...rows.map((i) => row(steps.object, 3, i))],
    action: rows.map((i) => row(steps.action, 2, i)),
    observed: rows.map((i) => {
      const pose = steps.observed ? row(steps.observed, 3, i) : [NaN];
      return pose.some(Number.isNaN) ? null : pose;
    }),
    confidence: rows.map((i) => (steps.confidence ? numberOrNull(steps.confidence[i]) : null)),
    flag: rows.map((i) => (steps.flag ? steps.flag_words[steps.flag[i]] : "")),
    coverage,
    best: bestSoFar(coverage),
  };
};

// Applies a motion [x, y, angle] to a point: rotates it about the origin, then translates it.
const carry = ([x, y, angle], [u, v]) => {
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  return [x + c * u - s * v, y + s * u + c * v];
};
