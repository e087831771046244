// Draws the crane of a plan, and moves the charts' cursors with it. Lengths in m; the drawing's unit is 1 cm.
(() => {
  const svgns = document.getElementById("side").namespaceURI;
  const font = getComputedStyle(document.body).fontFamily;

  // ---- crane ------------------------------------------------------------------------------------------------
  const g = data.crane;
  const colours = g.colours;
  const GHOST = "#9aa3ad";

  function add(parent, name, attributes, text) {
    const element = document.createElementNS(svgns, name);
    for (const key in attributes) element.setAttribute(key, attributes[key]);
    if (text !== undefined) element.textContent = text;
    parent.appendChild(element);
    return element;
  }
  const place = (point) => `${(100 * point[0]).toFixed(1)},${(-100 * point[1]).toFixed(1)}`;
  const line = (points) => points.map(place).join(" ");

  // Joint positions [base, lift, tilt, extension] to the points of the boom in its own plane.
  function boom(q) {
    const [, q2, q3, q4] = q;
    const s = Math.sin(q2 + q3), c = Math.cos(q2 + q3);
    const foot = [g.base_x, g.base_z];
    const knee = [foot[0] + g.boom * Math.cos(q2), foot[1] + g.boom * Math.sin(q2)];
    const heel = [knee[0] - g.offset * s, knee[1] + g.offset * c];
    const along = (length) => [heel[0] + length * c, heel[1] + length * s];
    return { foot, knee, heel, mouth: along(g.outer), tool: along(g.outer + q4), top: q[0] };
  }

  const labelled = []; // drawings and their labels, whose size is kept in pixels

  // Sets the extent of a drawing and its metre grid; returns the drawing's size [m] and a function that adds labels.
  function scale(svg, box) {
    const [x0, x1, z0, z1] = box;
    const size = Math.max(x1 - x0, z1 - z0);
    svg.setAttribute("viewBox", `${100 * x0} ${-100 * z1} ${100 * (x1 - x0)} ${100 * (z1 - z0)}`);
    const every = size > 24 ? 5 : size > 7 ? 2 : 1;
    const grid = add(svg, "g", { stroke: "#dfe4e9", "stroke-width": 0.14 * size });
    const texts = [];
    for (let x = Math.ceil(x0); x < x1; x += 1) {
      if (x % every) continue;
      add(grid, "line", { x1: 100 * x, x2: 100 * x, y1: -100 * z0, y2: -100 * z1 });
      if (x > x0 + 0.06 * size && x < x1 - 0.04 * size) texts.push([100 * x, -100 * z0, "middle", "-0.4em", x]);
    }
    for (let z = Math.ceil(z0); z < z1; z += 1) {
      if (z % every) continue;
      add(grid, "line", { x1: 100 * x0, x2: 100 * x1, y1: -100 * z, y2: -100 * z });
      if (z > z0 + 0.09 * size && z < z1 - 0.04 * size) texts.push([100 * x0, -100 * z, "start", "-0.3em", z]);
    }
    const label = () => {
      const group = add(svg, "g", { fill: "#4d5966", "font-family": font });
      for (const [x, y, anchor, dy, value] of texts)
        add(group, "text", { x, y, dy, dx: anchor === "start" ? "0.4em" : 0, "text-anchor": anchor }, `${value} m`);
      labelled.push([svg, group, 100 * (x1 - x0)]);
    };
    return [size, label];
  }

  function fit() {
    for (const [svg, group, width] of labelled) {
      const pixels = svg.getBoundingClientRect().width;
      if (pixels > 0) group.setAttribute("font-size", (12.5 * width) / pixels);
    }
  }

  // One boom of the side view: a function that moves it to joint positions.
  function sideBoom(svg, ghost) {
    const group = add(svg, "g", { "stroke-linecap": "round", "stroke-linejoin": "round", fill: "none" });
    if (ghost) group.setAttribute("opacity", "0.55");
    const w = g.thickness;
    const part = (width, colour) => add(group, "polyline", { "stroke-width": width, stroke: ghost ? GHOST : colour });
    const telescope = part(0.5 * w, colours.extension);
    const outer = part(0.82 * w, colours.tilt);
    const lift = part(w, colours.lift);
    const pins = [0, 1].map(() => add(group, "circle", { r: 0.3 * w, fill: "#fff", stroke: ghost ? GHOST : "#17202b", "stroke-width": 0.12 * w }));
    return (q) => {
      const p = boom(q);
      lift.setAttribute("points", line([p.foot, p.knee]));
      outer.setAttribute("points", line([p.knee, p.heel, p.mouth]));
      telescope.setAttribute("points", line([p.mouth, p.tool]));
      [p.foot, p.knee].forEach((point, i) => {
        pins[i].setAttribute("cx", 100 * point[0]);
        pins[i].setAttribute("cy", -100 * point[1]);
      });
    };
  }

  function tool(svg) {
    const w = g.thickness;
    const group = add(svg, "g", {});
    if (g.payload > 0) add(group, "rect", { x: -0.8 * w, y: 0.2 * w, width: 1.6 * w, height: 1.3 * w, rx: 0.15 * w, fill: "#8a6d3b", stroke: "#fff", "stroke-width": 0.08 * w });
    add(group, "circle", { r: 0.5 * w, fill: "#17202b", stroke: "#fff", "stroke-width": 0.14 * w });
    return (point) => group.setAttribute("transform", `translate(${100 * point[0]},${-100 * point[1]})`);
  }

  function pathOf(svg, points, size) {
    const thin = 0.4 * size;
    add(svg, "polyline", { points: line(points), fill: "none", stroke: "#17202b", "stroke-width": thin, "stroke-dasharray": `${2.2 * thin} ${2.2 * thin}` });
    const done = add(svg, "polyline", { fill: "none", stroke: "#17202b", "stroke-width": 1.5 * thin });
    return (share) => done.setAttribute("points", line(points.slice(0, Math.round(share * (points.length - 1)) + 1)));
  }

  function sideView(svg) {
    const [x0, x1, z0] = g.side;
    add(svg, "rect", { x: 100 * x0, y: 0, width: 100 * (x1 - x0), height: Math.max(0, -100 * z0), fill: "#ece8df" });
    const [size, label] = scale(svg, g.side);
    add(svg, "line", { x1: 100 * x0, x2: 100 * x1, y1: 0, y2: 0, stroke: "#8b8371", "stroke-width": 0.3 * size });
    label();
    const done = pathOf(svg, g.path_side, size);
    const ghost = data.frames.other ? sideBoom(svg, true) : null;
    const w = g.thickness / 100, x = g.base_x, z = g.base_z;
    const column = z > 0 ? [[-1.5 * w, 0], [1.5 * w, 0], [x + 0.7 * w, z], [x - 0.7 * w, z]] : [[0, 0], [x, z]];
    add(svg, "polygon", { points: line(column), fill: colours.base, stroke: colours.base, "stroke-width": 20 * w, "stroke-linejoin": "round" });
    const plan = sideBoom(svg, false);
    const hand = tool(svg);
    return (q, other, share) => {
      plan(q);
      if (ghost) ghost(other);
      hand(boom(q).tool);
      done(share);
    };
  }

  function topView(svg) {
    const [size, label] = scale(svg, g.above);
    const w = g.thickness;
    label();
    const done = pathOf(svg, g.path_above, size);
    const group = add(svg, "g", { "stroke-linecap": "round", fill: "none" });
    const part = (width, colour) => add(group, "polyline", { "stroke-width": width, stroke: colour });
    const telescope = part(0.5 * w, colours.extension), outer = part(0.82 * w, colours.tilt), lift = part(w, colours.lift);
    add(svg, "circle", { r: 1.1 * w, fill: colours.base });
    add(svg, "circle", { r: 0.4 * w, fill: "#fff" });
    const hand = tool(svg);
    const turn = (radius, angle) => [radius * Math.cos(angle), radius * Math.sin(angle)];
    return (q, other, share) => {
      const p = boom(q);
      lift.setAttribute("points", line([turn(p.foot[0], p.top), turn(p.knee[0], p.top)]));
      outer.setAttribute("points", line([turn(p.knee[0], p.top), turn(p.mouth[0], p.top)]));
      telescope.setAttribute("points", line([turn(p.mouth[0], p.top), turn(p.tool[0], p.top)]));
      hand(turn(p.tool[0], p.top));
      done(share);
    };
  }

  const views = [sideView(document.getElementById("side"))];
  if (g.slewing) {
    views.push(topView(document.getElementById("above")));
    const stage = document.getElementById("stage"); // one scale for both views
    stage.style.setProperty("--side", `${g.side[1] - g.side[0]}fr`);
    stage.style.setProperty("--above", `${g.above[1] - g.above[0]}fr`);
  }
  fit();
  addEventListener("resize", fit);

  // ---- time ---------------------------------------------------------------------------------------------------
  const slider = document.getElementById("time"), play = document.getElementById("play");
  const clock = document.getElementById("clock"), speed = document.getElementById("speed");
  const duration = data.duration;
  let now = data.opens_at, running = false, last = 0;

  const between = (rows, share) => {
    const at = share * (rows.length - 1), i = Math.min(Math.floor(at), rows.length - 2), f = at - i;
    return Array.isArray(rows[0]) ? rows[i].map((v, j) => v + f * (rows[i + 1][j] - v)) : rows[i] + f * (rows[i + 1] - rows[i]);
  };

  function show() {
    const share = duration > 0 ? now / duration : 0;
    const q = between(data.frames.plan.joints, share);
    const other = data.frames.other ? between(data.frames.other.joints, share) : null;
    views.forEach((view) => view(q, other, share));
    slider.value = String(Math.round(1000 * share));
    clock.textContent = `${now.toFixed(1)} s`;
    slider.setAttribute("aria-valuetext", clock.textContent);
    for (const cell of document.querySelectorAll("[data-now]")) {
      const [who, what] = cell.dataset.now.split(" ");
      const row = data.frames[who][what];
      cell.textContent = between(row.values, share).toFixed(row.digits);
    }
    moveCursors(now);
  }

  function step(stamp) {
    if (!running) return;
    now += (Math.min(Math.max(stamp - last, 0), 100) / 1000) * Number(speed.value);
    last = stamp;
    if (now >= duration) { now = duration; stop(); }
    show();
    if (running) requestAnimationFrame(step);
  }
  function stop() { running = false; play.textContent = "Play"; play.setAttribute("aria-label", "Play"); }
  play.addEventListener("click", () => {
    if (running) return stop();
    if (now >= duration) now = 0;
    running = true;
    play.textContent = "Pause";
    play.setAttribute("aria-label", "Pause");
    last = performance.now();
    requestAnimationFrame(step);
  });
  slider.addEventListener("input", () => { stop(); now = (Number(slider.value) / 1000) * duration; show(); });

  const moveCursors = drawCharts(data);
  show();
})();
