// One line or bus: where it is found, its devices, and what goes over it.

import { ask, watch } from "./api.js";
import { make, words } from "./dom.js";
import { makeFailure } from "./failure.js";
import { makeLog } from "./log.js";
import { Monitor } from "./monitor.js";

export async function lineView(name, page) {
  const { lines } = await ask("lines");
  const line = lines.find((each) => each.name === name || each.devices.includes(name));
  if (!line) throw new Error(`There is no line ${name}.`);
  const failure = makeFailure(line.name, line.failure);
  const monitor = new Monitor();
  const log = makeLog();
  let isFirst = true;
  const hear = (event) => {
    if (event.event === "traffic") {
      monitor.hear(event, isFirst);
      isFirst = false;
    } else if (event.event === "line" && event.line === line.name) {
      log.add("", words(event.kind));
      failure.hear(event);
    }
  };
  const link = (isUp) => {
    isFirst ||= isUp; // the daemon tells what was, again
    page.link(isUp);
  };
  const leave = watch([], hear, { ...page, link }, [line.name]);
  const devices = line.devices.map((each) => make("a", { href: `#/device/${encodeURIComponent(each)}` }, each));
  const element = make("div", {},
    make("div", { class: "head" },
      make("nav", { "aria-label": "Way back" }, make("a", { href: "#/" }, "All devices")),
      make("h1", { tabindex: -1 }, `Line of ${line.name}`),
      make("p", { class: "doc" }, line.endpoints.map((each) => `${each.kind} ${each.url}`).join(", ") || "no port"), failure.element,
      make("div", { class: "row" }, ...devices)),
    make("div", { class: "grid" }, monitor.element, log.element));
  return { title: line.name, element, leave: () => (leave(), monitor.close()) };
}
