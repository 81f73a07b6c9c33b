// What is looked at: a demonstration, a range of its frames, a frame, a finding; which demonstrations are shown, in which order.
const selection = { demo: -1, range: null, frame: null, finding: null };
const view = { sort: "worst", reversed: false, scale: "frames", text: "", severities: new Set(), codes: new Set(), order: [] };
const listeners = { demo: [], range: [], frame: [], view: [] };
const tell = (what) => listeners[what].forEach((act) => act());

// Quietly: without a change of the page's address, which was followed.
const selectDemo = (demo, { range = null, finding = null, quiet = false } = {}) => {
  if (demo < 0 || demo >= COUNT) return;
  const other = demo !== selection.demo;
  Object.assign(selection, { demo, range, finding, frame: other ? null : selection.frame });
  if (other) tell("demo");
  tell("range");
  tell("frame");
  if (quiet) return;
  warnOfAddress("");
  writeAddress();
};

const selectRange = (range, finding = null) => selectDemo(selection.demo, { range, finding });

// The frames of a finding with some round it.
const aroundFinding = (finding) => {
  const frames = DEMOS.frames[finding.demo];
  if (isWhole(finding)) return null;
  const room = Math.max(8, Math.round(0.7 * (finding.end - finding.first)));
  const range = [Math.max(0, finding.first - room), Math.min(frames, finding.end + room)];
  return range[1] - range[0] >= frames ? null : range;
};

const selectFinding = (finding) => selectDemo(finding.demo, { range: aroundFinding(finding), finding: finding.number });

const selectFrame = (frame) => {
  if (frame === selection.frame) return;
  selection.frame = frame;
  tell("frame");
};

// Filters.
const isFiltered = () => view.text !== "" || view.severities.size > 0 || view.codes.size > 0;
const wanted = ({ severity, code }) =>
  (view.severities.size === 0 || view.severities.has(SEVERITIES[severity])) && (view.codes.size === 0 || view.codes.has(code));
const says = ({ code, message }) => `${wordsOf(code)} ${code} ${message}`.toLowerCase().includes(view.text);
const isNamed = (demo) => nameOf(demo).toLowerCase().includes(view.text);

// Findings of a demonstration that the filter lets pass.
const passing = (demo) => FINDINGS_OF[demo].filter((finding) => wanted(finding) && (view.text === "" || isNamed(demo) || says(finding)));
const isShown = (demo) => {
  if (!isFiltered()) return true;
  if (passing(demo).length > 0) return true;
  return view.severities.size === 0 && view.codes.size === 0 && isNamed(demo);
};

const share = (demo) => DEMOS.transfer[demo] / Math.max(1, DEMOS.frames[demo]);
const ORDERS = {
  worst: (a, b) => DEMOS.errors[b] - DEMOS.errors[a] || DEMOS.warnings[b] - DEMOS.warnings[a] || DEMOS.notes[b] - DEMOS.notes[a],
  number: () => 0,
  length: (a, b) => DEMOS.frames[a] - DEMOS.frames[b],
  share: (a, b) => share(a) - share(b),
  // Demonstrations without a grasp come last.
  grasp: (a, b) => (DEMOS.grasp[a] ?? Infinity) - (DEMOS.grasp[b] ?? Infinity) || 0,
};

const arrange = () => {
  const way = view.reversed ? -1 : 1;
  const compare = ORDERS[view.sort];
  view.order = Array.from({ length: COUNT }, (_, demo) => demo).filter(isShown);
  view.order.sort((a, b) => way * (compare(a, b) || a - b));
  tell("view");
};

const walkDemos = (steps) => {
  const { order } = view;
  if (order.length === 0) return;
  const at = order.indexOf(selection.demo);
  // From a demonstration that the filter hides, to the first one.
  selectDemo(order[at < 0 ? 0 : clamp(at + steps, 0, order.length - 1)]);
};

// The place in the page's address: #demo=<name>, and &frames=<first>-<last> where a part is looked at.
const addressOf = () => {
  const { demo, range } = selection;
  return `#demo=${encodeURIComponent(nameOf(demo))}${range === null ? "" : `&frames=${range[0]}-${range[1] - 1}`}`;
};

let addressTimer = 0;
const writeAddress = () => {
  clearTimeout(addressTimer);
  addressTimer = setTimeout(() => {
    if (location.hash !== addressOf()) history.replaceState(null, "", addressOf());
  }, 250);
};

const warnOfAddress = (words) => {
  const notice = byId("address-notice");
  notice.classList.toggle("gone", words === "");
  notice.textContent = words;
};

// Names with blanks are written with percent signs; what is not well-formed stays as it is.
const decoded = (text) => {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
};

// The place that an address names: a demonstration by its name, and a range of its frames; words where there is none.
const placeOf = (hash) => {
  const found = /^#demo=([^&]+)(?:&frames=(\d+)-(\d+))?$/.exec(hash);
  if (found === null) {
    // The page's own links to its parts are no places of this kind.
    const dead = hash.length > 1 && byId(hash.slice(1)) === null;
    return { words: dead ? `The link ${hash} leads nowhere in this page. Links look like #demo=${encodeURIComponent(DEMOS.name[0] ?? "demo_0")}.` : "" };
  }
  const called = decoded(found[1]);
  const demo = DEMOS.name.indexOf(called);
  if (demo < 0) {
    const names = COUNT > 0 ? `, ${nameOf(0)} to ${nameOf(COUNT - 1)}` : "";
    return { words: `The link leads to ${called}, which this audit does not have: it has ${counted(COUNT, "demonstration")}${names}.` };
  }
  if (found[2] === undefined) return { demo, range: null, words: "" };
  const frames = DEMOS.frames[demo];
  const range = [Number(found[2]), Number(found[3]) + 1];
  if (range[0] < range[1] && range[1] <= frames) return { demo, range, words: "" };
  return { demo, range: null, words: `The link leads to frames ${found[2]} to ${found[3]} of ${nameOf(demo)}, which has ${counted(frames, "frame")}; all of them are shown.` };
};

const followAddress = () => {
  const { demo, range, words } = placeOf(location.hash);
  if (demo !== undefined) selectDemo(demo, { range, quiet: true });
  else if (selection.demo < 0) selectDemo(view.order[0], { quiet: true });
  warnOfAddress(words);
};
