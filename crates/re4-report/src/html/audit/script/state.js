// The state of the page: the selected demonstration, range of frames, frame and finding; the demonstrations that are listed, and
// their order.
const selection = { demo: -1, range: null, frame: null, finding: null, other: null };
const view = { sort: "worst", reversed: false, scale: "frames", text: "", severities: new Set(), codes: new Set(), order: [] };
const listeners = { demo: [], range: [], frame: [], view: [] };
const notify = (what) => listeners[what].forEach((act) => act());

// The demonstrations that the findings of a demonstration name, such as the one that it duplicates.
const namedBy = ({ demo, code, message }) => {
  if (!/duplicate|same_actions|copy/.test(code)) return [];
  const words = new Set(message.split(/[\s,;:()]+/));
  return DEMOS.name.map((_, other) => other).filter((other) => other !== demo && (words.has(nameOf(other)) || (nameOf(other).includes(" ") && `${message},`.includes(`${nameOf(other)},`))));
};
const twinsOf = (demo) => [...new Set(FINDINGS_OF[demo].flatMap(namedBy))];
const twinOf = (demo) => twinsOf(demo)[0] ?? null;

// With `quiet`, the address of the page is not changed, because the selection comes from it.
const selectDemo = (demo, { range = null, finding = null, quiet = false } = {}) => {
  if (demo < 0 || demo >= COUNT) return;
  const other = demo !== selection.demo;
  Object.assign(selection, { demo, range, finding, frame: other ? null : selection.frame, other: other ? twinOf(demo) : selection.other });
  if (other) notify("demo");
  notify("range");
  notify("frame");
  if (quiet) return;
  warnOfAddress("");
  writeAddress();
};

const selectRange = (range, finding = null) => selectDemo(selection.demo, { range, finding });

// The frames of a finding with some context before and after them; null if these are all frames.
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
  notify("frame");
};

// Filters.
const isFiltered = () => view.text !== "" || view.severities.size > 0 || view.codes.size > 0;
const matchesButtons = ({ severity, code }) =>
  (view.severities.size === 0 || view.severities.has(SEVERITIES[severity])) && (view.codes.size === 0 || view.codes.has(code));
const matchesText = ({ code, message }) => `${wordsOf(code)} ${code} ${message}`.toLowerCase().includes(view.text);
const nameMatches = (demo) => nameOf(demo).toLowerCase().includes(view.text);

// The findings of a demonstration that match the filter.
const matching = (demo) => FINDINGS_OF[demo].filter((finding) => matchesButtons(finding) && (view.text === "" || nameMatches(demo) || matchesText(finding)));
const isShown = (demo) => {
  if (!isFiltered()) return true;
  if (matching(demo).length > 0) return true;
  return view.severities.size === 0 && view.codes.size === 0 && nameMatches(demo);
};

const transferFraction = (demo) => DEMOS.transfer[demo] / Math.max(1, DEMOS.frames[demo]);
const ORDERS = {
  worst: (a, b) => DEMOS.errors[b] - DEMOS.errors[a] || DEMOS.warnings[b] - DEMOS.warnings[a] || DEMOS.notes[b] - DEMOS.notes[a],
  number: () => 0,
  length: (a, b) => DEMOS.frames[a] - DEMOS.frames[b],
  fraction: (a, b) => transferFraction(a) - transferFraction(b),
  // Demonstrations without a grasp come last.
  grasp: (a, b) => (DEMOS.grasp[a] ?? Infinity) - (DEMOS.grasp[b] ?? Infinity) || 0,
};

// The worst rank first; demonstrations without a rank come last.
const byScore = (name) => {
  const { rankOf } = scoreColumn(name);
  return (a, b) => (rankOf(b) ?? -1) - (rankOf(a) ?? -1);
};

const arrange = () => {
  const sign = view.reversed ? -1 : 1;
  const compare = view.sort.startsWith("score ") ? byScore(view.sort.slice(6)) : ORDERS[view.sort];
  view.order = Array.from({ length: COUNT }, (_, demo) => demo).filter(isShown);
  view.order.sort((a, b) => sign * (compare(a, b) || a - b));
  notify("view");
};

const walkDemos = (steps) => {
  const { order } = view;
  if (order.length === 0) return;
  const at = order.indexOf(selection.demo);
  // If the filter hides the selected demonstration, the first listed one is selected.
  selectDemo(order[at < 0 ? 0 : clamp(at + steps, 0, order.length - 1)]);
};

// The fragment of the page's address for the selection: #demo=<name>, and &frames=<first>-<last> if a range is selected.
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

// Names are percent-encoded in addresses. Text that is not well-formed is returned unchanged.
const decoded = (text) => {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
};

// Parses the fragment of an address: returns the demonstration and the range of frames, or `words` that explain what is wrong
// with it.
const placeOf = (hash) => {
  const found = /^#demo=([^&]+)(?:&frames=(\d+)-(\d+))?$/.exec(hash);
  if (found === null) {
    // Links to sections of the page are valid, but select no demonstration.
    const dead = hash.length > 1 && byId(hash.slice(1)) === null;
    return { words: dead ? `The link ${hash} matches nothing on this page. Links to demonstrations look like #demo=${encodeURIComponent(DEMOS.name[0] ?? "demo_0")}.` : "" };
  }
  const name = decoded(found[1]);
  const demo = DEMOS.name.indexOf(name);
  if (demo < 0) {
    const names = COUNT > 0 ? `, ${nameOf(0)} to ${nameOf(COUNT - 1)}` : "";
    return { words: `The link names the demonstration ${name}, which is not in this audit of ${counted(COUNT, "demonstration")}${names}.` };
  }
  if (found[2] === undefined) return { demo, range: null, words: "" };
  const frames = DEMOS.frames[demo];
  const range = [Number(found[2]), Number(found[3]) + 1];
  if (range[0] < range[1] && range[1] <= frames) return { demo, range, words: "" };
  return { demo, range: null, words: `The link names frames ${found[2]} to ${found[3]} of ${nameOf(demo)}, which has only ${counted(frames, "frame")}. All frames are shown.` };
};

const followAddress = () => {
  const { demo, range, words } = placeOf(location.hash);
  if (demo !== undefined) selectDemo(demo, { range, quiet: true });
  else if (selection.demo < 0) selectDemo(view.order[0], { quiet: true });
  warnOfAddress(words);
};
