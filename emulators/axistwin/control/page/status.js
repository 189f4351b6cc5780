// What a device tells of itself in numbers: its queue, and the bits of status words by name.

import { make, shown, words, write } from "./dom.js";

const NUMBER_BITS = 32;

/** A section with the queues and the status words among `controls`, or null; `show` takes changed values. */
export function makeStatus(controls) {
  const updates = new Map();
  const parts = [
    ...controls.filter((each) => each.queue).map((each) => makeQueue(each, updates)),
    ...controls.filter((each) => each.bits.length).map((each) => makeBits(each, updates)),
  ];
  if (!parts.length) return null;
  const element = make("section", { "aria-labelledby": "status" }, make("h2", { id: "status" }, "Status"), ...parts);
  return { element, show: (values) => Object.entries(values).forEach(([name, value]) => updates.get(name)?.(value)) };
}

function makeQueue(control, updates) {
  const value = make("dd", { "data-reading": control.name });
  updates.set(control.name, (now) => write(value, shown(now, control.unit)));
  return make("dl", {}, make("div", { title: control.doc }, make("dt", {}, words(control.name)), value));
}

function makeBits(control, updates) {
  const value = make("span", { class: "value", "data-reading": control.name });
  const rows = control.bits.map((bit) => ({ ...bit, state: make("span", { class: "word" }), element: make("li", { "data-bit": bit.bit }) }));
  for (const row of rows) {
    row.element.append(make("span", { class: "name" }, row.name), make("span", { class: "quiet law" }, row.requirement), row.state);
  }
  updates.set(control.name, (now) => {
    write(value, `${(now < 0 ? now + 2 ** NUMBER_BITS : now).toString(16).toUpperCase()}h`);
    for (const row of rows) {
      const isOn = Boolean((now >> row.bit) & 1);
      row.element.classList.toggle("on", isOn);
      write(row.state, isOn ? "on" : "off");
    }
  });
  return make("div", {}, make("h3", {}, `${words(control.name)} `, value), make("p", { class: "doc" }, control.doc),
    make("ul", { class: "bits", "aria-label": words(control.name) }, ...rows.map((each) => each.element)));
}
