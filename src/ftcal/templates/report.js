"use strict";
// WebGL does not print: paper gets a picture of the scene as it was first drawn.
async function keepForPrint(place) {
  const picture = document.createElement("img");
  picture.className = "printed";
  picture.alt = "";
  picture.src = await Plotly.toImage(place, { width: 900, height: 520, format: "png" });
  place.after(picture);
}

// One figure after another, so that the page can be read while the later ones are drawn.
(async () => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const config = { responsive: true, displaylogo: false };
  for (const [id, figure] of Object.entries(figures)) {
    const place = document.getElementById(id);
    try {
      await Plotly.newPlot(place, figure.data, figure.layout, config);
      if (figure.layout.scene) await keepForPrint(place);
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
