// Faults of the wire: what goes wrong on a line, how often it has, and how to add and remove it.

import { ask } from "./api.js";
import { attempt, make, words, write } from "./dom.js";

const KINDS = ["corrupt", "drop", "duplicate", "delay", "jitter", "break", "noise", "disconnect", "busy", "error_frame"];
const DIRECTIONS = [["", "both directions"], ["to_host", "to the host"], ["to_device", "to the device"]];
const FIELDS = [
  ["message", "Words", { type: "text", maxlength: 200 }],
  ["hex", "Bytes (hex)", { type: "text", maxlength: 200 }],
  ["count", "Times", { type: "number", min: 1, step: 1 }],
  ["chance", "Chance (0 to 1)", { type: "number", min: 0, max: 1, step: "any" }],
  ["per_s", "Per second", { type: "number", min: 0.001, max: 1000, step: "any" }],
  ["duration_ms", "Duration (ms)", { type: "number", min: 0.001, max: 60000, step: "any" }],
];

/** The section for `line`; `hear` takes its events, and tells them in words. */
export async function makeFaults(line) {
  const path = `lines/${encodeURIComponent(line)}/faults`;
  const rows = new Map();
  const list = make("ul", { class: "faults", "aria-label": "Faults of the wire" });
  const none = make("p", { class: "doc" }, "None: everything passes as it is.");
  const refresh = async () => {
    const found = await ask(path);
    const gone = new Set(rows.keys());
    for (const fault of found.faults) {
      gone.delete(fault.number);
      if (!rows.has(fault.number)) put(fault);
      rows.get(fault.number).show(fault);
    }
    gone.forEach(drop);
    none.hidden = rows.size > 0;
  };
  const put = (fault) => {
    const row = makeRow(fault, () => attempt(async () => {
      await ask(`${path}/${fault.number}`, { method: "DELETE" });
      await refresh();
    }, () => `Fault ${fault.number} is removed`));
    rows.set(fault.number, row);
    list.append(row.element);
  };
  const drop = (number) => {
    rows.get(number).element.remove();
    rows.delete(number);
  };
  const add = (body) => attempt(async () => {
    const fault = await ask(path, { method: "POST", body });
    await refresh();
    return fault;
  }, (fault) => `Fault ${fault.number} is added: ${chosen(fault)}`);
  const hear = (event) => {
    if (event.kind !== "wire_fault") return null;
    const { fault, fault_kind: kind, acted, text } = event.details;
    refresh().catch(() => {}); // the connection tells that the daemon has gone
    return `Fault ${fault} (${words(kind)})${acted > 1 ? `, ${acted} times, last` : ""}: ${text}`;
  };
  await refresh();
  const element = make("section", { "aria-labelledby": "faults", class: "wide" },
    make("h2", { id: "faults" }, "Faults on the wire"), none, list, makeForm(add));
  return { element, hear };
}

function chosen(fault) {
  const given = FIELDS.filter(([name]) => fault[name] !== null && fault[name] !== "").map(([name, label]) => `${label.toLowerCase()} ${fault[name]}`);
  const direction = DIRECTIONS.find(([name]) => name === fault.direction)?.[1];
  return [words(fault.kind), ...(direction ? [direction] : []), ...given].join(", ");
}

function makeRow(fault, remove) {
  const done = make("span", { class: "quiet", "data-fault": fault.number });
  const show = (now) => write(done, ` seen ${now.seen}, acted ${now.acted}${now.over ? ", over" : ""}${now.last ? `; ${now.last}` : ""}`);
  const element = make("li", { class: "row" }, make("span", {}, `${fault.number}: ${chosen(fault)}`), done,
    make("button", { type: "button", "aria-label": `Remove fault ${fault.number}`, onclick: remove }, "Remove"));
  return { element, show };
}

function makeForm(add) {
  const kind = make("select", { id: "fault-kind" }, ...KINDS.map((each) => make("option", { value: each }, words(each))));
  const direction = make("select", { id: "fault-direction" }, ...DIRECTIONS.map(([value, text]) => make("option", { value }, text)));
  const fields = FIELDS.map(([name, label, properties]) => [name, label, make("input", { id: `fault-${name}`, autocomplete: "off", ...properties })]);
  const send = (event) => {
    event.preventDefault();
    const body = { kind: kind.value, direction: direction.value || null };
    for (const [name, , field] of fields) {
      if (field.value !== "") body[name] = field.type === "number" ? Number(field.value) : field.value;
    }
    add(body);
  };
  const labelled = (id, text, field) => make("div", { class: "row" }, make("label", { for: id }, text), field);
  return make("form", { onsubmit: send, "aria-label": "Add a fault" },
    make("p", { class: "doc" }, "Without times, chance or rate it acts once, on the next message that has the words and bytes."),
    make("div", { class: "row" }, labelled("fault-kind", "Kind", kind), labelled("fault-direction", "Direction", direction),
      ...fields.map(([name, label, field]) => labelled(`fault-${name}`, label, field)), make("button", {}, "Add")));
}
