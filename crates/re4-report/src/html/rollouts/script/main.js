for (const shape of document.querySelectorAll("path[data-mark]")) shape.setAttribute("d", MARKS[Number(shape.dataset.mark)]);
setUpOverview();
setUpTable();
setUpLegend();
const firstShown = REPORT.artifacts.findIndex(({ shown }) => shown.length > 0);
if (firstShown >= 0) {
  setUpViewer();
  if (!readAddress()) selectRollout(firstShown, REPORT.artifacts[firstShown].shown[0]);
  window.addEventListener("hashchange", () => {
    if (location.hash !== addressOf()) readAddress();
  });
} else {
  byId("viewer").hidden = true;
}
document.documentElement.dataset.ready = "true";
