// What goes over a line, message by message: in hex and in words, with filter, search and pause.
//
// Only the rows that are in sight are elements, whatever is kept.

import { make, write } from "./dom.js";

const KEPT_MAX = 5000;
const MARGIN_ROWS = 4;
const SIDES = { host: "from the host", device: "from a device" };
const PARTS = [["time", "ms"], ["side", ""], ["whose", "of"], ["hex", "bytes"], ["text", "in words"]];
const PAIRS = /^(?:[0-9a-f]{2}){2,}$/;

/** What `text` is looked for as: bytes may be written without blanks. */
function pattern(text) {
  const plain = text.trim().toLowerCase();
  return PAIRS.test(plain) ? [plain, plain.match(/../g).join(" ")] : [plain];
}

const has = (message, patterns) => patterns.some((each) => message.hay.includes(each));
const milliseconds = (message) => (message.time_ns / 1e6).toFixed(3);
const isCounted = (number, one) => `${number} ${one}${number === 1 ? "" : "s"}`;

export class Monitor {
  #kept = [];
  #shown = [];
  #waiting = [];
  #lost = 0;
  #count = 0;
  #chosen = null;
  #isPaused = false;
  #rows = [];
  #follows = true;
  #frame = null;

  constructor() {
    this.filter = make("input", { id: "traffic-filter", type: "search", oninput: () => this.#sift() });
    this.side = make("select", { id: "traffic-side", onchange: () => this.#sift() },
      make("option", { value: "" }, "both ways"), ...Object.entries(SIDES).map(([value, text]) => make("option", { value }, text)));
    this.search = make("input", { id: "traffic-search", type: "search" });
    this.pause = make("button", { type: "button", "aria-pressed": "false", onclick: () => this.#hold(!this.#isPaused) }, "Pause");
    this.counts = make("p", { class: "doc", "data-counts": "" });
    this.told = make("p", { class: "doc", role: "status" });
    this.space = make("div", { class: "space", role: "presentation" });
    this.list = make("div", {
      class: "traffic", role: "listbox", tabindex: 0, "aria-label": "Messages, oldest first",
      onscroll: () => this.#soon(), onkeydown: (event) => this.#key(event),
    }, this.space);
    this.detail = make("p", { class: "detail", id: "traffic-detail" });
    this.element = make("section", { "aria-labelledby": "traffic", class: "wide" },
      make("div", { class: "row" }, make("h2", { id: "traffic" }, "Traffic"), this.pause,
        make("button", { type: "button", onclick: () => this.#clear() }, "Clear")),
      make("div", { class: "row" }, make("label", { for: "traffic-filter" }, "Show only"), this.filter,
        make("label", { for: "traffic-side" }, "Direction"), this.side),
      make("form", { class: "row", onsubmit: (event) => { event.preventDefault(); this.#find(1); } },
        make("label", { for: "traffic-search" }, "Search"), this.search, make("button", {}, "Next"),
        make("button", { type: "button", onclick: () => this.#find(-1) }, "Previous")),
      this.counts, make("div", { class: "message header", "aria-hidden": "true" },
        ...PARTS.map(([name, title]) => make("span", { class: name }, title))),
      this.list, this.detail, this.told);
    this.observer = new ResizeObserver(() => this.#soon());
    this.observer.observe(this.list);
    this.#soon();
  }

  close() {
    this.observer.disconnect();
    cancelAnimationFrame(this.#frame);
  }

  /** Take an event `traffic`; `isFirst`: it has what was before. */
  hear({ messages, dropped }, isFirst) {
    if (isFirst) this.#kept = this.#waiting = this.#shown = [];
    this.#lost += dropped;
    for (const message of messages) {
      message.number = ++this.#count;
      message.hay = `${message.hex} ${message.text}`.toLowerCase();
    }
    if (this.#isPaused && !isFirst) {
      this.#waiting = this.#waiting.concat(messages);
      this.#lost += Math.max(0, this.#waiting.length - KEPT_MAX);
      this.#waiting = this.#waiting.slice(-KEPT_MAX);
    } else this.#keep(messages);
    this.#soon();
  }

  #keep(messages) {
    const surplus = Math.max(0, this.#kept.length + messages.length - KEPT_MAX);
    this.#kept = this.#kept.concat(messages).slice(-KEPT_MAX);
    const isEnd = this.#isAtEnd;
    const oldest = surplus ? this.#kept[0].number : 0;
    const gone = this.#shown.findIndex((each) => each.number >= oldest);
    const left = surplus ? (gone < 0 ? [] : this.#shown.slice(gone)) : this.#shown;
    const moved = this.#shown.length - left.length;
    this.#shown = left.concat(messages.filter(this.#wanted));
    if (isEnd) this.#follows = true;
    else if (moved) this.list.scrollTop -= moved * this.#height; // what is read stays where it is
  }

  get #isAtEnd() {
    return this.list.scrollTop + this.list.clientHeight >= this.list.scrollHeight - this.#height;
  }

  get #wanted() {
    const patterns = pattern(this.filter.value);
    const side = this.side.value;
    return (message) => (!side || message.direction === side) && has(message, patterns);
  }

  #sift() {
    this.#shown = this.#kept.filter(this.#wanted);
    this.#follows = true;
    write(this.told, `${isCounted(this.#shown.length, "message")} of ${this.#kept.length} shown`);
    this.#soon();
  }

  #hold(isPaused) {
    this.#isPaused = isPaused;
    this.pause.setAttribute("aria-pressed", String(isPaused));
    const waiting = this.#waiting;
    this.#waiting = [];
    this.#keep(waiting);
    write(this.told, isPaused ? "Paused; what comes waits" : `Goes on; ${isCounted(waiting.length, "message")} waited`);
    this.#soon();
  }

  #clear() {
    this.#kept = this.#shown = this.#waiting = [];
    this.#lost = 0;
    this.#choose(null);
    write(this.told, "Cleared");
    this.#soon();
  }

  /** The next, or the previous, message shown that has what is searched for. */
  #find(step) {
    const patterns = pattern(this.search.value);
    const count = this.#shown.length;
    const from = this.#chosen ? this.#shown.indexOf(this.#chosen) : step > 0 ? -1 : count;
    for (let turn = 1; turn <= count; turn++) {
      const message = this.#shown[(from + step * turn + count * 2) % count];
      if (!has(message, patterns)) continue;
      this.#choose(message);
      write(this.told, `Message ${message.number}`);
      return;
    }
    write(this.told, "None of the messages shown has that");
  }

  #key(event) {
    const page = Math.max(1, Math.floor(this.list.clientHeight / this.#height) - 1);
    const count = this.#shown.length;
    const at = this.#chosen ? this.#shown.indexOf(this.#chosen) : count;
    const to = { ArrowUp: at - 1, ArrowDown: at + 1, PageUp: at - page, PageDown: at + page, Home: 0, End: count - 1 }[event.key];
    if (to === undefined || !count) return;
    event.preventDefault();
    this.#choose(this.#shown[Math.min(count - 1, Math.max(0, to))]);
  }

  /** Mark `message`, have it in sight, and show all of it. */
  #choose(message) {
    this.#chosen = message;
    write(this.detail, message ? `${milliseconds(message)} ms ${SIDES[message.direction]}: ${message.hex}${message.text ? ` – ${message.text}` : ""}` : "");
    if (message) {
      const top = this.#shown.indexOf(message) * this.#height;
      const low = top + this.#height - this.list.clientHeight;
      this.space.style.height = `${this.#shown.length * this.#height}px`;
      this.list.scrollTop = Math.min(top, Math.max(low, this.list.scrollTop));
      this.#follows = false;
    }
    this.#soon();
  }

  // -- what is drawn --

  get #height() {
    return parseFloat(getComputedStyle(this.list).getPropertyValue("--row")) || 24;
  }

  #soon() {
    this.#frame ??= requestAnimationFrame(() => {
      this.#frame = null;
      this.#draw();
    });
  }

  #draw() {
    const height = this.#height;
    this.space.style.height = `${this.#shown.length * height}px`;
    if (this.#follows) this.list.scrollTop = this.list.scrollHeight;
    this.#follows = false;
    const first = Math.max(0, Math.floor(this.list.scrollTop / height) - MARGIN_ROWS);
    const rows = this.#shown.slice(first, first + Math.ceil(this.list.clientHeight / height) + 2 * MARGIN_ROWS);
    while (this.#rows.length < rows.length) this.#rows.push(this.#makeRow());
    this.#rows.splice(rows.length).forEach((row) => row.element.remove());
    rows.forEach((message, index) => this.#fill(this.#rows[index], message, first + index, height));
    const chosen = this.#rows.find((row) => row.message === this.#chosen);
    if (chosen) this.list.setAttribute("aria-activedescendant", chosen.element.id);
    else this.list.removeAttribute("aria-activedescendant");
    const lost = this.#lost ? `, ${this.#lost} dropped` : "";
    const waiting = this.#isPaused ? `, paused: ${this.#waiting.length} wait` : "";
    write(this.counts, `${isCounted(this.#shown.length, "message")} of ${this.#kept.length}${waiting}${lost}`);
  }

  #makeRow() {
    const parts = PARTS.map(([name]) => make("span", { class: name }));
    const row = { parts, element: make("div", { role: "option", id: `message-row-${this.#rows.length}` }, ...parts) };
    row.element.addEventListener("click", () => this.#choose(row.message));
    this.space.append(row.element);
    return row;
  }

  #fill(row, message, index, height) {
    const isChosen = message === this.#chosen;
    row.message = message;
    row.element.style.top = `${index * height}px`;
    row.element.className = `message ${message.direction}`;
    row.element.setAttribute("aria-selected", String(isChosen));
    row.element.setAttribute("aria-label", `${milliseconds(message)} ms ${SIDES[message.direction]}: ${message.text || message.hex}`);
    row.element.setAttribute("aria-posinset", index + 1);
    row.element.setAttribute("aria-setsize", this.#shown.length);
    const [time, side, unit, hex, text] = row.parts;
    write(time, milliseconds(message));
    write(side, message.direction === "host" ? ">" : "<");
    write(unit, message.unit === null ? "" : String(message.unit));
    write(hex, message.hex);
    write(text, message.text);
  }
}
