// In a narrow 3D plot the box is seen from farther away: its numbers and titles stay inside.
(() => {
  const plots = Array.from(document.querySelectorAll(".plotly-graph-div")).filter((plot) => plot.layout?.scene);
  const fit = () => {
    for (const plot of plots) {
      // Without the legend and the scale of colours.
      const { w, h } = plot._fullLayout._size;
      const factor = Math.max(1, h / w);
      const by = factor / (plot.farther ?? 1);
      if (!Number.isFinite(by) || Math.abs(by - 1) < 0.01) continue;
      plot.farther = factor;
      // From where it is seen now: it may have been turned.
      const { x, y, z } = plot.layout.scene.camera.eye;
      Plotly.relayout(plot, { "scene.camera.eye": { x: x * by, y: y * by, z: z * by } });
    }
  };
  fit();
  addEventListener("resize", fit);
})();
