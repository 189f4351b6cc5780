// One device: what it does, and all that can be done to it.

import { getControls, getDevice, getState, switchPower, watch } from "./api.js";
import { MotionCharts } from "./chart.js";
import { makeControls, spread } from "./controls.js";
import { attempt, make, seconds, shown, words, write } from "./dom.js";
import { makeFailure } from "./failure.js";
import { makeFaults } from "./faults.js";
import { makeLog } from "./log.js";
import { makeStatus } from "./status.js";

const OFF_S = 0.5;

export async function deviceView(wanted, page) {
  const device = await getDevice(wanted);
  const [controls, state] = await Promise.all([getControls(device.name), getState(device.name)]);
  const rows = spread(controls, state.values);
  const values = { ...state.values };
  const failure = makeFailure(device.line);
  const head = makeHead(device, failure.element);
  const charts = device.axes && new MotionCharts(device.axes);
  const status = makeStatus(controls);
  const isStatus = (each) => each.queue || each.bits.length;
  const readings = makeReadings(device, rows.filter((each) => each.readable && !each.writable && !each.numbers && !isStatus(each)));
  const works = makeControls(device.name, rows.filter((each) => each.name !== "power" && (each.writable || each.numbers)));
  const faults = await makeFaults(device.line);
  const log = makeLog();
  const show = (timeNs, changed) => {
    Object.assign(values, changed);
    head.show(timeNs, values);
    readings.show(changed);
    status?.show(changed);
    works.show(changed);
  };
  const hear = (event) => {
    if (event.values) {
      show(event.time_ns, event.values);
      charts?.push(event.time_ns, values);
    } else if (event.event === "set") {
      show(event.time_ns, event.control in values ? { [event.control]: event.value } : {}); // the charts wait for all values
      log.add(seconds(event.time_ns), `${words(event.control)}: ${event.value === null ? "done" : `set to ${shown(event.value)}`}`);
    } else if (event.event === "told") log.add(seconds(event.time_ns), event.text);
    else if (event.line === device.line) {
      failure.hear(event);
      log.add("", faults.hear(event) ?? words(event.kind));
    }
  };
  show(state.time_ns, state.values);
  charts?.push(state.time_ns, values);
  const leave = watch([device.name], hear, page);
  const element = make("div", {}, head.element,
    make("div", { class: "grid" }, ...(charts ? [charts.element] : []), ...(status ? [status.element] : []), ...works.sections, readings.element, faults.element, log.element));
  return { title: device.name, element, leave: () => (leave(), charts?.close()) };
}

/** Name, state, `failure` of the line, and power. */
function makeHead(device, failure) {
  const state = make("p", { id: "state", class: "state", role: "status" });
  const time = make("span", { class: "quiet" });
  const power = make("button", {
    type: "button", role: "switch", class: "switch", "data-control": "power",
    onclick: () => change(power.getAttribute("aria-checked") === "true" ? "off" : "on"),
  }, make("span", { class: "name" }, "Power"), make("span", { class: "knob", "aria-hidden": "true" }));
  const cycle = make("button", { type: "button", onclick: () => change("cycle") }, `Off and on (${OFF_S} s)`);
  const change = (action) => attempt(() => switchPower(device.name, action, OFF_S), (done) => `Power is ${shown(done.power)}`);
  const show = (timeNs, values) => {
    write(state, values.power ? values.state : "power off");
    state.classList.toggle("off", !values.power);
    power.setAttribute("aria-checked", String(values.power));
    write(time, `line time ${(timeNs / 1e9).toFixed(1)} s`);
  };
  const element = make("div", { class: "head" },
    make("nav", { "aria-label": "Way back" }, make("a", { href: "#/" }, "All devices")),
    make("h1", { tabindex: -1 }, device.name), state, failure,
    make("div", { class: "row" }, power, cycle, make("span", { class: "quiet" }, `${device.model} on the `,
      make("a", { href: `#/line/${encodeURIComponent(device.line)}` }, `line of ${device.line}`)), time));
  return { element, show };
}

/** What is only seen. */
function makeReadings(device, controls) {
  const updates = new Map();
  const rows = controls.map((control) => {
    const value = make("dd", { "data-reading": control.name }, shown(control.value, control.unit));
    updates.set(control.name, (now) => write(value, shown(now, control.unit)));
    return make("div", { title: control.doc }, make("dt", {}, words(control.name.replaceAll(".", " "))), value);
  });
  const refresh = async () => {
    const state = await attempt(() => getState(device.name), () => "Read again");
    if (state) show(state.values);
  };
  const show = (values) => Object.entries(values).forEach(([name, value]) => updates.get(name)?.(value));
  const element = make("section", { "aria-labelledby": "readings" },
    make("div", { class: "row" }, make("h2", { id: "readings" }, "Readings"), make("button", { type: "button", onclick: refresh }, "Read again")),
    make("dl", {}, ...rows));
  return { element, show };
}
