"use strict";
// Draws the page's plots from its own data when they come near, and links them and the bicycle by one time per section.
(() => {
  const page = JSON.parse(document.getElementById("report-data").textContent);
  const sections = new Map(); // name -> {time, views, draw}
  const rowsOf = new Map(); // section/name -> rows

  function section(name) {
    if (!sections.has(name)) sections.set(name, { time: null, views: [], movers: [] });
    return sections.get(name);
  }

  function rows(name, columns) {
    if (!rowsOf.has(name)) {
      const keys = Object.keys(columns);
      rowsOf.set(name, columns[keys[0]].map((_, i) => Object.fromEntries(keys.map((key) => [key, columns[key][i]]))));
    }
    return rowsOf.get(name);
  }

  function draw(plot) {
    if (plot.dataset.drawn) return;
    plot.dataset.drawn = "yes";
    const name = plot.dataset.section;
    const spec = structuredClone(page.specs[Number(plot.dataset.spec)]);
    const data = page.data[name];
    spec.autosize = { type: "fit-x", contains: "padding" };
    spec.width = Math.max(220, plot.clientWidth || 640);
    spec.datasets = {};
    for (const layer of spec.layer) {
      const wanted = layer.data && layer.data.name;
      if (wanted && data[wanted]) spec.datasets[wanted] = rows(name + "/" + wanted, data[wanted]);
    }
    if (spec.width < 420) narrow(spec);
    plot.textContent = "";
    // ast: Vega interprets its expressions, nothing on this page is compiled from text. What is awaited inside are
    // settled promises only, so that a plot asked for before printing is there when printing begins.
    vegaEmbed(plot, spec, { mode: "vega-lite", config: page.config, ast: true, renderer: "svg", actions: false, tooltip: false, hover: false, defaultStyle: false })
      .then((drawn) => {
        plot.style.minHeight = "";
        if (spec.params) follow(drawn.view, plot, section(name));
      });
  }

  // On a phone: fewer ticks, and the legend in two columns.
  function narrow(spec) {
    spec.config = { legend: { columns: 2 }, axisX: { tickCount: 4 } };
  }

  function follow(view, plot, part) {
    part.views.push(view);
    if (part.time !== null) view.signal("section_time", part.time).run();
    const point = (event) => {
      const svg = plot.querySelector("svg");
      const box = svg.getBoundingClientRect();
      const scale = svg.viewBox.baseVal.width ? svg.viewBox.baseVal.width / box.width : 1;
      const x = (event.clientX - box.left) * scale - view.origin()[0];
      if (x >= 0 && x <= view.width()) part.move(view.scale("x").invert(x));
    };
    plot.addEventListener("pointerdown", point);
    plot.addEventListener("pointermove", point);
  }

  // --- the bicycle -----------------------------------------------------------------------------------------
  const SVG = "http://www.w3.org/2000/svg";
  function shape(parent, tag, attributes) {
    const node = document.createElementNS(SVG, tag);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    return parent.appendChild(node);
  }
  function canvas(place, box) {
    return shape(place, "svg", { viewBox: box, "aria-hidden": "true" });
  }
  function at(motion, time) { // linear between samples, the ends held
    const t = motion.time;
    let high = t.findIndex((one) => one >= time);
    if (high === 0) high = 1;
    if (high < 0) high = t.length - 1;
    const share = Math.min(1, Math.max(0, (time - t[high - 1]) / (t[high] - t[high - 1])));
    return Object.fromEntries(Object.keys(motion).map((key) => [key, motion[key][high - 1] + share * (motion[key][high] - motion[key][high - 1])]));
  }

  function animate(place) {
    const name = place.dataset.section;
    const part = section(name);
    const motions = page.motions[name];
    const wheelbase = Number(place.dataset.wheelbase);
    const slider = place.querySelector("input.time");
    const readout = place.querySelector(".readout");
    const movers = [...behind(place, motions), ...above(place, motions, wheelbase), ...path(place, motions)];
    const degrees = (value) => (value * 180 / Math.PI).toFixed(1).replace("-", "\u2212") + "°";
    part.move = (time) => {
      part.time = time;
      slider.value = time;
      slider.setAttribute("aria-valuetext", time.toFixed(2) + " seconds");
      for (const mover of movers) mover(time);
      for (const view of part.views) view.signal("section_time", time).run();
      const now = at(motions.predicted, time);
      readout.textContent = time.toFixed(2).replace("-", "\u2212") + " s" + (time < 0 ? ": before the free response" :
        ": lean " + degrees(now.lean) + ", steer " + degrees(now.steer) + ", heading " + degrees(now.yaw) + " (predicted; to the right positive)");
    };
    slider.addEventListener("input", () => part.move(Number(slider.value)));
    play(place.querySelector(".play"), slider, part);
    part.move(0);
  }

  function play(button, slider, part) {
    let running = null;
    const stop = () => { cancelAnimationFrame(running); running = null; button.textContent = "Play"; };
    button.addEventListener("click", () => {
      if (running !== null) return stop();
      const first = Number(slider.value) >= Number(slider.max) - 0.02 ? Number(slider.min) : Number(slider.value);
      const began = performance.now();
      button.textContent = "Stop";
      const step = (now) => {
        const time = first + (now - began) / 1000;
        part.move(Math.min(time, Number(slider.max)));
        if (time >= Number(slider.max)) stop(); else running = requestAnimationFrame(step);
      };
      running = requestAnimationFrame(step);
    });
  }

  function behind(place, motions) {
    const svg = canvas(place.querySelector(".behind"), "-60 -110 120 125");
    shape(svg, "line", { x1: -55, y1: 0, x2: 55, y2: 0, class: "ground" });
    shape(svg, "line", { x1: 0, y1: 0, x2: 0, y2: -105, class: "guide" });
    return Object.keys(motions).map((kind) => {
      const frame = shape(svg, "g", {});
      shape(frame, "line", { x1: 0, y1: 0, x2: 0, y2: -95, class: kind + " bar" });
      shape(frame, "line", { x1: -22, y1: -80, x2: 22, y2: -80, class: kind + " thin" });
      return (time) => frame.setAttribute("transform", `rotate(${at(motions[kind], time).lean * 180 / Math.PI})`);
    });
  }

  function above(place, motions, wheelbase) {
    const svg = canvas(place.querySelector(".above"), "-60 -110 120 125");
    shape(svg, "line", { x1: 0, y1: 10, x2: 0, y2: -105, class: "guide" });
    return Object.keys(motions).map((kind) => {
      shape(svg, "line", { x1: 0, y1: -5, x2: 0, y2: -75, class: kind + " thin" });
      shape(svg, "line", { x1: 0, y1: 10, x2: 0, y2: -20, class: kind + " bar" });
      const front = shape(svg, "g", {});
      shape(front, "line", { x1: 0, y1: 15, x2: 0, y2: -15, class: kind + " bar" });
      shape(front, "line", { x1: -20, y1: 0, x2: 20, y2: 0, class: kind + " thin" });
      return (time) => front.setAttribute("transform", `translate(0 -75) rotate(${at(motions[kind], time).steer * 180 / Math.PI})`);
    });
  }

  // From above, heading to the right: x to the right, y (to the bicycle's right) downwards, both to scale.
  function path(place, motions) {
    const kinds = Object.keys(motions);
    const all = (key) => kinds.flatMap((kind) => motions[kind][key]);
    const [left, right, top, bottom] = [Math.min(...all("x")), Math.max(...all("x")), Math.min(...all("y")), Math.max(...all("y"))];
    const width = Math.max(right - left, 1);
    const height = Math.max(bottom - top, 0.25 * width);
    const scale = Math.min(240 / width, 110 / height);
    const middle = (top + bottom) / 2;
    const svg = canvas(place.querySelector(".path"), `-10 -10 260 ${height * scale + 40}`);
    const X = (x) => (x - left) * scale;
    const Y = (y) => (y - middle + height / 2) * scale;
    const metre = [1, 2, 5, 10, 20, 50].find((one) => one > width / 6) || 100;
    const low = height * scale + 14;
    shape(svg, "line", { x1: 0, y1: low, x2: metre * scale, y2: low, class: "ground" });
    shape(svg, "text", { x: metre * scale + 4, y: low + 4 }).textContent = metre + " m";
    return kinds.map((kind) => {
      const motion = motions[kind];
      shape(svg, "polyline", { points: motion.x.map((x, i) => X(x).toFixed(1) + "," + Y(motion.y[i]).toFixed(1)).join(" "), class: kind + " thin" });
      const mark = shape(svg, "g", {});
      shape(mark, "path", { d: "M 7 0 L -5 -4 L -5 4 Z", class: "dot " + kind });
      return (time) => {
        const now = at(motion, time);
        mark.setAttribute("transform", `translate(${X(now.x)} ${Y(now.y)}) rotate(${now.yaw * 180 / Math.PI})`);
      };
    });
  }

  // --- start -----------------------------------------------------------------------------------------------
  const plots = [...document.querySelectorAll(".plot")];
  for (const plot of plots) plot.style.minHeight = Number(plot.dataset.height) + 60 + "px"; // the page keeps its length
  for (const place of document.querySelectorAll(".animation")) animate(place);
  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) { near.unobserve(entry.target); draw(entry.target); }
  }, { rootMargin: "800px" });
  for (const plot of plots) near.observe(plot);
  addEventListener("beforeprint", () => plots.forEach(draw));
  document.documentElement.dataset.ready = "yes";
})();
