// Charts of what the axes of a device do, over the time of its line.

import { make, shown, write } from "./dom.js";

const SAMPLES_MAX = 4000;
const WINDOWS_S = [10, 30, 120];
const STILL_MS = 150; // of axes that stood, no event for so long: they stood until now
const LOOK_MS = 50;
const HEIGHT_PX = 200;

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const listOf = (value) => (Array.isArray(value) ? value : [value]);

/** Position and rate of the `axes` of a device, as DeviceInfo has them. */
export class MotionCharts {
  constructor(axes) {
    this.windowS = WINDOWS_S[0];
    this.times = [];
    this.last = null;
    this.charts = [
      new Chart("Position", axes.unit, axes.names, axes.position),
      new Chart("Speed", `${axes.unit}/s`, axes.names, axes.rate),
    ];
    this.element = make("section", { "aria-labelledby": "motion", class: "wide" },
      make("div", { class: "row" }, make("h2", { id: "motion" }, "Motion"), this.#windows(axes)),
      ...this.charts.map((each) => each.element));
    this.#watchTheme();
  }

  #windows(axes) {
    const select = make("select", { id: "window", onchange: () => { this.windowS = Number(select.value); this.#soon(); } },
      ...WINDOWS_S.map((each) => make("option", { value: each }, `${each} s`)));
    const legend = axes.names.length > 1
      ? axes.names.map((name, index) => make("span", { class: `key axis-${index % 4}` }, name)) : [];
    return make("div", { class: "row" }, ...legend, make("label", { for: "window" }, "Span"), select);
  }

  #watchTheme() {
    this.theme = matchMedia("(prefers-color-scheme: dark)");
    this.repaint = () => this.charts.forEach((each) => each.rebuild());
    this.theme.addEventListener("change", this.repaint);
    this.observer = new ResizeObserver(() => this.charts.forEach((each) => each.fit()));
    this.observer.observe(this.element);
  }

  /** All `values` of the device at `timeNs`. */
  push(timeNs, values) {
    const now = { timeS: timeNs / 1e9, wallMs: performance.now() };
    if (this.last && now.timeS < this.last.timeS) this.#clear(); // another run of the daemon
    const wallMs = this.last ? now.wallMs - this.last.wallMs : 0;
    const [, rates] = this.charts;
    if (wallMs > STILL_MS && rates.latest.every((each) => each === 0)) {
      const timeS = now.timeS - ((now.timeS - this.last.timeS) * LOOK_MS) / wallMs;
      this.#add(timeS, (chart) => chart.latest);
    }
    this.#add(now.timeS, (chart) => listOf(values[chart.control]));
    this.last = now;
    this.#soon();
  }

  #add(timeS, valuesOf) {
    this.times.push(timeS);
    if (this.times.length > SAMPLES_MAX) this.times.shift();
    for (const chart of this.charts) chart.add(valuesOf(chart), SAMPLES_MAX);
  }

  #clear() {
    this.times.length = 0;
    this.last = null;
    this.charts.forEach((each) => each.clear());
  }

  #soon() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      const end = this.times.at(-1) ?? 0;
      const start = Math.max(0, end - this.windowS);
      for (const each of this.charts) each.draw(this.times, start, start + this.windowS);
    });
  }

  close() {
    cancelAnimationFrame(this.frame);
    this.theme.removeEventListener("change", this.repaint);
    this.observer.disconnect();
    this.charts.forEach((each) => each.plot?.destroy());
  }
}

class Chart {
  constructor(title, unit, names, control) {
    this.names = names;
    this.control = control;
    this.unit = unit;
    this.columns = names.map(() => []);
    this.range = { min: 0, max: 1 };
    this.times = [];
    this.value = make("span", { class: "value" });
    this.area = make("div", { class: "chart", role: "img", "aria-label": `${title} over time; its values are in the text` });
    this.element = make("figure", {}, make("figcaption", {}, `${title} `, this.value), this.area);
  }

  get latest() {
    return this.columns.map((each) => each.at(-1));
  }

  add(values, max) {
    this.columns.forEach((column, index) => {
      column.push(values[index]);
      if (column.length > max) column.shift();
    });
  }

  clear() {
    this.columns.forEach((each) => (each.length = 0));
  }

  draw(times, min, max) {
    this.times = times;
    this.range = { min, max };
    write(this.value, `${shown(this.latest)} ${this.unit}`);
    if (!this.plot) this.rebuild();
    this.plot?.setData([times, ...this.columns], false);
    this.plot?.setScale("x", this.range);
  }

  rebuild() {
    this.plot?.destroy();
    this.plot = null;
    if (!this.area.clientWidth) return;
    const axis = { stroke: style("--quiet"), grid: { stroke: style("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui" };
    const series = this.names.map((label, index) => ({ label, stroke: style(`--axis-${index % 4}`), width: 2, pxAlign: 0, points: { show: false } }));
    const options = {
      width: this.area.clientWidth,
      height: HEIGHT_PX,
      pxAlign: 0, // or a slow motion is drawn in steps
      legend: { show: false },
      scales: { x: { time: false }, y: { range: (_, low, high) => around(low, high) } },
      axes: [{ ...axis, size: 30, values: (_, each) => each.map((x) => `${Number(x.toFixed(3))} s`) }, { ...axis, size: 72 }],
      series: [{}, ...series],
    };
    this.plot = new window.uPlot(options, [this.times, ...this.columns], this.area);
    this.plot.setScale("x", this.range);
  }

  fit() {
    if (!this.plot) this.rebuild();
    else if (this.plot.width !== this.area.clientWidth) this.plot.setSize({ width: this.area.clientWidth, height: HEIGHT_PX });
  }
}

/** A range of values with room around them. */
function around(low, high) {
  if (low === null || high === null) return [-1, 1];
  const room = (high - low) * 0.08 || Math.max(1, Math.abs(high) * 0.1);
  return [low - room, high + room];
}
