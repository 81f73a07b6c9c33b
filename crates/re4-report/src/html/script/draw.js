// Helpers for drawing, formatting and controls.
const SVG = "http://www.w3.org/2000/svg";
const byId = (id) => document.getElementById(id);

const fill = (element, attributes, children) => {
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
};

const html = (name, attributes = {}, ...children) => fill(document.createElement(name), attributes, children);
const svg = (name, attributes = {}, ...children) => fill(document.createElementNS(SVG, name), attributes, children);

const digits = (value, count = 3) => (Number.isFinite(value) ? value.toFixed(count).replace("-", "−") : "–");
const degrees = (angle) => `${digits((angle * 180) / Math.PI, 1)}°`;
const counted = (count, one, many = `${one}s`) => `${count} ${count === 1 ? one : many}`;
const titled = (word) => word[0].toUpperCase() + word.slice(1);
// Wraps an angle to [-pi, pi].
const wrapAngle = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
// Rounds a coordinate to two decimals, to keep the SVG short.
const near = (value) => Math.round(value * 100) / 100;

const line = (points) => points.map(([x, y], i) => `${i === 0 ? "M" : "L"}${near(x)} ${near(y)}`).join("");

// The shapes of the marks of artifacts, which distinguish them for readers who cannot see the colours.
const MARKS = [
  "M-4 0A4 4 0 1 0 4 0A4 4 0 1 0 -4 0Z",
  "M-3.5 -3.5H3.5V3.5H-3.5Z",
  "M0 -4.8L4.8 0L0 4.8L-4.8 0Z",
  "M0 -4.6L4.4 3.4H-4.4Z",
  "M0 4.6L4.4 -3.4H-4.4Z",
  "M-1.6 -4.2H1.6V-1.6H4.2V1.6H1.6V4.2H-1.6V1.6H-4.2V-1.6H-1.6Z",
  "M0 -4.5L4.3 -1.4L2.6 3.6H-2.6L-4.3 -1.4Z",
  "M-4.6 -2.2H4.6V2.2H-4.6Z",
];
const markOf = (artifact) => artifact % MARKS.length;

// Calls `draw` whenever the width of the element changes.
const onWidth = (element, draw) => {
  let width = 0;
  new ResizeObserver(() => {
    const now = Math.floor(element.clientWidth);
    if (now !== width && now > 0) {
      width = now;
      draw(now);
    }
  }).observe(element);
};

const checked = (name) => document.querySelector(`input[name="${name}"]:checked`).value;
const onChoice = (name, act) => {
  for (const input of document.querySelectorAll(`input[name="${name}"]`)) input.addEventListener("change", act);
};
