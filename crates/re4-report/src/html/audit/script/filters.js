// The controls that filter and sort the timelines.
const toggleIn = (set, value) => (set.has(value) ? set.delete(value) : set.add(value));

const showFilters = () => {
  for (const button of document.querySelectorAll("[data-severity]")) button.setAttribute("aria-pressed", view.severities.has(button.dataset.severity));
  for (const button of document.querySelectorAll(".chip")) button.setAttribute("aria-pressed", view.codes.has(button.dataset.code));
  byId("clear-filters").classList.toggle("gone", !isFiltered());
  byId("shown-count").textContent = isFiltered() ? `${view.order.length} of ${COUNT}` : String(COUNT);
  byId("shown-count").dataset.shown = view.order.length;
  byId("no-rows").classList.toggle("gone", view.order.length > 0);
  byId("timeline-rows").classList.toggle("gone", view.order.length === 0);
};

const setUpFilters = () => {
  for (const button of document.querySelectorAll("[data-severity]")) {
    button.addEventListener("click", () => {
      toggleIn(view.severities, button.dataset.severity);
      arrange();
    });
  }
  for (const button of document.querySelectorAll(".chip")) {
    button.addEventListener("click", () => {
      toggleIn(view.codes, button.dataset.code);
      arrange();
    });
  }
  const text = byId("filter-text");
  text.addEventListener("input", () => {
    view.text = text.value.trim().toLowerCase();
    arrange();
  });
  byId("clear-filters").addEventListener("click", () => {
    view.severities.clear();
    view.codes.clear();
    view.text = "";
    text.value = "";
    arrange();
  });
  byId("sort").addEventListener("change", (event) => {
    view.sort = event.target.value;
    arrange();
  });
  byId("reverse").addEventListener("click", () => {
    view.reversed = !view.reversed;
    byId("reverse").setAttribute("aria-pressed", view.reversed);
    arrange();
  });
  onChoice("scale", () => {
    view.scale = checked("scale");
    notify("view");
  });
  listeners.view.push(showFilters);
};
