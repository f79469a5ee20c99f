// Paper is narrower than a screen, and shows no WebGL: flat plots are drawn again at its width, 3D plots have an image of themselves.
(() => {
  const PAPER_PX = 690;
  const plots = Array.from(document.querySelectorAll(".plotly-graph-div")).filter((plot) => plot.layout);
  const flat = plots.filter((plot) => !plot.layout.scene);
  for (const plot of plots.filter((plot) => plot.layout.scene)) {
    const image = document.createElement("img");
    image.className = "on-paper";
    image.alt = "";
    plot.after(image);
    plot.classList.add("on-screen");
    const take = () => {
      const height = plot.clientHeight;
      Plotly.toImage(plot, { format: "png", width: PAPER_PX, height, scale: 2 }).then((url) => { image.src = url; });
    };
    take();
    plot.on("plotly_relayout", take);
  }
  addEventListener("beforeprint", () => {
    for (const plot of flat) Plotly.relayout(plot, { width: PAPER_PX, height: plot.clientHeight });
  });
  addEventListener("afterprint", () => {
    for (const plot of flat) {
      delete plot.layout.width;
      delete plot.layout.height;
      Plotly.relayout(plot, { autosize: true });
    }
  });
})();
