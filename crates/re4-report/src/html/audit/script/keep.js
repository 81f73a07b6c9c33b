// The keep-list: the demonstrations to keep, which filters, scores and the text fields change.
const USABLE = Array.from({ length: COUNT }, (_, demo) => demo).filter((demo) => DEMOS.frames[demo] > 0);
const keep = new Set(USABLE);
listeners.keep = [];

const keptDemos = () => USABLE.filter((demo) => keep.has(demo));
const changeKeep = (act) => {
  act();
  notify("keep");
};
const setKept = (demos) => changeKeep(() => {
  keep.clear();
  for (const demo of demos) keep.add(demo);
});

// The setting of a pipeline file. Push-T's demonstrations are selected by their numbers.
const settingOf = (demos) => {
  const named = demos.map((demo) => /^episode (\d+)$/.exec(nameOf(demo))?.[1] ?? JSON.stringify(nameOf(demo)));
  return `[ingest]\nselect = { episodes = [${named.join(", ")}] }\n`;
};
const fileOf = (text) => `data:text/plain;charset=utf-8,${encodeURIComponent(text)}`;

const sayKeep = (words) => {
  byId("keep-notice").classList.toggle("gone", words === "");
  byId("keep-notice").textContent = words;
};

const showKeep = () => {
  const demos = keptDemos();
  const names = demos.map((demo) => `${nameOf(demo)}\n`).join("");
  const setting = settingOf(demos);
  if (document.activeElement !== byId("keep-text")) byId("keep-text").value = names;
  byId("keep-toml").value = setting;
  byId("save-names").href = fileOf(names);
  byId("save-toml").href = fileOf(setting);
  byId("keep-count").textContent = `${demos.length} of ${USABLE.length} kept`;
  byId("keep-count").dataset.kept = demos.length;
  showKeepOfDemo();
};

const showKeepOfDemo = () => {
  byId("keep-this").checked = keep.has(selection.demo);
  byId("keep-this").disabled = selection.demo < 0 || DEMOS.frames[selection.demo] === 0;
};

const readKeep = (text) => {
  const names = text.split("\n").map((name) => name.trim()).filter((name) => name !== "");
  const unknown = names.filter((name) => !DEMOS.name.includes(name));
  sayKeep(unknown.length === 0 ? "" : `No demonstration of this audit is named ${unknown.slice(0, 3).join(", ")}${unknown.length > 3 ? ` and ${unknown.length - 3} more` : ""}.`);
  const wanted = new Set(names);
  setKept(USABLE.filter((demo) => wanted.has(nameOf(demo))));
};

const setUpKeep = () => {
  if (COUNT === 0) return;
  byId("keep-all").addEventListener("click", () => setKept(USABLE));
  byId("drop-listed").addEventListener("click", () => setKept(keptDemos().filter((demo) => !view.order.includes(demo))));
  byId("keep-listed").addEventListener("click", () => setKept(USABLE.filter((demo) => view.order.includes(demo))));
  byId("drop-worst")?.addEventListener("click", () => {
    const column = scoreColumn(byId("drop-by").value);
    const ranked = keptDemos().filter((demo) => column.rankOf(demo) !== null).sort((a, b) => column.rankOf(b) - column.rankOf(a) || b - a);
    const dropped = new Set(ranked.slice(0, Number(byId("drop-count").value)));
    setKept(keptDemos().filter((demo) => !dropped.has(demo)));
  });
  byId("keep-text").addEventListener("input", (event) => readKeep(event.target.value));
  byId("keep-text").addEventListener("blur", showKeep);
  byId("keep-this").addEventListener("change", (event) => changeKeep(() => {
    if (event.target.checked) keep.add(selection.demo);
    else keep.delete(selection.demo);
  }));
  listeners.keep.push(showKeep, drawTimelinesSoon);
  listeners.demo.push(showKeepOfDemo);
  showKeep();
};
