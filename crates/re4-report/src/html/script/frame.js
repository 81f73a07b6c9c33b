// The frame of a chart: horizontal grid lines with their values, and ticks below. Returns the SVG and the mapping from values to
// pixels.
const chartFrame = (width, { height, left, right, top, bottom, y, yTicks, x, xTicks, xLabel, name }) => {
  const place = {
    x: (value) => left + ((value - x[0]) / (x[1] - x[0] || 1)) * (width - left - right),
    y: (value) => height - bottom - ((value - y[0]) / (y[1] - y[0] || 1)) * (height - top - bottom),
  };
  const root = svg("svg", { class: "chart", width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": name });
  for (const tick of yTicks) {
    root.append(
      svg("line", { class: "grid", x1: left, x2: width - right, y1: place.y(tick), y2: place.y(tick) }),
      svg("text", { class: "tick", x: left - 8, y: place.y(tick) + 4, "text-anchor": "end" }, digits(tick, yTicks.length > 6 ? 2 : 1)),
    );
  }
  for (const [value, words] of xTicks) {
    root.append(svg("text", { class: "tick", x: place.x(value), y: height - bottom + 18, "text-anchor": "middle" }, words));
  }
  if (xLabel) {
    root.append(svg("text", { class: "axis", x: width - right, y: height - 4, "text-anchor": "end" }, xLabel));
  }
  return { root, place };
};
