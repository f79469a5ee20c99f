(() => {
  const plots = Array.from(document.querySelectorAll(".linked .plotly-graph-div"));
  let busy = false;
  for (const plot of plots) {
    if (!plot.on) continue;
    plot.on("plotly_relayout", (change) => {
      if (busy) return;
      let update = null;
      if (change["xaxis.range[0]"] !== undefined) {
        update = { "xaxis.range": [change["xaxis.range[0]"], change["xaxis.range[1]"]] };
      } else if (change["xaxis.range"] !== undefined) {
        update = { "xaxis.range": change["xaxis.range"] };
      } else if (change["xaxis.autorange"]) {
        update = { "xaxis.autorange": true };
      }
      if (!update) return;
      busy = true;
      Promise.all(plots.filter((p) => p !== plot).map((p) => Plotly.relayout(p, update))).finally(() => { busy = false; });
    });
  }
})();
