// The moving part of a tire's page: unpacks the maps and draws what comes into view with Plotly.
"use strict";

const page = JSON.parse(document.getElementById("page-data").textContent);
const PLAIN = { displaylogo: false, responsive: true };
const FONT = { family: "system-ui, sans-serif", size: 12, color: "#222" };
const isNarrow = () => window.innerWidth < 640;

// int16 little endian, micrometres, -32768 = missing -> float32, millimetres, NaN = missing.
function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const counts = new DataView(bytes.buffer);
  return Float32Array.from({ length: bytes.length / 2 }, (_, k) => {
    const count = counts.getInt16(2 * k, true);
    return count === -32768 ? NaN : count / 1000;
  });
}

function axisValues({ first, step, count }) {
  return Float64Array.from({ length: count }, (_, k) => first + k * step);
}

for (const layer of page.layers) {
  for (const name of ["height", "wear", "wear_std"]) {
    layer[name] = layer[name] === null ? null : unpack(layer[name]);
  }
  layer.thetas = axisValues(layer.theta_deg);
  layer.zs = axisValues(layer.z_mm);
}

// Stored with theta along rows; drawn with theta to the right.
function asRows(layer, values) {
  const [n, m] = [layer.thetas.length, layer.zs.length];
  return Array.from({ length: m }, (_, j) =>
    Float32Array.from({ length: n }, (_, i) => values[i * m + j]));
}

function nearestRow(layer, theta) {
  const { first, step, count } = layer.theta_deg;
  const middle = first + 0.5 * step * (count - 1);
  const turned = theta - 360 * Math.round((theta - middle) / 360);
  const row = Math.round((turned - first) / step);
  return row >= 0 && row < count ? row : null;
}

/* Unrolled maps */

function niceLength(mm) {
  const power = 10 ** Math.floor(Math.log10(mm));
  return power * [5, 2, 1].find((k) => k * power <= mm);
}

function scaleBar(layer, [low, high]) {
  const perDegree = (Math.PI / 180) * page.radius_mm;
  const length = niceLength((high - low) * perDegree * 0.2);
  const end = low + length / perDegree;
  const line = { xref: "x", yref: "paper", y0: 1.05, y1: 1.05, line: { color: "#222", width: 3 } };
  return {
    shapes: [{ ...line, type: "line", x0: low, x1: end }],
    annotations: [{ xref: "x", yref: "paper", x: end, y: 1.05, xanchor: "left", yanchor: "middle",
      showarrow: false, text: `${length} mm on the tread`, font: { size: 11 } }],
  };
}

function pickedLine() {
  return { type: "line", xref: "x", yref: "paper", x0: picked, x1: picked, y0: 0, y1: 1,
    line: { color: "#d55e00", width: 1.5, dash: "dash" } };
}

function heightTraces(layer, colorbar) {
  return [{
    type: "heatmap", x: layer.thetas, y: layer.zs, z: asRows(layer, layer.height),
    colorscale: page.scales.height.colours, zmin: page.scales.height.low,
    zmax: page.scales.height.high, colorbar,
    hovertemplate: "theta %{x:.2f}°, z %{y:.1f} mm<br>height %{z:.3f} mm<extra></extra>",
  }];
}

function wearTraces(layer, colorbar) {
  const std = asRows(layer, layer.wear_std);
  const wear = asRows(layer, layer.wear);
  const isSure = (j, i) => Math.abs(wear[j][i]) >= 2 * std[j][i];
  const part = (keep) => wear.map((row, j) => row.map((w, i) => (keep(j, i) ? w : NaN)));
  const place = "theta %{x:.2f}°, z %{y:.1f} mm<br>wear %{z:.3f} ± %{customdata:.3f} mm";
  const common = { type: "heatmap", x: layer.thetas, y: layer.zs, customdata: std };
  return [
    { ...common, z: part((j, i) => !isSure(j, i)), showscale: false,
      colorscale: [[0, page.undetected], [1, page.undetected]],
      hovertemplate: `${place}<br>not detected<extra></extra>` },
    { ...common, z: part(isSure), colorscale: page.scales.wear.colours,
      zmin: page.scales.wear.low, zmax: page.scales.wear.high, colorbar,
      hovertemplate: `${place}<extra></extra>` },
  ];
}

const maps = [];

function drawMap(box) {
  const layer = page.layers[box.dataset.layer];
  const kind = box.dataset.map;
  const across = { orientation: "h", y: -0.36, yanchor: "top", thickness: 10, len: 1 };
  const upright = { thickness: 14, len: 1 };
  const title = { text: `${kind} (mm)`, side: isNarrow() ? "bottom" : "right" };
  const colorbar = { ...(isNarrow() ? across : upright), title };
  const traces = kind === "wear" ? wearTraces(layer, colorbar) : heightTraces(layer, colorbar);
  const step = layer.theta_deg.step;
  const whole = [layer.thetas[0] - step / 2, layer.thetas.at(-1) + step / 2];
  const bar = scaleBar(layer, whole);
  const layout = {
    font: FONT, plot_bgcolor: "#fff", dragmode: "zoom",
    margin: { l: 55, r: isNarrow() ? 12 : 75, t: 34, b: isNarrow() ? 100 : 42 },
    xaxis: { title: { text: "theta (°)" }, range: whole, zeroline: false, showgrid: false },
    yaxis: { title: { text: "z (mm)" }, zeroline: false, showgrid: false },
    shapes: [...bar.shapes, pickedLine()], annotations: bar.annotations,
  };
  const drawn = Plotly.newPlot(box, traces, layout, PLAIN);
  maps.push(box);
  box.on("plotly_click", (event) => pick(event.points[0].x));
  box.on("plotly_relayout", (change) => {
    if (!("xaxis.range[0]" in change || "xaxis.autorange" in change)) return;
    box.scale = scaleBar(layer, box.layout.xaxis.range);
    Plotly.relayout(box, { shapes: [...box.scale.shapes, pickedLine()],
      annotations: box.scale.annotations });
  });
  box.scale = bar;
  return drawn;
}

/* Cross-sections at the angle that the reader picks */

let picked = page.layers.length ? page.layers[0].thetas[page.layers[0].thetas.length >> 1] : 0;
let sections = null;

function sectionTraces() {
  return page.layers.map((layer, k) => {
    const row = nearestRow(layer, picked);
    const m = layer.zs.length;
    const values = row === null ? new Float32Array(m).fill(NaN)
      : layer.height.subarray(row * m, (row + 1) * m);
    return { type: "scatter", mode: "lines", name: layer.title, x: layer.zs, y: values,
      line: { width: 1.6, ...page.lines[k % page.lines.length] },
      hovertemplate: "z %{x:.1f} mm, height %{y:.3f} mm" };
  });
}

function drawSections(box) {
  sections = box;
  return Plotly.newPlot(box, sectionTraces(), {
    font: FONT, margin: { l: 55, r: 12, t: 10, b: 45 }, hovermode: "x unified",
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
    xaxis: { title: { text: "z, along the axis (mm)" }, zeroline: false },
    yaxis: { title: { text: "height (mm)" }, zeroline: false },
    uirevision: "sections",
  }, PLAIN);
}

function pick(theta) {
  picked = Number(theta);
  for (const input of document.querySelectorAll("[data-picker]")) input.value = picked.toFixed(1);
  if (sections) Plotly.react(sections, sectionTraces(), sections.layout, PLAIN);
  for (const box of maps) {
    Plotly.relayout(box, { shapes: [...box.scale.shapes, pickedLine()] });
  }
}

for (const input of document.querySelectorAll("[data-picker]")) {
  input.value = picked.toFixed(1);
  input.addEventListener("input", () => {
    if (input.value !== "" && Number.isFinite(Number(input.value))) pick(input.value);
  });
}

/* The tread in three dimensions */

// More vertices than this turn slowly on a plain laptop.
const VERTICES = 200000;

function surfaceTrace(layer, kind) {
  const [n, m] = [layer.thetas.length, layer.zs.length];
  const stride = Math.max(1, Math.ceil(Math.sqrt((n * m) / VERTICES)));
  const rows = Array.from({ length: Math.ceil(n / stride) }, (_, k) => k * stride);
  if (layer.whole_turn) rows.push(0);
  const columns = Array.from({ length: Math.ceil(m / stride) }, (_, k) => k * stride);
  const values = layer[kind];
  const grid = (of) => columns.map((j) => Float32Array.from(rows, (i) => of(i, j)));
  const angle = (i) => (layer.thetas[i] * Math.PI) / 180;
  const radius = (i, j) => layer.base_mm[j] + layer.height[i * m + j];
  const scale = page.scales[kind];
  return {
    type: "surface", connectgaps: false,
    x: grid((i, j) => radius(i, j) * Math.cos(angle(i))),
    y: grid((i, j) => radius(i, j) * Math.sin(angle(i))),
    z: grid((i, j) => layer.zs[j]),
    surfacecolor: grid((i, j) => values[i * m + j]),
    customdata: grid((i) => layer.thetas[i]),
    cmin: scale.low, cmax: scale.high, colorscale: scale.colours,
    colorbar: { title: { text: `${kind} (mm)`, side: "right" }, thickness: 14, len: 0.8,
      ...(isNarrow() ? { orientation: "h", y: -0.02, yanchor: "top", len: 1,
        title: { text: `${kind} (mm)`, side: "bottom" } } : {}) },
    lighting: { ambient: 0.85, diffuse: 0.45, specular: 0.08, roughness: 0.8 },
    hovertemplate: `theta %{customdata:.1f}°, z %{z:.1f} mm<br>${kind} %{surfacecolor:.3f} mm<extra></extra>`,
    contours: { x: { highlight: false }, y: { highlight: false }, z: { highlight: false } },
  };
}

function surfaceChoice() {
  const [layer, kind] = document.getElementById("surface-choice").value.split(" ");
  return [page.layers[layer], kind];
}

function drawSurface(box) {
  const [layer, kind] = surfaceChoice();
  const middle = (layer.thetas[layer.thetas.length >> 1] * Math.PI) / 180;
  const axis = (text) => ({ title: { text }, backgroundcolor: "#fff", gridcolor: "#ddd" });
  const far = isNarrow() ? 1.5 : 1;
  // A whole tire stands on its tread, a sector lies before the reader with its axis upright.
  const camera = layer.whole_turn
    ? { up: { x: 0, y: 1, z: 0 }, eye: { x: far * 1.1, y: far * 0.35, z: far * 1.1 } }
    : { eye: { x: far * 1.9 * Math.cos(middle), y: far * 1.9 * Math.sin(middle), z: far * 0.6 } };
  const drawn = Plotly.newPlot(box, [surfaceTrace(layer, kind)], {
    font: FONT, margin: { l: 0, r: 0, t: 0, b: isNarrow() ? 60 : 0 },
    scene: {
      aspectmode: "data", dragmode: "orbit",
      xaxis: axis("x (mm)"), yaxis: axis("y (mm)"), zaxis: axis("z (mm)"),
      camera,
    },
    uirevision: "surface",
  }, PLAIN);
  document.getElementById("surface-choice").addEventListener("change", () =>
    Plotly.react(box, [surfaceTrace(...surfaceChoice())], box.layout, PLAIN));
  return drawn;
}

/* Plain charts, some with a choice of traces */

function drawChart(box) {
  const chart = page.charts[box.dataset.chart];
  const select = box.parentElement.querySelector("select[data-choice]");
  const shown = () => chart.data.map((trace) =>
    !select || String(trace.meta) === select.value ? { ...trace } : null).filter(Boolean);
  const layout = { font: FONT, ...chart.layout };
  if (select) {
    select.addEventListener("change", () => Plotly.react(box, shown(), box.layout, PLAIN));
  }
  return Plotly.newPlot(box, shown(), layout, PLAIN);
}

/* Everything is drawn when it comes near the window, and all of it before printing */

function draw(box) {
  if (box.dataset.drawn) return;
  box.dataset.drawn = "begun";
  const by = { map: drawMap, sections: drawSections, surface: drawSurface, chart: drawChart };
  Promise.resolve(by[box.dataset.plot](box)).then(() => { box.dataset.drawn = "done"; });
}

const boxes = [...document.querySelectorAll("[data-plot]")];
const watcher = new IntersectionObserver((entries) => {
  for (const entry of entries) if (entry.isIntersecting) draw(entry.target);
}, { rootMargin: "300px" });
boxes.forEach((box) => watcher.observe(box));
window.addEventListener("beforeprint", () => boxes.forEach(draw));
