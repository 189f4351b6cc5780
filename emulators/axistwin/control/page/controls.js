// Controls of a device, as switches, fields, choices and buttons.

import { getControl, setControl } from "./api.js";
import { attempt, make, seconds, shown, words, write } from "./dom.js";

const NUMBERS_SHOWN_MAX = 32; // as many values as a snapshot has of one control

let count = 0;
const newId = () => `control-${++count}`;

/** Sets `control` of `device` to `value`, and says so. */
const work = (device, control, value) =>
  attempt(() => setControl(device, control.name, value), (done) => {
    const given = control.kind === "nothing" ? "done" : shown(value, control.unit);
    const text = control.readable ? `set to ${given}` : given;
    return `${label(control)}: ${text} at ${seconds(done.time_ns)}`;
  });

const group = (control) => (control.name.includes(".") ? control.name.split(".")[0] : "");
const label = (control) => words(control.name.includes(".") ? control.name.split(".").slice(1).join(".") : control.name);

/** `controls` with each of few numbers for itself: outputs becomes outputs.1, outputs.2 and so on. */
export function spread(controls, values) {
  return controls.flatMap((control) => {
    const range = control.numbers;
    if (!range || range.last - range.first >= NUMBERS_SHOWN_MAX) return [control];
    const each = Array.from({ length: range.last - range.first + 1 }, (_, index) => `${control.name}.${range.first + index}`);
    return each.filter((name) => name in values).map((name) => ({ ...control, name, numbers: null, value: values[name] }));
  });
}

/** Sections of what can be worked, one per group of names; and what shows new values. */
export function makeControls(device, controls) {
  const updates = new Map();
  const groups = new Map();
  for (const control of controls) {
    const key = control.numbers ? control.name : group(control);
    groups.set(key, [...(groups.get(key) ?? []), control]);
  }
  const sections = [...groups].map(([name, members]) => makeGroup(device, name, members, updates));
  return { sections, show: (values) => Object.entries(values).forEach(([name, value]) => updates.get(name)?.(value)) };
}

function makeGroup(device, name, members, updates) {
  const id = newId();
  const isOne = name && members.every((each) => each.doc === members[0].doc);
  const rows = members.map((control) => makeRow(device, control, !isOne, updates));
  return make("section", { "aria-labelledby": id },
    make("h2", { id }, name ? words(name) : "Settings and actions"),
    ...(isOne ? [make("p", { class: "doc" }, members[0].doc)] : []),
    make("div", { class: members.every((each) => each.kind === "switch" && each.readable && !each.numbers) ? "rows switches" : "rows" }, ...rows));
}

function makeRow(device, control, hasDoc, updates) {
  const ids = { field: newId(), doc: hasDoc ? newId() : null };
  const maker = control.numbers ? makeNumbered : (MAKERS[control.kind] ?? makeText);
  const row = maker(device, control, ids, (update) => updates.set(control.name, update));
  if (hasDoc) row.append(make("p", { id: ids.doc, class: "doc" }, control.doc));
  return row;
}

function makeSwitch(device, control, ids, onValue) {
  if (!control.readable) return makePair(device, control, ids);
  const state = make("span", { class: "word" });
  const button = make("button", {
    type: "button", role: "switch", id: ids.field, class: "switch", "aria-describedby": ids.doc, "data-control": control.name,
    onclick: () => work(device, control, button.getAttribute("aria-checked") !== "true"),
  }, make("span", { class: "name" }, label(control)), make("span", { class: "knob", "aria-hidden": "true" }), state);
  const show = (value) => {
    button.setAttribute("aria-checked", String(Boolean(value)));
    write(state, value ? "on" : "off");
  };
  state.setAttribute("aria-hidden", "true"); // aria-checked tells it
  show(control.value);
  onValue(show);
  return make("div", { class: "control" }, button);
}

/** A switch of which nobody can see how it is. */
function makePair(device, control, ids) {
  const button = (text, value) => make("button", {
    type: "button", "aria-label": `${label(control)} ${text}`, "aria-describedby": ids.doc, onclick: () => work(device, control, value),
  }, text);
  return make("div", { class: "control" }, make("div", { class: "row", role: "group", "aria-label": label(control) },
    make("span", { class: "name" }, label(control)), button("on", true), button("off", false)));
}

function makeAction(device, control, ids) {
  return make("div", { class: "control" }, make("button", {
    type: "button", "aria-describedby": ids.doc, "data-control": control.name, onclick: () => work(device, control, null),
  }, label(control)));
}

function makeChoice(device, control, ids, onValue) {
  const select = make("select", { id: ids.field, "aria-describedby": ids.doc, onchange: () => work(device, control, select.value) },
    ...control.choices.map((each) => make("option", {}, each)));
  const show = (value) => (select.value = value);
  show(control.value);
  onValue(show);
  return make("div", { class: "control" }, make("div", { class: "row" }, make("label", { for: ids.field, class: "name" }, label(control)), select));
}

/** A field with a button: `read` makes its text a value. */
function makeField(device, control, ids, onValue, properties, read) {
  const field = make("input", { id: ids.field, "aria-describedby": ids.doc, "data-control": control.name, ...properties });
  let isTouched = false;
  field.addEventListener("input", () => (isTouched = true));
  const show = (value) => {
    if (!isTouched) field.value = value ?? "";
  };
  const send = async (event) => {
    event.preventDefault();
    isTouched = false;
    await work(device, control, read(field.value));
  };
  show(control.value);
  onValue(show);
  const unit = control.unit ? make("span", { class: "unit" }, control.unit) : "";
  const name = `${control.readable ? "Set" : "Do"} ${label(control)}`;
  return make("form", { class: "control", onsubmit: send },
    make("div", { class: "row" }, make("label", { for: ids.field, class: "name" }, label(control)), field, unit,
      make("button", { "aria-label": name }, control.readable ? "Set" : "Do")));
}

const makeText = (device, control, ids, onValue) => makeField(device, control, ids, onValue, { type: "text", autocomplete: "off" }, String);

const makeNumber = (device, control, ids, onValue) => makeField(device, control, ids, onValue,
  { type: "number", required: true, step: control.kind === "whole" ? 1 : "any", min: control.low, max: control.high }, Number);

/** One of many: its number, and what it is, or shall be. */
function makeNumbered(device, control, ids) {
  const { first, last } = control.numbers;
  const number = make("input", { id: ids.field, type: "number", required: true, min: first, max: last, value: first, "aria-describedby": ids.doc });
  const isSwitch = control.kind === "switch";
  const value = isSwitch
    ? make("select", { "aria-label": "Value" }, make("option", { value: "1" }, "on"), make("option", { value: "0" }, "off"))
    : make("input", { type: "number", step: control.kind === "whole" ? 1 : "any", value: 0, min: control.low, max: control.high, "aria-label": "Value" });
  const one = () => ({ ...control, name: `${control.name}.${number.value}` });
  const read = () => attempt(() => getControl(device, one().name), (answer) => `${control.name} ${number.value} is ${shown(answer.value, control.unit)}`)
    .then((answer) => answer && (value.value = isSwitch ? String(Number(answer.value)) : answer.value));
  const send = (event) => {
    event.preventDefault();
    work(device, one(), isSwitch ? value.value === "1" : Number(value.value));
  };
  return make("form", { class: "control", onsubmit: send }, make("div", { class: "row" },
    make("label", { for: ids.field }, `Number (${first} to ${last})`), number,
    control.readable ? make("button", { type: "button", onclick: read }, "Read") : "",
    ...(control.writable ? [value, make("button", {}, "Set")] : [])));
}

const MAKERS = { switch: makeSwitch, number: makeNumber, whole: makeNumber, choice: makeChoice, nothing: makeAction };
