"use strict";
// Draws charts over time, as report/charts.py makes them; the returned function moves their cursors to a time.
const data = JSON.parse(document.getElementById("data").textContent);

function drawCharts(data) {
  const font = getComputedStyle(document.body).fontFamily;
  const coarse = matchMedia("(pointer: coarse)").matches;
  const end = data.time[data.time.length - 1];
  const cursors = [];
  let now = null;

  // The range of a chart's values, with room around them.
  function range(spec) {
    const values = [...spec.lines.map((line) => line.values), spec.limits, spec.zero ? [0] : []].flat().filter((value) => value !== null);
    let low = values.length ? Math.min(...values) : 0, high = values.length ? Math.max(...values) : 0;
    if (!(high > low)) { low -= 1; high += 1; }
    const room = 0.06 * (high - low);
    return [low - room, high + room];
  }

  function chart(parent, spec, height) {
    const box = document.createElement("div");
    box.className = "chart";
    const title = document.createElement("h4");
    if (spec.dot) { const dot = document.createElement("i"); dot.style.background = spec.dot; title.appendChild(dot); }
    title.appendChild(document.createTextNode(spec.title));
    const plot = document.createElement("div");
    plot.setAttribute("role", "img");
    plot.setAttribute("aria-label", `${spec.title}, ${spec.axis} over time [s]`);
    const cursor = document.createElement("div");
    cursor.className = "cursor";
    box.append(title, plot, cursor);
    parent.appendChild(box);

    const traces = spec.lines.map(({ name, values, colour, dash }) => ({
      x: data.time, y: values, name, mode: "lines", hovertemplate: `%{y:.4~g} ${spec.unit}`,
      line: { color: colour, width: dash ? 1.6 : 2.2, dash: dash || "solid", simplify: false },
    }));
    const axis = { gridcolor: "#e8ebef", zerolinecolor: "#c3cad2", linecolor: "#c3cad2", tickfont: { size: 11 }, fixedrange: coarse, automargin: true };
    Plotly.newPlot(plot, traces, {
      height,
      margin: { l: 46, r: 10, t: 6, b: 34 },
      font: { family: font, size: 12, color: "#33404d" },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      showlegend: false, hovermode: "x unified", dragmode: coarse ? false : "zoom",
      hoverlabel: { font: { size: 12 } },
      xaxis: { ...axis, range: [0, end], title: { text: "time [s]", font: { size: 11.5 }, standoff: 4 }, hoverformat: ".2f", unifiedhovertitle: { text: "%{x} s" } },
      yaxis: { ...axis, range: range(spec), title: { text: spec.axis, font: { size: 11.5 }, standoff: 6 } },
      shapes: spec.limits.map((value) => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: value, y1: value, line: { color: "#b3261e", width: 1.4, dash: "2px,3px" } })),
    }, { displayModeBar: false, responsive: true, scrollZoom: false });
    const move = () => {
      const layout = plot._fullLayout, size = layout && layout._size;
      if (now === null || !size || !layout.xaxis || !layout.xaxis.l2p) return;
      const x = layout.xaxis.l2p(now);
      cursor.style.display = x >= -1 && x <= size.w + 1 ? "block" : "none";
      cursor.style.left = `${plot.offsetLeft + size.l + x}px`;
      cursor.style.top = `${plot.offsetTop + size.t}px`;
      cursor.style.height = `${size.h}px`;
    };
    cursors.push(move);
    plot.on("plotly_afterplot", move);
  }

  const pump = document.getElementById("pump-charts");
  for (const spec of data.pump) chart(pump, spec, 230);
  for (const [part, rows] of Object.entries(data.rows)) {
    for (const row of rows) {
      const heading = document.createElement("h3");
      heading.textContent = row.title;
      const grid = document.createElement("div");
      grid.className = "charts";
      document.getElementById(part).append(heading, grid);
      for (const spec of row.charts) chart(grid, spec, 190);
    }
  }
  return (time) => { now = time; cursors.forEach((move) => move()); };
}
