// All lines, and the devices on them.

import { ask, watch } from "./api.js";
import { make, shown, write } from "./dom.js";
import { makeFailure } from "./failure.js";

export async function overview(page) {
  const [{ lines }, { devices }] = await Promise.all([ask("lines"), ask("devices")]);
  const cards = new Map(devices.map((each) => [each.name, makeCard(each)]));
  const failures = lines.map((line) => makeFailure(line.name, line.failure));
  const sections = lines.map((line, index) => {
    const found = line.endpoints.map((each) => `${each.kind} ${each.url}`).join(", ");
    return make("section", { "aria-labelledby": `line-${index}` },
      make("div", { class: "row" }, make("h2", { id: `line-${index}` }, `Line of ${line.name}`),
        make("a", { href: `#/line/${encodeURIComponent(line.name)}`, "aria-describedby": `line-${index}` }, "Traffic")),
      make("p", { class: "doc" }, found || "no port"), failures[index].element,
      make("ul", { class: "cards" }, ...line.devices.filter((each) => cards.has(each)).map((each) => cards.get(each).element)));
  });
  const hear = (event) => {
    if (event.values) cards.get(event.device)?.show(event.values);
    else failures.forEach((each) => each.hear(event));
  };
  const element = make("div", {}, make("h1", { tabindex: -1 }, "Devices"), ...sections);
  return { title: "Devices", element, leave: watch([], hear, page) };
}

function makeCard(device) {
  const values = { power: device.power, state: device.state };
  const state = make("span", { class: "state" });
  const position = make("span", { class: "value" });
  const element = make("li", {}, make("a", { class: "card", href: `#/device/${encodeURIComponent(device.name)}` },
    make("span", { class: "name" }, device.name), state, position));
  const show = (changed) => {
    Object.assign(values, changed);
    write(state, values.power ? values.state : "power off");
    state.classList.toggle("off", !values.power);
    const where = device.axes && values[device.axes.position];
    write(position, where === null || where === undefined ? "" : `${shown(where)} ${device.axes.unit}`);
  };
  show({});
  return { element, show };
}
