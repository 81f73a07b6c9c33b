// The timelines: one thin row per demonstration. The canvas has the size of the visible area, and only the visible rows are
// drawn, so that scrolling stays smooth with hundreds of demonstrations.
const ROW = 18;
const BAR = { top: 5, height: 8 };
const GUTTER = { name: 78, whole: 16, right: 12 };

const rows = { pending: false, hovered: -1, width: 0, printing: false };

const timelineScale = (width) => {
  const left = GUTTER.name + GUTTER.whole;
  const room = Math.max(10, width - left - GUTTER.right);
  return (demo) => {
    const frames = view.scale === "fraction" ? Math.max(1, DEMOS.frames[demo]) : MAX_FRAMES;
    return { x: (frame) => left + (frame / frames) * room, frame: (x) => ((x - left) / room) * frames };
  };
};

const wholeX = () => GUTTER.name + GUTTER.whole / 2;
const markX = (finding, place) => (isWhole(finding) ? wholeX() : place.x((finding.first + finding.end) / 2));

// Notes that most demonstrations have would hide the findings of single ones. They are drawn only if a filter is set.
const USUAL = new Set(byId("timeline-rows").dataset.usual.split(" "));
// The least severe findings come first, so that the most severe ones are drawn on top.
const marksOf = (demo) =>
  matching(demo).filter(({ code }) => isFiltered() || !USUAL.has(code)).sort((a, b) => b.severity - a.severity || a.first - b.first);

const drawMark = (context, severity, x, y, scale = 1) => {
  context.save();
  context.translate(x, y);
  context.scale(scale, scale);
  context.lineJoin = "round";
  context.strokeStyle = COLOURS.card;
  context.lineWidth = 4;
  context.stroke(GLYPH_PATHS[severity]);
  context.fillStyle = severity === "note" ? COLOURS.card : COLOURS[severity];
  context.fill(GLYPH_PATHS[severity]);
  context.strokeStyle = severity === "error" ? COLOURS.error : COLOURS.ink;
  context.lineWidth = severity === "note" ? 1.6 : 1;
  context.stroke(GLYPH_PATHS[severity]);
  context.restore();
};

const shortened = (context, text, room) => {
  if (context.measureText(text).width <= room) return text;
  let cut = text;
  while (cut.length > 1 && context.measureText(`${cut}…`).width > room) cut = cut.slice(0, -1);
  return `${cut}…`;
};

const drawRow = (context, demo, y, width, scale) => {
  const place = scale(demo);
  const chosen = demo === selection.demo;
  if (chosen || demo === rows.hovered) {
    context.fillStyle = COLOURS.accent;
    context.globalAlpha = chosen ? 0.16 : 0.07;
    context.fillRect(0, y, width, ROW);
    context.globalAlpha = 1;
    if (chosen) context.fillRect(0, y, 3, ROW);
  }
  context.fillStyle = chosen ? COLOURS.ink : COLOURS.soft;
  context.font = `${chosen ? "600 " : ""}11.5px ${rows.font}`;
  context.textAlign = "right";
  context.textBaseline = "middle";
  const dropped = DEMOS.frames[demo] > 0 && !keep.has(demo);
  context.globalAlpha = dropped ? 0.35 : 1;
  context.fillText(shortened(context, nameOf(demo), GUTTER.name - 12), GUTTER.name - 4, y + ROW / 2);
  for (const { transfer, first, end } of SEGMENTS_OF[demo]) {
    context.fillStyle = transfer ? COLOURS.transfer : COLOURS.transit;
    const x = place.x(first);
    context.fillRect(x, y + BAR.top, Math.max(0.6, place.x(end) - x), BAR.height);
  }
  context.globalAlpha = 1;
  if (dropped) {
    context.fillStyle = COLOURS.soft;
    context.fillRect(8, y + ROW / 2, GUTTER.name - 12, 1);
  }
  const marks = marksOf(demo);
  for (const finding of marks) {
    if (isWhole(finding)) continue;
    const severity = SEVERITIES[finding.severity];
    context.fillStyle = COLOURS[severity];
    context.globalAlpha = severity === "note" ? 0.5 : 1;
    const x = place.x(finding.first);
    context.fillRect(x, y + BAR.top + BAR.height + 1, Math.max(1.5, place.x(finding.end) - x), 2);
    context.globalAlpha = 1;
  }
  for (const finding of marks) drawMark(context, SEVERITIES[finding.severity], markX(finding, place), y + ROW / 2, 0.86);
};

const drawTimelines = () => {
  rows.pending = false;
  const host = byId("timeline-rows");
  const width = host.clientWidth;
  const height = rows.printing ? view.order.length * ROW : host.clientHeight;
  if (width === 0 || height === 0) return;
  rows.font = getComputedStyle(document.body).fontFamily;
  const context = fitCanvas(byId("timeline-canvas"), width, height);
  context.clearRect(0, 0, width, height);
  const top = rows.printing ? 0 : host.scrollTop;
  const first = Math.max(0, Math.floor(top / ROW));
  const last = Math.min(view.order.length, Math.ceil((top + height) / ROW));
  const scale = timelineScale(width);
  for (let at = first; at < last; at += 1) drawRow(context, view.order[at], at * ROW - top, width, scale);
  host.dataset.first = first;
  host.dataset.drawn = last - first;
};

const drawTimelinesSoon = () => {
  if (rows.pending) return;
  rows.pending = true;
  requestAnimationFrame(drawTimelines);
};

const tickGap = (length, room) => [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000].find((gap) => length / gap <= Math.max(2, room / 70)) ?? 10000;

const drawTimelineAxis = () => {
  const host = byId("timeline-axis");
  const width = byId("timeline-rows").clientWidth || host.clientWidth;
  if (width === 0) return;
  const left = GUTTER.name + GUTTER.whole;
  const room = width - left - GUTTER.right;
  const root = svg("svg", { class: "chart", width, height: 20, viewBox: `0 0 ${width} 20` });
  const tick = (x, words, anchor = "middle") => root.append(
    svg("line", { class: "grid", x1: x, x2: x, y1: 15, y2: 20 }),
    svg("text", { class: "tick", x, y: 11, "text-anchor": anchor }, words),
  );
  if (view.scale === "fraction") {
    for (const part of [0, 25, 50, 75, 100]) tick(left + (part / 100) * room, `${part} %`, part === 100 ? "end" : "middle");
  } else {
    const gap = tickGap(MAX_FRAMES, room);
    for (let frame = 0; frame <= MAX_FRAMES; frame += gap) tick(left + (frame / MAX_FRAMES) * room, frame === 0 ? "frame 0" : String(frame), left + (frame / MAX_FRAMES) * room > width - 24 ? "end" : "middle");
  }
  host.replaceChildren(root);
};

const showOrder = () => {
  const host = byId("timeline-rows");
  byId("timeline-spacer").style.height = `${view.order.length * ROW}px`;
  drawTimelineAxis();
  host.scrollTop = Math.min(host.scrollTop, Math.max(0, view.order.length * ROW - host.clientHeight));
  revealChosen();
  drawTimelinesSoon();
};

// Scrolls the list just far enough to show the selected row. The page itself does not scroll, as it would with scrollIntoView.
const revealChosen = () => {
  const host = byId("timeline-rows");
  const at = view.order.indexOf(selection.demo);
  const choice = byId("timeline-choice");
  choice.setAttribute("aria-setsize", view.order.length);
  choice.setAttribute("aria-posinset", at + 1);
  if (selection.demo >= 0) choice.textContent = demoWords(selection.demo);
  if (at < 0) return;
  if (at * ROW < host.scrollTop) host.scrollTop = at * ROW;
  if ((at + 1) * ROW > host.scrollTop + host.clientHeight) host.scrollTop = (at + 1) * ROW - host.clientHeight;
};

const severityWords = (demo) => {
  const words = [[DEMOS.errors[demo], "error"], [DEMOS.warnings[demo], "warning"], [DEMOS.notes[demo], "note"]]
    .filter(([count]) => count > 0)
    .map(([count, word]) => counted(count, word));
  return words.length > 0 ? words.join(", ") : "no findings";
};

const demoWords = (demo) => `${nameOf(demo)}: ${counted(DEMOS.frames[demo], "frame")}, ${Math.round(100 * transferFraction(demo))} % transfer, ${severityWords(demo)}`;

// Returns what is under the pointer: a demonstration, a frame of it, and the findings close to it.
const under = (event) => {
  const host = byId("timeline-rows");
  const box = host.getBoundingClientRect();
  const demo = view.order[Math.floor((event.clientY - box.top + host.scrollTop) / ROW)];
  if (demo === undefined) return undefined;
  const x = event.clientX - box.left;
  const place = timelineScale(host.clientWidth)(demo);
  const frame = Math.floor(place.frame(x));
  const marks = marksOf(demo)
    .map((finding) => ({ finding, away: Math.abs(markX(finding, place) - x) }))
    .filter(({ finding, away }) => away <= 7 || (!isWhole(finding) && frame >= finding.first && frame < finding.end))
    .sort((a, b) => a.away - b.away);
  return { demo, frame: frame >= 0 && frame < DEMOS.frames[demo] ? frame : null, findings: marks.map(({ finding }) => finding) };
};

const findingLine = (finding) => html("p", { class: "line" }, glyph(SEVERITIES[finding.severity]), html("span", {}, `${finding.message}`));

const showTip = (event, found) => {
  const tip = byId("timeline-tip");
  if (found === undefined) {
    tip.classList.remove("open");
    return;
  }
  const segment = found.frame === null ? undefined : SEGMENTS_OF[found.demo].find(({ first, end }) => found.frame >= first && found.frame < end);
  const where = found.frame === null ? "" : ` · frame ${found.frame}${segment ? `, ${segment.transfer ? "transfer" : "transit"}` : ""}`;
  const more = found.findings.length > 4 ? [html("p", { class: "soft" }, `and ${found.findings.length - 4} more`)] : [];
  tip.replaceChildren(
    html("p", {}, html("b", {}, nameOf(found.demo)), ` · ${counted(DEMOS.frames[found.demo], "frame")}${where}`),
    ...(found.findings.length > 0 ? found.findings.slice(0, 4).map(findingLine) : [html("p", { class: "soft" }, severityWords(found.demo))]),
    ...more,
  );
  tip.classList.add("open");
  const box = byId("timelines").getBoundingClientRect();
  const wide = tip.offsetWidth;
  const tall = tip.offsetHeight;
  const x = clamp(event.clientX - box.left + 14, 4, Math.max(4, box.width - wide - 4));
  const below = event.clientY + 18 + tall < window.innerHeight;
  tip.style.transform = `translate(${Math.round(x)}px, ${Math.round(event.clientY - box.top + (below ? 18 : -tall - 12))}px)`;
};

const hover = (demo) => {
  if (demo === rows.hovered) return;
  rows.hovered = demo;
  drawTimelinesSoon();
};

const onTimelineKey = (event) => {
  const page = Math.max(1, Math.floor(byId("timeline-rows").clientHeight / ROW) - 1);
  const steps = { ArrowUp: -1, ArrowDown: 1, PageUp: -page, PageDown: page, Home: -COUNT, End: COUNT }[event.key];
  if (steps === undefined || event.altKey || event.ctrlKey || event.metaKey) return;
  event.preventDefault();
  walkDemos(steps);
};

// In print, all rows are drawn, because a printed list cannot be scrolled.
const printRows = (printing) => {
  rows.printing = printing;
  byId("timeline-rows").classList.toggle("printing", printing);
  drawTimelines();
};

const setUpTimelines = () => {
  const host = byId("timeline-rows");
  host.addEventListener("scroll", () => {
    drawTimelinesSoon();
    byId("timeline-tip").classList.remove("open");
  }, { passive: true });
  host.addEventListener("keydown", onTimelineKey);
  host.addEventListener("pointermove", (event) => {
    const found = under(event);
    hover(found?.demo ?? -1);
    showTip(event, found);
  });
  host.addEventListener("pointerleave", () => {
    hover(-1);
    showTip(undefined, undefined);
  });
  host.addEventListener("click", (event) => {
    const found = under(event);
    if (found === undefined) return;
    if (found.findings.length > 0) selectFinding(found.findings[0]);
    else selectDemo(found.demo);
  });
  new ResizeObserver(() => {
    drawTimelineAxis();
    drawTimelinesSoon();
  }).observe(host);
  window.addEventListener("beforeprint", () => printRows(true));
  window.addEventListener("afterprint", () => printRows(false));
  listeners.view.push(showOrder);
  listeners.demo.push(revealChosen, drawTimelinesSoon);
};
