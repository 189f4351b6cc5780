// What a device tells by itself, with a filter and a pause.

import { make } from "./dom.js";

const ENTRIES_MAX = 500;

export function makeLog() {
  const waiting = [];
  let isPaused = false;
  const list = make("ol", { class: "log", tabindex: 0, "aria-label": "Events, newest first" });
  const filter = make("input", { id: "filter", type: "search", oninput: () => [...list.children].forEach(sift) });
  const sift = (entry) => (entry.hidden = !entry.textContent.toLowerCase().includes(filter.value.toLowerCase()));
  const pause = make("button", { type: "button", "aria-pressed": "false", onclick: () => hold(!isPaused) }, "Pause");
  const put = (entry) => {
    sift(entry);
    list.prepend(entry);
    if (list.children.length > ENTRIES_MAX) list.lastChild.remove();
  };
  const hold = (paused) => {
    isPaused = paused;
    pause.setAttribute("aria-pressed", String(paused));
    if (!paused) waiting.splice(0).forEach(put);
  };
  const add = (time, text) => {
    const entry = make("li", {}, make("span", { class: "quiet" }, `${time} `), text);
    if (!isPaused) put(entry);
    else if (waiting.push(entry) > ENTRIES_MAX) waiting.shift();
  };
  const element = make("section", { "aria-labelledby": "events", class: "wide" },
    make("div", { class: "row" }, make("h2", { id: "events" }, "Events"), make("label", { for: "filter" }, "Filter"), filter, pause), list);
  return { element, add };
}
