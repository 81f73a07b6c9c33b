// The selected demonstration: its findings, its evidence over frames, and its segments.
const PLOT = { left: 88, right: 12, strip: 15, height: 92, top: 22, bottom: 8, axis: 24 };
const SEVERITY_COUNT = 3;

const shownRange = () => selection.range ?? [0, Math.max(DEMOS.frames[selection.demo], selection.other === null ? 0 : DEMOS.frames[selection.other])];

const plotScale = (width) => {
  const [first, end] = shownRange();
  const room = width - PLOT.left - PLOT.right;
  return {
    first, end, room,
    // Frame f has the cell from f to f + 1; its values are plotted in the middle of the cell, at f + 0.5.
    x: (frame) => PLOT.left + ((frame - first) / Math.max(1, end - first)) * room,
    frame: (x) => clamp(Math.floor(first + ((x - PLOT.left) / room) * (end - first)), first, end - 1),
  };
};

// The path of a curve, interrupted at frames without a value.
const curvePath = (values, scale, y) => {
  const pieces = [];
  let piece = [];
  for (let frame = Math.max(0, scale.first - 1); frame < Math.min(values.length, scale.end + 1); frame += 1) {
    const value = values[frame];
    if (Number.isFinite(value)) piece.push([scale.x(frame + 0.5), y(value)]);
    else if (piece.length > 0) {
      pieces.push(piece);
      piece = [];
    }
  }
  if (piece.length > 0) pieces.push(piece);
  return pieces.map(line).join("");
};

const niceTicks = (low, high, count = 3) => {
  const span = high - low || 1;
  const base = 10 ** Math.floor(Math.log10(span / count));
  const gap = [1, 2, 5, 10].map((step) => step * base).find((step) => span / step <= count) ?? base * 10;
  const ticks = [];
  for (let i = Math.ceil(low / gap - 1e-9); i * gap <= high + 1e-9 * span; i += 1) ticks.push(i * gap);
  return ticks;
};

// The range of values over all frames of the demonstration, so that zooming does not change the vertical scale.
const valueRange = (curves) => {
  let [low, high] = [Infinity, -Infinity];
  for (const values of curves) {
    for (const value of values) {
      if (!Number.isFinite(value)) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  if (low > high) return null;
  // Distances and speeds get an axis that starts at 0, unless they vary only little.
  if (low >= 0 && low < 0.6 * high) low = 0;
  if (low === high) high = low + (Math.abs(low) || 1);
  return [low, high + 0.06 * (high - low)];
};

const modeBands = (root, scale, top, height) => {
  for (const { transfer, first, end } of SEGMENTS_OF[selection.demo]) {
    const [a, b] = [Math.max(first, scale.first), Math.min(end, scale.end)];
    if (a >= b) continue;
    root.append(svg("rect", { class: `band ${transfer ? "transfer" : "transit"}`, x: near(scale.x(a)), y: top, width: near(scale.x(b) - scale.x(a)), height }));
  }
};

// Marks the selected finding over the whole height of a plot, and the others only at its top, so that the modes stay visible.
const findingBands = (root, scale, top, height) => {
  for (const finding of FINDINGS_OF[selection.demo]) {
    const active = finding.number === selection.finding;
    // Notes are often long and numerous. They are shown only in the strips above the plots.
    if (isWhole(finding) || (SEVERITIES[finding.severity] === "note" && !active)) continue;
    const [a, b] = [Math.max(finding.first, scale.first), Math.min(finding.end, scale.end)];
    if (a >= b) continue;
    root.append(svg("rect", { class: `span sev-${SEVERITIES[finding.severity]}${active ? " active" : ""}`, "data-finding": finding.number, x: near(scale.x(a)), y: top, width: near(Math.max(1.5, scale.x(b) - scale.x(a))), height: active ? height : 3 }));
  }
};

const FLAG_WORDS = ["no", "yes", "–"];
const STRIPS = () => [
  { label: "mode", at: (demo) => SEGMENTS_OF[demo].map(({ transfer, first, end }) => ({ first, end, kind: transfer ? "transfer" : "transit" })) },
  ...REPORT.flags.map(({ label }, flag) => ({ label, at: (demo) => runsOf(framesOf(flagValues(flag), demo)) })),
];

const runsOf = (values) => {
  const runs = [];
  for (let frame = 0; frame < values.length; frame += 1) {
    const last = runs[runs.length - 1];
    if (last && last.value === values[frame]) last.end = frame + 1;
    else runs.push({ first: frame, end: frame + 1, value: values[frame] });
  }
  return runs.filter(({ value }) => value !== 0).map(({ first, end, value }) => ({ first, end, kind: value === 1 ? "yes" : "unknown" }));
};

// Assigns findings to lanes so that none covers another.
const lanesOf = (findings) => {
  const lanes = [];
  return findings.map((finding) => {
    let lane = lanes.findIndex((end) => end <= finding.first);
    if (lane < 0) lane = lanes.push(0) - 1;
    lanes[lane] = finding.end;
    return { finding, lane };
  });
};

const drawStrips = (width, scale) => {
  const strips = STRIPS();
  if (selection.other !== null) strips.splice(1, 0, { label: shortName(selection.other), at: () => STRIPS()[0].at(selection.other) });
  const found = lanesOf([...FINDINGS_OF[selection.demo]].filter((f) => !isWhole(f)).sort((a, b) => a.first - b.first));
  const lanes = Math.max(0, ...found.map(({ lane }) => lane + 1));
  const height = strips.length * PLOT.strip + lanes * PLOT.strip + 6;
  const root = svg("svg", { class: "chart strips", width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "Mode, boolean evidence and findings over frames" });
  // The clip path of all plots below, which have the same size.
  root.append(svg("defs", {}, svg("clipPath", { id: "plot-clip" }, svg("rect", { x: PLOT.left, y: PLOT.top - 2, width: scale.room, height: PLOT.height - PLOT.top - PLOT.bottom + 4 }))));
  strips.forEach(({ label, at }, row) => {
    const y = row * PLOT.strip + 2;
    root.append(svg("text", { class: "tick", x: PLOT.left - 6, y: y + 9, "text-anchor": "end" }, label));
    root.append(svg("rect", { class: "rail", x: PLOT.left, y: y + 1, width: scale.room, height: PLOT.strip - 5 }));
    for (const { first, end, kind } of at(selection.demo)) {
      const [a, b] = [Math.max(first, scale.first), Math.min(end, scale.end)];
      if (a < b) root.append(svg("rect", { class: `run ${kind}`, x: near(scale.x(a)), y: y + 1, width: near(scale.x(b) - scale.x(a)), height: PLOT.strip - 5 }));
    }
  });
  const from = strips.length * PLOT.strip + 2;
  if (lanes > 0) root.append(svg("text", { class: "tick", x: PLOT.left - 6, y: from + 9, "text-anchor": "end" }, "findings"));
  for (const { finding, lane } of found) {
    const [a, b] = [Math.max(finding.first, scale.first), Math.min(finding.end, scale.end)];
    if (a >= b) continue;
    const severity = SEVERITIES[finding.severity];
    const y = from + lane * PLOT.strip;
    const group = svg("g", { class: `found${finding.number === selection.finding ? " active" : ""}` },
      svg("rect", { class: `span solid sev-${severity}`, x: near(scale.x(a)), y: y + 3, width: near(Math.max(2, scale.x(b) - scale.x(a))), height: 6, rx: 2 }),
      svg("path", { class: `glyph-mark sev-${severity}`, d: GLYPHS[severity], transform: `translate(${near(scale.x((a + b) / 2))} ${y + 6}) scale(0.9)` }),
      svg("title", {}, finding.message));
    group.addEventListener("click", () => selectFinding(finding));
    root.append(group);
  }
  return { root, height, values: () => strips.map(({ label, at }) => [label, at(selection.demo)]) };
};

const shortName = (demo) => (nameOf(demo).length > 13 ? `${nameOf(demo).slice(0, 12)}…` : nameOf(demo));

const plots = { panels: [], width: 0 };

const drawPanel = (number, width, scale) => {
  const { title, unit, factor, series } = REPORT.panels[number];
  const curves = series.map((_, i) => framesOf(panelValues(`${number} ${i}`), selection.demo));
  const others = selection.other === null ? [] : series.map((_, i) => framesOf(panelValues(`${number} ${i}`), selection.other));
  const range = valueRange([...curves, ...others]);
  const { height, top, bottom } = PLOT;
  const root = svg("svg", { class: "chart panel", "data-panel": title, width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${title} over frames${range === null ? ", not recorded" : `, from ${figure(range[0] * factor)} to ${figure(Math.max(...curves.map((c) => c.reduce((a, b) => (b > a ? b : a), -Infinity))) * factor)} ${unit}`}` });
  modeBands(root, scale, top, height - top - bottom);
  findingBands(root, scale, top, height - top - bottom);
  const heading = svg("text", { class: "title", x: PLOT.left, y: 14 }, title, svg("tspan", { class: "unit" }, unit ? `  ${unit}` : ""));
  root.append(heading);
  let words = null;
  if (range === null) {
    root.append(svg("text", { class: "tick", x: PLOT.left + 8, y: (top + height) / 2 + 4 }, "not recorded"));
  } else {
    const y = (value) => height - bottom - ((value - range[0]) / (range[1] - range[0])) * (height - top - bottom);
    for (const tick of niceTicks(range[0] * factor, range[1] * factor)) {
      root.append(
        svg("line", { class: "grid", x1: PLOT.left, x2: width - PLOT.right, y1: y(tick / factor), y2: y(tick / factor) }),
        svg("text", { class: "tick", x: PLOT.left - 6, y: y(tick / factor) + 4, "text-anchor": "end" }, figure(tick)),
      );
    }
    others.forEach((values, i) => root.append(svg("path", { class: `curve other curve-${i}`, "clip-path": "url(#plot-clip)", d: curvePath(values, scale, y) })));
    curves.forEach((values, i) => root.append(svg("path", { class: `curve curve-${i}`, "clip-path": "url(#plot-clip)", d: curvePath(values, scale, y) })));
    words = svg("text", { class: "values", x: width - PLOT.right, y: 14, "text-anchor": "end" });
    root.append(words);
  }
  return { root, curves, words, series, unit, factor, y: range === null ? null : range };
};

const panelValueWords = (panel, frame) =>
  panel.series.flatMap(({ label }, i) => {
    const value = panel.curves[i][frame];
    const text = value === undefined || !Number.isFinite(value) ? "–" : figure(value * panel.factor);
    return [svg("tspan", { class: `key curve-${i}` }, `${i > 0 ? "   " : ""}${label ? `${label} ` : ""}`), svg("tspan", { class: "number", "data-value": value ?? "" }, text)];
  });

const drawAxis = (width, scale) => {
  const root = svg("svg", { class: "chart", width, height: PLOT.axis, viewBox: `0 0 ${width} ${PLOT.axis}`, "aria-hidden": "true" });
  const gap = tickGap(scale.end - scale.first, scale.room);
  for (let frame = Math.ceil(scale.first / gap) * gap; frame < scale.end; frame += gap) {
    root.append(svg("text", { class: "tick", x: scale.x(frame + 0.5), y: 13, "text-anchor": "middle" }, String(frame)));
  }
  root.append(svg("text", { class: "axis", x: PLOT.left - 6, y: 13, "text-anchor": "end" }, "frame"));
  return root;
};

const drawPlots = () => {
  const host = byId("evidence-plots");
  const width = Math.floor(host.clientWidth);
  if (width === 0 || selection.demo < 0) return;
  plots.width = width;
  const scale = plotScale(width);
  const strips = drawStrips(width, scale);
  plots.panels = REPORT.panels.map((_, number) => drawPanel(number, width, scale));
  const crosshair = html("div", { class: "crosshair" });
  const brush = html("div", { class: "brush" });
  host.replaceChildren(strips.root, ...plots.panels.map(({ root }) => root), drawAxis(width, scale), crosshair, brush);
  plots.crosshair = crosshair;
  plots.brush = brush;
  host.dataset.first = scale.first;
  host.dataset.end = scale.end;
  byId("whole").disabled = selection.range === null;
  showFrame();
};

const stateWords = (demo, frame) => {
  const segment = SEGMENTS_OF[demo].find(({ first, end }) => frame >= first && frame < end);
  const flags = REPORT.flags.map(({ label }, flag) => `${label}: ${FLAG_WORDS[framesOf(flagValues(flag), demo)[frame]]}`);
  return [segment ? (segment.transfer ? "transfer" : "transit") : "no mode", ...flags].join(" · ");
};

// Shows the crosshair and the values at the selected frame; without a selected frame, only the names of the curves.
const showFrame = () => {
  if (plots.crosshair === undefined || selection.demo < 0) return;
  const { demo, frame } = selection;
  const [first, end] = shownRange();
  const shown = frame !== null && frame >= first && frame < end;
  plots.crosshair.classList.toggle("open", shown);
  if (shown) plots.crosshair.style.transform = `translateX(${plotScale(plots.width).x(frame + 0.5)}px)`;
  for (const panel of plots.panels) {
    if (panel.words === null) continue;
    panel.words.replaceChildren(...(shown ? panelValueWords(panel, frame) : panel.series.filter(({ label }) => label).map(({ label }, i) => svg("tspan", { class: `key curve-${i}` }, `${i > 0 ? "   " : ""}${label}`))));
  }
  const time = (frame ?? 0) * REPORT.frame_seconds;
  byId("readout").textContent = shown
    ? `Frame ${frame} (${time.toFixed(2)} s) · ${stateWords(demo, frame)}`
    : `${spanWords({ first, end }).replace("frame", "Frame")} of ${DEMOS.frames[demo]}${selection.range === null ? "" : ", zoomed in"}`;
  byId("readout").dataset.frame = shown ? frame : "";
};

const findingItem = (finding) => {
  const severity = SEVERITIES[finding.severity];
  const compared = finding.value === null ? "" : `${figure(finding.value)}${finding.unit ? ` ${finding.unit}` : ""}${finding.threshold === null ? "" : ` (threshold ${figure(finding.threshold)})`}`;
  const button = html("button", { type: "button", class: "finding", "data-finding": finding.number, "aria-pressed": finding.number === selection.finding, title: CHECKS.get(finding.code)?.meaning },
    glyph(severity),
    html("span", { class: "text" },
      html("span", { class: "kind-line" }, html("b", {}, wordsOf(finding.code)), html("span", { class: "soft" }, ` ${isWhole(finding) ? "whole demonstration" : spanWords(finding)}`), compared ? html("span", { class: "soft" }, ` · ${compared}`) : ""),
      html("span", { class: "message" }, finding.message)));
  button.addEventListener("click", () => (finding.number === selection.finding ? selectRange(null) : selectFinding(finding)));
  return html("li", {}, button);
};

const showFindings = () => {
  const { demo } = selection;
  const found = [...FINDINGS_OF[demo]].sort((a, b) => a.severity - b.severity || a.first - b.first);
  byId("evidence-findings").replaceChildren(...(found.length > 0 ? found.map(findingItem) : [html("li", { class: "soft" }, "This demonstration has no findings.")]));
};

const markFinding = () => {
  for (const button of byId("evidence-findings").querySelectorAll("button")) button.setAttribute("aria-pressed", Number(button.dataset.finding) === selection.finding);
};

const segmentCells = (segment) => {
  const outcome = GRASPS_OF[segment.demo].find((grasp) => grasp.segment === segment.number)?.outcome ?? "";
  const planar = REPORT.outline !== null;
  if (REPORT.object === false) return [[`${segment.first}–${segment.end - 1}`], [String(segment.end - segment.first)], [segment.separation === null ? "–" : digits(100 * segment.separation, 0)], [lengthWords(segment.displacement)]];
  const angle = segment.residual_rotation === null ? "–" : digits((segment.residual_rotation * 180) / Math.PI, 2);
  return [
    [`${segment.first}–${segment.end - 1}`],
    [String(segment.end - segment.first)],
    ...(planar ? [] : [[segment.settled === null ? "–" : String(segment.settled)], [lengthWords(segment.separation)]]),
    [lengthWords(segment.residual)],
    ...(planar ? [] : [[angle]]),
    [lengthWords(segment.displacement)],
    ...(planar ? [] : [[lengthWords(segment.rise)], [outcome || "–", outcome]]),
  ];
};

const showSegments = () => {
  byId("segments").tBodies[0].replaceChildren(...SEGMENTS_OF[selection.demo].map((segment) => {
    const mode = segment.transfer ? "transfer" : "transit";
    const button = html("button", { type: "button", class: "link", title: "Zoom in on these frames" }, mode);
    button.addEventListener("click", () => selectRange(segment.end - segment.first >= DEMOS.frames[segment.demo] ? null : [Math.max(0, segment.first - 3), Math.min(DEMOS.frames[segment.demo], segment.end + 3)]));
    return html("tr", {},
      html("th", { scope: "row" }, html("span", { class: "name" }, html("span", { class: `swatch ${mode}` }), button)),
      ...segmentCells(segment).map(([words, outcome]) => html("td", { class: outcome ? `figure outcome ${outcome}` : "figure" }, words)));
  }));
};

const showDemo = () => {
  const { demo } = selection;
  byId("evidence-title").textContent = nameOf(demo);
  byId("evidence").dataset.demo = DEMOS.number[demo];
  const summary = [
    counted(DEMOS.frames[demo], "frame"), `${(DEMOS.frames[demo] * REPORT.frame_seconds).toFixed(1)} s`, `${Math.round(100 * transferFraction(demo))} % transfer`,
    counted(DEMOS.segments[demo], "segment"), ...(REPORT.object === false ? [] : [`object displacement ${lengthWords(DEMOS.displacement[demo])} ${LENGTH.unit}`]), severityWords(demo),
  ];
  byId("evidence-summary").textContent = summary.join(" · ");
  showFindings();
  showShots();
  showCompare();
  showSegments();
};

// The camera images at the findings of the demonstration.
const showShots = () => {
  const { finding, frame, png } = REPORT.shots;
  const own = finding.map((_, shot) => shot).filter((shot) => FINDINGS[finding[shot]].demo === selection.demo);
  byId("shots").replaceChildren(...own.map((shot) => {
    const { code } = FINDINGS[finding[shot]];
    const words = `${wordsOf(code)}, frame ${frame[shot]}`;
    const button = html("button", { type: "button", class: "shot" }, html("img", { src: `data:image/png;base64,${png[shot]}`, alt: words, width: 126, height: 126 }), html("span", {}, words));
    button.addEventListener("click", () => {
      selectFinding(FINDINGS[finding[shot]]);
      selectFrame(frame[shot]);
    });
    return button;
  }));
};

// The demonstrations that the selected one can be compared with: those that its findings name, the nearest one, and its neighbours in
// the list.
const showCompare = () => {
  const { demo } = selection;
  const row = SCORE_ROW.get(demo);
  const nearest = row === undefined ? null : REPORT.scores.nearest[row];
  const place = view.order.indexOf(demo);
  const candidates = [
    ...twinsOf(demo).map((other) => [other, "named by a finding"]),
    ...(nearest === null ? [] : [[nearest, `nearest, ${figure(scoreColumn("novelty").valueOf(demo) * LENGTH.factor, 3)} ${LENGTH.unit}`]]),
    ...[view.order[place - 1], view.order[place + 1]].filter((other) => other !== undefined && place >= 0).map((other) => [other, "listed next to it"]),
  ].filter(([other], at, all) => DEMOS.frames[other] > 0 && all.findIndex(([first]) => first === other) === at);
  byId("compare").replaceChildren(html("option", { value: "" }, "no other"), ...candidates.map(([other, why]) => html("option", { value: other }, `${nameOf(other)} (${why})`)));
  byId("compare").value = selection.other ?? "";
};

const brushing = { from: null };

const onPlotKey = (event) => {
  const [first, end] = shownRange();
  if (event.key === "Escape") {
    selectRange(null);
  } else if (event.key === "ArrowUp" || event.key === "ArrowDown") {
    walkDemos(event.key === "ArrowUp" ? -1 : 1);
  } else {
    const steps = { ArrowLeft: -1, ArrowRight: 1, Home: -Infinity, End: Infinity }[event.key];
    if (steps === undefined) return;
    const from = selection.frame ?? (steps > 0 ? first - 1 : end);
    selectFrame(clamp(from + steps, first, end - 1));
  }
  event.preventDefault();
};

const setUpBrush = (host) => {
  const at = (event) => event.clientX - host.getBoundingClientRect().left;
  const frameAt = (event) => plotScale(plots.width).frame(at(event));
  host.addEventListener("pointerdown", (event) => {
    if (event.button === 0 && event.pointerType !== "touch" && event.target.closest(".found") === null) brushing.from = at(event);
  });
  host.addEventListener("pointermove", (event) => {
    selectFrame(frameAt(event));
    if (brushing.from === null) return;
    const [a, b] = [Math.min(brushing.from, at(event)), Math.max(brushing.from, at(event))];
    plots.brush.classList.toggle("open", b - a > 5);
    plots.brush.style.transform = `translateX(${a}px)`;
    plots.brush.style.width = `${b - a}px`;
  });
  window.addEventListener("pointerup", (event) => {
    if (brushing.from === null) return;
    const [from, to] = [brushing.from, at(event)].sort((a, b) => a - b);
    brushing.from = null;
    plots.brush?.classList.remove("open");
    const scale = plotScale(plots.width);
    const range = [scale.frame(from), scale.frame(to) + 1];
    if (to - from > 5 && range[1] - range[0] >= 3) selectRange(range);
  });
  host.addEventListener("pointerleave", () => {
    if (brushing.from === null) selectFrame(null);
  });
};

const setUpEvidence = () => {
  const host = byId("evidence-plots");
  byId("previous-demo").addEventListener("click", () => walkDemos(-1));
  byId("next-demo").addEventListener("click", () => walkDemos(1));
  byId("whole").addEventListener("click", () => selectRange(null));
  byId("compare").addEventListener("change", (event) => {
    selection.other = event.target.value === "" ? null : Number(event.target.value);
    drawPlots();
  });
  host.addEventListener("keydown", onPlotKey);
  setUpBrush(host);
  onWidth(host, drawPlots);
  listeners.demo.push(showDemo);
  listeners.range.push(markFinding, drawPlots);
  listeners.frame.push(showFrame);
};
