// Draws the maps of a library, as report/library_page.py makes their data, and energy against duration.
"use strict";
const library = JSON.parse(document.getElementById("data").textContent);
const plain = {displayModeBar: false, responsive: true};

function map(parent, title, unit, points, value) {
  const there = points.filter(p => value(p) !== null), nowhere = points.filter(p => value(p) === null);
  const lost = nowhere.map(p => p.at).concat(library.unreachable);
  Plotly.react(parent, [
    {type: "scatter", mode: "markers", name: title, x: there.map(p => p.at[0]), y: there.map(p => p.at[1]),
     text: there.map(p => `${value(p).toFixed(1)} ${unit}, z ${p.at[2]} m`), hoverinfo: "x+y+text",
     marker: {size: 18, symbol: "square", color: there.map(value), colorscale: "Viridis", showscale: true,
              colorbar: {title: {text: unit}}}},
    {type: "scatter", mode: "markers", name: "no motion", x: lost.map(at => at[0]), y: lost.map(at => at[1]),
     hoverinfo: "x+y", marker: {size: 11, symbol: "x", color: "#b3261e"}},
    {type: "scatter", mode: "markers", name: "crane", x: [0], y: [0], hoverinfo: "name",
     marker: {size: 12, symbol: "triangle-right", color: "#17202b"}},
  ], {title: {text: title}, height: 480, showlegend: false, margin: {l: 60, r: 20, t: 50, b: 50},
      xaxis: {title: {text: "x [m]"}}, yaxis: {title: {text: "y [m]"}, scaleanchor: "x"}}, plain);
}

function show(which) {
  const chosen = library.maps[which];
  if (!chosen) return;
  map("energy-map", "Energy of a movement", "kJ", chosen.points, p => p.energy === null ? null : p.energy / 1e3);
  map("saving-map", "Saving against the pseudo-inverse", "%", chosen.points, p => p.saving === null ? null : 100 * p.saving);
}

const which = document.getElementById("which");
which.addEventListener("change", () => show(Number(which.value)));
show(0);
Plotly.newPlot("duration-curves", library.curves.map(curve => ({
  type: "scatter", mode: "lines+markers", name: curve.name,
  x: curve.points.map(p => p[0]), y: curve.points.map(p => p[1] / 1e3),
})), {height: 360, margin: {l: 60, r: 20, t: 20, b: 50}, xaxis: {title: {text: "duration [s]"}},
      yaxis: {title: {text: "mean energy [kJ]"}, rangemode: "tozero"}}, plain);
