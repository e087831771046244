"use strict";
// Draws the charts of a simulated run from the data above.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const font = getComputedStyle(document.body).fontFamily;
  const coarse = matchMedia("(pointer: coarse)").matches;

  function chart(parent, spec, height) {
    const box = document.createElement("div");
    box.className = "chart";
    const title = document.createElement("h4");
    title.textContent = spec.title;
    const plot = document.createElement("div");
    plot.setAttribute("role", "img");
    plot.setAttribute("aria-label", `${spec.title}, ${spec.axis} in ${spec.unit} over time in s`);
    box.append(title, plot);
    parent.appendChild(box);
    const traces = spec.lines.map(({ name, values, colour, dash }) => ({
      x: data.time, y: values, name, mode: "lines", hovertemplate: `%{y:.4~g} ${spec.unit}`,
      line: { color: colour, width: dash ? 1.6 : 2, dash: dash || "solid", simplify: false },
    }));
    const axis = { gridcolor: "#e8ebef", zerolinecolor: "#c3cad2", linecolor: "#c3cad2", tickfont: { size: 11 }, fixedrange: coarse, automargin: true };
    Plotly.newPlot(plot, traces, {
      height,
      margin: { l: 46, r: 10, t: 6, b: 34 },
      font: { family: font, size: 12, color: "#33404d" },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      showlegend: false, hovermode: "x unified", dragmode: coarse ? false : "zoom",
      xaxis: { ...axis, range: [0, data.time[data.time.length - 1]], title: { text: "time [s]", font: { size: 11.5 }, standoff: 4 }, hoverformat: ".2f" },
      yaxis: { ...axis, title: { text: spec.unit ? `${spec.axis} [${spec.unit}]` : spec.axis, font: { size: 11.5 }, standoff: 6 } },
    }, { displayModeBar: false, responsive: true, scrollZoom: false });
  }

  function rows(id, groups) {
    const parent = document.getElementById(id);
    for (const group of groups) {
      const heading = document.createElement("h3");
      heading.textContent = group.title;
      const grid = document.createElement("div");
      grid.className = "charts";
      parent.append(heading, grid);
      for (const spec of group.charts) chart(grid, spec, 190);
    }
  }

  const pump = document.getElementById("pump-charts");
  for (const spec of data.pump) chart(pump, spec, 230);
  rows("joint-charts", data.joints);
  rows("cylinder-charts", data.cylinders);
})();
