"use strict";
// One figure after another, so that the page can be read while the later ones are drawn.
(async () => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const config = { responsive: true, displaylogo: false };
  for (const [id, figure] of Object.entries(figures)) {
    const place = document.getElementById(id);
    try {
      await Plotly.newPlot(place, figure.data, figure.layout, config);
    } catch (error) {
      place.textContent = `This figure could not be drawn: ${error.message}`;
      console.error(error);
    }
    await new Promise((resolve) => setTimeout(resolve, 0));
  }
  document.body.dataset.drawn = "yes";
  window.addEventListener("beforeprint", () => {
    for (const id of Object.keys(figures)) Plotly.Plots.resize(id);
  });
})();
