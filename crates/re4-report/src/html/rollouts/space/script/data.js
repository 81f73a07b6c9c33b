// The data of rollouts of robosuite's tasks. Lengths are in metres; a pose is a position and a quaternion x, y, z, w.
const CONTROL_RATE = 20;
const START = 14;
const FRAME = 10;

const frameOf = (values) => ({ eef: values.slice(0, 3), object: values.slice(3) });

const decisionAt = (columns, i) => ({
  bridge: columns.bridge[i] === 1,
  banned: columns.banned[i],
  fingers: columns.fingers[i],
  object: row(columns.object, 7, i),
  setPoint: row(columns.set_point, 7, i),
  dq: columns.d_q[i],
  do: columns.d_o[i],
  de: columns.d_e[i],
  symmetryRotation: columns.symmetry_rotation[i],
  delta: row(columns.delta, 6, i),
});

const statesOf = (start, steps, rows, decided) => ({
  eef: [start.slice(0, 7), ...rows.map((i) => row(steps.eef, 7, i))],
  object: [start.slice(7), ...rows.map((i) => row(steps.object, 7, i))],
  fingers: [decided[0]?.fingers ?? NaN, ...rows.map((i) => steps.fingers[i])],
  goal: rows.map((i) => row(steps.goal, 3, i)),
  closing: rows.map((i) => steps.closing[i] === 1),
  seen: steps.seen ? rows.map((i) => row(steps.seen, 7, i)) : undefined,
});

// Rotates a vector by a quaternion x, y, z, w.
const rotated = ([x, y, z, w], [a, b, c]) => {
  const [s, t, u] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [a + w * s + y * u - z * t, b + w * t + z * s - x * u, c + w * u + x * t - y * s];
};

// Transforms a point from a body's frame to the world frame.
const placed = (pose, point) => rotated(pose.slice(3), point).map((value, i) => value + pose[i]);

// Applies a motion [translation, rotation vector] to a point: rotates it about the world origin, then translates it.
const moved = (motion, point) => {
  const [x, y, z] = motion.slice(3);
  const angle = Math.hypot(x, y, z);
  const s = angle === 0 ? 0 : Math.sin(angle / 2) / angle;
  return rotated([s * x, s * y, s * z, Math.cos(angle / 2)], point).map((value, i) => value + motion[i]);
};

const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
const millimetres = (value, count = 1) => `${digits(1000 * value, count)} mm`;

// The colour of a demonstration. Multiples of the golden angle give neighbouring numbers hues that differ most.
const demoStyle = (demo) => `--hue:${near((demo * 137.508) % 360)};--shade:${(Math.floor(demo / 5) % 3) * 7 - 7}%`;
