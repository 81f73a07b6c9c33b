// The camera's image at a decision, with the object's frame as the policy observed it and as it was in the simulator.
const imagesOf = remember((number) => {
  const { images } = REPORT.artifacts[number];
  if (!images) return undefined;
  const places = unpack(images.places);
  const of = new Map();
  unpack(images.decision).forEach((decision, i) => {
    const points = Array.from({ length: 8 }, (_, k) => row(places, 2, 8 * i + k));
    of.set(decision, { png: images.png[i], estimate: points.slice(0, 4), simulated: points.slice(4) });
  });
  return of;
});

const AXES = ["x", "y", "z"];
const visible = (points) => points.every((point) => point.every(Number.isFinite));

const frameLines = (points, classes) =>
  points.slice(1).flatMap((end, i) => (visible([points[0], end]) ? [svg("path", { class: classes[i], d: line([points[0], end]) })] : []));

const frameMark = (points, name) => {
  if (!visible([points[0]])) return [];
  const [x, y] = points[0].map(near);
  return [svg("path", { class: name, d: `M${x - 1.6} ${y}h3.2M${x} ${y - 1.6}v3.2` })];
};

// The angle between two orientations.
const angleBetween = (a, b) => {
  const w = Math.abs(a.slice(3).reduce((sum, value, k) => sum + value * b[3 + k], 0));
  return 2 * Math.acos(Math.min(1, w));
};

const showImage = (data, decision) => {
  const place = byId("camera");
  if (place === null) return;
  const { images } = REPORT.artifacts[data.artifact];
  const image = imagesOf(data.artifact)?.get(decision?.row);
  place.hidden = image === undefined;
  if (image === undefined) return;
  const side = images.side;
  const simulated = data.object[decision.step];
  const offset = decision.object.slice(0, 3).map((value, k) => value - simulated[k]);
  const distance = apart(decision.object, simulated);
  const angle = angleBetween(decision.object, simulated);
  const caption = byId("camera-caption");
  caption.textContent = `${images.camera} · origins ${millimetres(distance)} apart (${offset.map((value) => digits(1000 * value, 1)).join(", ")}) · axes ${degrees(angle)} apart`;
  Object.assign(caption.dataset, { decision: decision.row, distance, angle });
  byId("camera-image").replaceChildren(svg(
    "svg",
    { class: "plane camera-image", viewBox: `0 0 ${side} ${side}`, role: "img", "aria-label": `Image of ${images.camera} at step ${decision.step}, with the frame of the object` },
    svg("image", { href: `data:image/png;base64,${image.png}`, width: side, height: side }),
    ...["simulated under", "simulated"].flatMap((name) => [...frameLines(image.simulated, [name, name, name]), ...frameMark(image.simulated, name)]),
    ...frameLines(image.estimate, AXES.map((axis) => `estimate ${axis}`)),
  ));
};
