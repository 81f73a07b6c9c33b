for (const shape of document.querySelectorAll("path[data-glyph]")) shape.setAttribute("d", GLYPHS[shape.dataset.glyph]);
readColours();
setUpFilters();
setUpTimelines();
setUpEvidence();
setUpGrasps();
arrange();
if (COUNT === 0) byId("evidence").hidden = true;
else if (!readAddress()) selectDemo(view.order[0]);
revealChosen();
window.addEventListener("hashchange", readAddress);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  readColours();
  drawTimelinesSoon();
  drawAllGrasps();
});
document.documentElement.dataset.ready = "true";
