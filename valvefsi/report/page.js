"use strict";
/* Draws the figures of the page when they come into view, and again when their data change. No figure asks for anything
   outside this file. */
(() => {
  const LINES = ["--c0", "--c1", "--c2", "--c3", "--c4", "--c5"];
  const STILL = { displaylogo: false, responsive: true, topojsonURL: "", modeBarButtonsToRemove: ["select2d", "lasso2d"] };
  const drawn = [];

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  function plotly() {
    if (!window.Plotly) {
      const script = document.createElement("script");
      script.textContent = document.getElementById("library").textContent;
      document.head.append(script);
    }
    return window.Plotly;
  }

  /* An array of bytes in base 64 as numbers; u2 are steps of a range. */
  function unpacked(said) {
    const text = atob(said.data);
    const bytes = new Uint8Array(text.length);
    for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
    if (said.type === "f8") return new Float64Array(bytes.buffer);
    if (said.type === "u4") return new Uint32Array(bytes.buffer);
    const steps = new Uint16Array(bytes.buffer);
    const values = new Float32Array(steps.length);
    for (let k = 0; k < steps.length; k++) values[k] = said.low + said.step * steps[k];
    return values;
  }

  function element(name, properties = {}, ...inside) {
    const made = Object.assign(document.createElement(name), properties);
    made.append(...inside);
    return made;
  }

  function look() {
    return {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("--muted"), activecolor: colour("--ink") },
      font: { color: colour("--ink"), size: 13, family: "system-ui, 'Liberation Sans', 'DejaVu Sans', sans-serif" },
    };
  }

  /* Curves over time, panels one above the other. */
  function chart(place, data) {
    const traces = [];
    const panels = data.panels;
    const listed = new Set();
    const first = (name) => !listed.has(name) && Boolean(listed.add(name));
    const height = 90 + 200 * panels.length;
    const gap = 36 / height;
    const share = (1 - gap * (panels.length - 1)) / panels.length;
    const narrow = place.clientWidth < 560;
    const layout = {
      ...look(), uirevision: "kept", height, margin: { l: narrow ? 52 : 66, r: 12, t: 16, b: 46 },
      hovermode: "x unified", showlegend: true, legend: { orientation: "h", y: 1.0, yanchor: "bottom", x: 0 },
      hoverlabel: { bgcolor: colour("--panel"), font: { color: colour("--ink") } },
      xaxis: { title: { text: data.x.label }, gridcolor: colour("--grid"), zeroline: false, anchor: `y${panels.length > 1 ? panels.length : ""}` },
    };
    panels.forEach((panel, number) => {
      const axis = number ? `y${number + 1}` : "y";
      const top = 1 - number * (share + gap);
      layout[`yaxis${number ? number + 1 : ""}`] = {
        title: { text: panel.label, standoff: 6 }, domain: [Math.max(0, top - share), top],
        gridcolor: colour("--grid"), zerolinecolor: colour("--muted"),
      };
      for (const curve of panel.curves) {
        const x = unpacked(curve.x);
        const line = { color: colour(LINES[curve.colour % LINES.length]), width: 2, dash: curve.dash || "solid" };
        if (curve.band) {
          const [y, half] = [unpacked(curve.y), unpacked(curve.band)];
          const edge = { x, yaxis: axis, mode: "lines", line: { width: 0 }, hoverinfo: "skip", legendgroup: curve.name };
          traces.push({ ...edge, y: y.map((v, k) => v - half[k]), showlegend: false });
          traces.push({ ...edge, y: y.map((v, k) => v + half[k]), fill: "tonexty", fillcolor: colour("--band"), name: `${curve.name}, 2 sd`, showlegend: first(`${curve.name}, 2 sd`) });
        }
        traces.push({
          x, y: unpacked(curve.y), yaxis: axis, name: curve.name, mode: "lines", line, legendgroup: curve.name, showlegend: first(curve.name),
          hovertemplate: `%{y:.5g} ${panel.unit}`,
        });
      }
    });
    if (narrow) layout.legend.font = { size: 11 };
    plotly().react(place, traces, layout, STILL);
  }

  const CAMERAS = {
    "from the side": { eye: { x: 1.5, y: -1.5, z: 0.8 }, up: { x: 0, y: 0, z: 1 } },
    "from downstream": { eye: { x: 0, y: -0.001, z: 2.2 }, up: { x: 0, y: 1, z: 0 } },
    "from upstream": { eye: { x: 0, y: -0.001, z: -2 }, up: { x: 0, y: 1, z: 0 } },
  };

  /* One set of bodies; show(k) puts them where they are at its frame k. */
  function bodies(place, data, state) {
    const shapes = data.bodies.map((body) => {
      const points = unpacked(body.points);
      const count = body.points.shape[1];
      const faces = unpacked(body.triangles);
      const corner = (c) => Array.from({ length: faces.length / 3 }, (_, k) => faces[3 * k + c]);
      const fields = body.fields.map((field) => ({ ...field, values: unpacked(field.values) }));
      return { ...body, points, count, fields, i: corner(0), j: corner(1), k: corner(2) };
    });
    const at = (shape, frame) => {
      const start = 3 * shape.count * (shape.still ? 0 : frame);
      const axis = (d) => Float32Array.from({ length: shape.count }, (_, n) => shape.points[start + 3 * n + d]);
      return [axis(0), axis(1), axis(2)];
    };
    const intensity = (shape, frame) => {
      const field = shape.fields[Math.min(state.field, shape.fields.length - 1)];
      return field.values.subarray(shape.count * frame, shape.count * (frame + 1));
    };
    const traces = shapes.map((shape) => {
      const [x, y, z] = at(shape, 0);
      const trace = {
        type: "mesh3d", x, y, z, i: shape.i, j: shape.j, k: shape.k, name: shape.name, hoverinfo: "name",
        lighting: { ambient: 0.55, diffuse: 0.65, specular: 0.08, roughness: 0.8 }, lightposition: { x: 800, y: -1200, z: 2000 },
      };
      if (!shape.fields.length) return { ...trace, color: colour("--muted"), opacity: 0.16, hoverinfo: "skip" };
      const field = shape.fields[Math.min(state.field, shape.fields.length - 1)];
      return {
        ...trace, intensity: intensity(shape, 0), colorscale: "Viridis", cmin: field.low, cmax: field.high, showscale: true,
        colorbar: { title: { text: `${field.name} [${field.unit}]`, side: "right" }, thickness: 12, len: 0.8 },
        hovertemplate: `${shape.name}: %{intensity:.4g} ${field.unit}<extra></extra>`,
      };
    });
    const axis = { gridcolor: colour("--grid"), zeroline: false, showbackground: false, color: colour("--muted"), nticks: 5 };
    const named = (d) => ({ ...axis, title: { text: `${"xyz"[d]} [cm]` }, range: [data.box[0][d], data.box[1][d]] });
    const layout = {
      ...look(), margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false,
      scene: { xaxis: named(0), yaxis: named(1), zaxis: named(2), aspectmode: "data", camera: state.turned || CAMERAS[state.camera] },
    };
    plotly().newPlot(place, traces, layout, STILL);
    const moving = shapes.map((shape, k) => [shape, k]).filter(([shape]) => !shape.still);
    return {
      show(frame) {
        const change = { x: [], y: [], z: [], intensity: [] };
        for (const [shape] of moving) {
          const [x, y, z] = at(shape, frame);
          change.x.push(x); change.y.push(y); change.z.push(z); change.intensity.push(intensity(shape, frame));
        }
        plotly().restyle(place, change, moving.map(([, k]) => k));
      },
      colour(frame) {
        for (const [shape, k] of moving) {
          const field = shape.fields[Math.min(state.field, shape.fields.length - 1)];
          plotly().restyle(place, {
            intensity: [intensity(shape, frame)], cmin: field.low, cmax: field.high, "colorbar.title.text": `${field.name} [${field.unit}]`,
            hovertemplate: `${shape.name}: %{intensity:.4g} ${field.unit}<extra></extra>`,
          }, [k]);
        }
      },
      turn() { plotly().relayout(place, { "scene.camera": CAMERAS[state.camera] }); },
    };
  }

  /* A plane of the fluid with what it cuts of the bodies. */
  function plane(place, data) {
    const values = unpacked(data.values);
    const [, up, across] = data.values.shape;
    const [x, y] = [unpacked(data.x), unpacked(data.y)];
    const cuts = unpacked(data.cuts);
    const rows = (frame) => Array.from({ length: up }, (_, r) => values.subarray((frame * up * across) + r * across, (frame * up * across) + (r + 1) * across));
    const lines = (frame) => {
      const [from, to] = [data.starts[frame], data.starts[frame + 1]];
      const [a, b] = [[], []];
      for (let k = from; k < to; k++) {
        a.push(cuts[4 * k], cuts[4 * k + 2], null);
        b.push(cuts[4 * k + 1], cuts[4 * k + 3], null);
      }
      return [a, b];
    };
    const [a, b] = lines(0);
    const traces = [
      { type: "heatmap", x, y, z: rows(0), zmin: data.low, zmax: data.high, colorscale: data.low < 0 ? "RdBu" : "Viridis", zsmooth: false,
        colorbar: { title: { text: `${data.name} [${data.unit}]`, side: "right" }, thickness: 12, len: 0.8 },
        hovertemplate: `%{x:.3g}, %{y:.3g} cm: %{z:.4g} ${data.unit}<extra></extra>` },
      { type: "scatter", mode: "lines", x: a, y: b, line: { color: data.low < 0 ? "#1b2733" : "#ffffff", width: 1.6 }, hoverinfo: "skip", showlegend: false },
    ];
    const axis = { color: colour("--muted"), zeroline: false, showgrid: false };
    plotly().newPlot(place, traces, {
      ...look(), margin: { l: 48, r: 8, t: 8, b: 42 },
      xaxis: { ...axis, title: { text: `${data.axes[0]} [cm]` }, constrain: "domain" },
      yaxis: { ...axis, title: { text: `${data.axes[1]} [cm]` }, scaleanchor: "x", constrain: "domain" },
    }, STILL);
    return {
      show(frame) {
        const [p, q] = lines(frame);
        plotly().restyle(place, { z: [rows(frame)] }, [0]);
        plotly().restyle(place, { x: [p], y: [q] }, [1]);
      },
      colour() {}, turn() {},
    };
  }

  /* Panels side by side over one slider. */
  function scene(place, data) {
    const state = place.scene || { field: 0, camera: "from the side", at: 0 };
    state.at = Math.min(state.at, data.t.length - 1);
    state.turned = place.querySelector(".js-plotly-plot")?.layout.scene?.camera; // as the reader has left it
    const panels = element("div", { className: "panels" });
    const slider = element("input", { type: "range", min: 0, max: data.t.length - 1, step: 1, value: state.at });
    const said = element("output");
    const play = element("button", { type: "button", textContent: "Play" });
    const controls = element("div", { className: "controls" });
    place.replaceChildren(panels, controls);
    if (data.t.length > 1) controls.append(element("label", { className: "when" }, data.clock, slider), said, play);
    else controls.append(element("span", {}, data.clock), said);
    const turned = data.panels.filter((panel) => panel.bodies);
    const names = turned.length ? turned[0].bodies.flatMap((body) => body.fields.map((field) => field.name)) : [];
    if (names.length > 1) {
      const choice = element("select");
      [...new Set(names)].forEach((name, k) => choice.append(element("option", { value: k, textContent: name })));
      choice.value = state.field;
      choice.addEventListener("change", () => { state.field = +choice.value; views.forEach((view, k) => view.colour(data.panels[k].frames[state.at])); });
      controls.append(element("label", {}, "colour", choice));
    }
    if (turned.length) {
      const choice = element("select");
      Object.keys(CAMERAS).forEach((name) => choice.append(element("option", { value: name, textContent: name })));
      choice.value = state.camera;
      choice.addEventListener("change", () => { state.camera = choice.value; views.forEach((view) => view.turn()); });
      controls.append(element("label", {}, "seen", choice));
    }
    const places = data.panels.map((panel) => { // all before the first is drawn, which would take the width of all
      const view = element("div", { className: "view" });
      panels.append(element("div", {}, element("h4", { textContent: panel.title }), view));
      return view;
    });
    const views = data.panels.map((panel, n) => (panel.bodies ? bodies(places[n], panel, state) : plane(places[n], panel)));
    function show(k) {
      state.at = k;
      slider.value = k;
      const text = `${data.t[k].toPrecision(4)} ${data.unit}`;
      said.textContent = text;
      slider.setAttribute("aria-valuetext", text);
      views.forEach((view, n) => view.show(data.panels[n].frames[k]));
    }
    slider.addEventListener("input", () => show(+slider.value));
    let clock = null;
    play.addEventListener("click", () => {
      if (clock) { clearInterval(clock); clock = null; play.textContent = "Play"; return; }
      play.textContent = "Stop";
      clock = setInterval(() => show((state.at + 1) % data.t.length), 120);
    });
    place.scene = state;
    show(state.at);
  }

  function draw(figure) {
    if (figure.dataset.done) return;
    figure.dataset.done = "yes";
    const place = figure.querySelector(".drawing");
    place.replaceChildren();
    place.classList.add("done");
    if (figure.dataset.kind === "chart") place.setAttribute("role", "img");
    else place.setAttribute("role", "group");
    const draw = figure.dataset.kind === "chart" ? chart : scene;
    const again = () => draw(place, JSON.parse(figure.querySelector("script").textContent));
    again();
    drawn.push(again);
    figure.addEventListener("change", again);
  }

  const figures = [...document.querySelectorAll("figure.drawn")];
  if ("IntersectionObserver" in window) {
    const seen = new IntersectionObserver((entries) => {
      for (const entry of entries) if (entry.isIntersecting) { seen.unobserve(entry.target); draw(entry.target); }
    }, { rootMargin: "300px" });
    figures.forEach((figure) => seen.observe(figure));
  } else figures.forEach(draw);
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((folded) => { folded.open = true; });
    figures.forEach(draw);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((again) => again()));
})();
