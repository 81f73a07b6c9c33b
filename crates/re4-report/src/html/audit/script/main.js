for (const shape of document.querySelectorAll("path[data-glyph]")) shape.setAttribute("d", GLYPHS[shape.dataset.glyph]);
readColours();
setUpFilters();
setUpTimelines();
setUpEvidence();
setUpGrasps();
setUpScores();
setUpKeep();
arrange();
if (COUNT === 0) byId("evidence").hidden = true;
else followAddress();
revealChosen();
window.addEventListener("hashchange", followAddress);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  readColours();
  drawTimelinesSoon();
  drawAllGrasps();
});
document.documentElement.dataset.ready = "true";
