// The frame of the timeline and its playhead. The scene's script defines TIMELINE {pad, height, playhead, name} and timelineParts.
let playhead;

const timelineX = (width) => {
  const { data } = selection;
  return (step) => TIMELINE.pad + (step / Math.max(1, data.length)) * (width - 2 * TIMELINE.pad);
};

// The step at a position on the timeline.
const stepAt = (x, width) => {
  const fraction = (x - TIMELINE.pad) / (width - 2 * TIMELINE.pad);
  return Math.round(clamp(fraction, 0, 1) * selection.data.length);
};

const movePlayhead = () => {
  const width = byId("timeline").clientWidth;
  if (playhead === undefined || width === 0) return;
  playhead.setAttribute("transform", `translate(${near(timelineX(width)(selection.step))} 0)`);
};

// The maximal runs of steps with equal values.
const runs = (data, value) => {
  const found = [];
  for (let i = 0; i < data.length; i += 1) {
    const now = value(i);
    const last = found[found.length - 1];
    if (last && last.value === now) last.end = i + 1;
    else found.push({ start: i, end: i + 1, value: now });
  }
  return found;
};

const disturbanceMark = ({ disturbance }, x, [top, floor]) => {
  if (disturbance === undefined) return [];
  const [step, words] = disturbance;
  return [svg("path", { class: "disturbance", d: `M${near(x(step))} ${top}V${floor}` }, svg("title", {}, `before step ${step}: ${words}`))];
};

const drawTimeline = () => {
  const host = byId("timeline");
  const width = Math.floor(host.clientWidth);
  const { data } = selection;
  if (width === 0 || data === undefined) return;
  const { height, name, playhead: [top, floor] } = TIMELINE;
  const root = svg("svg", { class: "chart", width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": name });
  playhead = svg("g", { class: "playhead" }, svg("line", { x1: 0, x2: 0, y1: top, y2: floor }));
  const x = timelineX(width);
  root.append(...timelineParts(data, x, width), ...disturbanceMark(data, x, [top, floor]), playhead);
  host.replaceChildren(root);
  movePlayhead();
};
