// The data of the page: demonstrations by index, their findings, segments and grasps, and the evidence by frame.
const DEMOS = REPORT.demos;
const COUNT = DEMOS.number.length;
const SEVERITIES = REPORT.severities;
const CHECKS = new Map(REPORT.checks.map((check) => [check.code, check]));
const LENGTH = REPORT.length;

const rowsOf = (columns, make) => columns.demo.map((_, row) => make(row));
const columnsAt = (columns) => (row) => Object.fromEntries(Object.entries(columns).map(([name, values]) => [name, values[row]]));

const byDemo = (rows) => {
  const groups = Array.from({ length: COUNT }, () => []);
  for (const row of rows) groups[row.demo].push(row);
  return groups;
};

const FINDINGS = rowsOf(REPORT.findings, columnsAt(REPORT.findings)).map((finding, number) => ({ ...finding, number }));
const SEGMENTS = rowsOf(REPORT.segments, columnsAt(REPORT.segments));
const GRASPS = rowsOf(REPORT.grasps, columnsAt(REPORT.grasps)).map((grasp, number) => ({ ...grasp, number }));
const FINDINGS_OF = byDemo(FINDINGS);
const SEGMENTS_OF = byDemo(SEGMENTS);
const GRASPS_OF = byDemo(GRASPS);

// Index of the first frame of each demonstration in the columns by frame.
const FRAME_START = [0];
for (const frames of DEMOS.frames) FRAME_START.push(FRAME_START[FRAME_START.length - 1] + frames);
const MAX_FRAMES = Math.max(1, ...DEMOS.frames);

const framesOf = (values, demo) => values.subarray(FRAME_START[demo], FRAME_START[demo + 1]);
const panelValues = remember((key) => {
  const [panel, series] = key.split(" ").map(Number);
  return unpack(REPORT.panels[panel].series[series].values);
});
const flagValues = remember((flag) => unpack(REPORT.flags[flag].values));

const nameOf = (demo) => DEMOS.name[demo];
const wordsOf = (code) => code.replaceAll(/[_-]/g, " ");

// Describes a range of frames. Both ends are inclusive in the text; `end` is exclusive in the data.
const spanWords = ({ first, end }) => (end - first <= 1 ? `frame ${first}` : `frames ${first}–${end - 1}`);
// Findings that cover nearly the whole demonstration are marked once, not as a range.
const isWhole = ({ first, end, demo }) => end - first >= 0.9 * DEMOS.frames[demo] && DEMOS.frames[demo] > 1;

// Formats a number with four significant digits and a typographic minus sign.
const figure = (value, precision = 4) => {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const text = size !== 0 && (size < 1e-4 || size >= 1e7) ? value.toExponential(2) : String(Number(value.toPrecision(precision)));
  return text.replace("-", "−");
};
const lengthWords = (value) => {
  if (value === null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value * LENGTH.factor);
  return digits(value * LENGTH.factor, size < 10 ? 2 : size < 100 ? 1 : 0);
};

// Colours of the current scheme, for canvases, which cannot use CSS variables. They are read again when the scheme changes.
const COLOURS = {};
const readColours = () => {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["card", "ink", "soft", "faint", "hair", "accent", "transit", "transfer", "error", "warning", "note", "held", "missed", "lost", "brief", "floor", "block", "block-line"]) {
    COLOURS[name] = style.getPropertyValue(`--${name}`).trim();
  }
};

const GLYPHS = {
  error: "M0 5.4L5.6 -4.4H-5.6Z",
  warning: "M0 -5.6L5.6 0L0 5.6L-5.6 0Z",
  note: "M-4 0A4 4 0 1 0 4 0A4 4 0 1 0 -4 0Z",
};
const GLYPH_PATHS = Object.fromEntries(Object.entries(GLYPHS).map(([name, path]) => [name, new Path2D(path)]));

const glyph = (severity) =>
  svg("svg", { class: `glyph sev-${severity}`, viewBox: "-7 -7 14 14", width: 14, height: 14, "aria-hidden": "true" }, svg("path", { d: GLYPHS[severity] }));

// Sizes a canvas in CSS pixels, with enough device pixels to be sharp, and returns its context.
const fitCanvas = (canvas, width, height) => {
  const ratio = Math.min(window.devicePixelRatio || 1, 3);
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
};
