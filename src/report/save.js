{
  const draw = Plotly.newPlot;
  const words = (text) => text.replace(/[^\p{L}\p{N}.]+/gu, "_").replace(/^_|_$/g, "");
  Plotly.newPlot = (id, plot) => {
    const filename = words(`${document.title} ${id.replace(/^plot-/, "")}`);
    return draw(id, { ...plot, config: { ...plot.config, toImageButtonOptions: { format: "svg", filename } } });
  };
}
