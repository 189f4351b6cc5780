// Elements, and how names and values are shown.

/** An element with properties (on…: listeners, others: attributes) and children. */
export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** Write `text` into `element`, only if it is another: nothing is told twice. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** `positive_stop` as people write it. */
export const words = (name) => {
  const text = name.replaceAll("_", " ");
  return text.charAt(0).toUpperCase() + text.slice(1);
};

/** A value of a control, for people. */
export function shown(value, unit = "") {
  const text = plain(value);
  return unit && typeof value === "number" ? `${text} ${unit}` : text;
}

function plain(value) {
  if (value === null || value === undefined || value === "") return "–";
  if (typeof value === "boolean") return value ? "on" : "off";
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : String(Number(value.toFixed(3)));
  if (Array.isArray(value)) return value.map(plain).join(", ") || "–";
  if (typeof value === "object") return Object.entries(value).map(([name, each]) => `${name} ${plain(each)}`).join(", ") || "–";
  return String(value);
}

export const seconds = (timeNs) => `${(timeNs / 1e9).toFixed(3)} s`;

const notice = document.getElementById("notice");
const problem = document.getElementById("problem");
let timer;

function tell(element, text) {
  clearTimeout(timer);
  notice.textContent = problem.textContent = "";
  element.textContent = text;
  timer = setTimeout(() => (element.textContent = ""), element === problem ? 12000 : 5000);
}

/** Do `work`; say `done(result)` when it is done, or what went wrong. */
export async function attempt(work, done) {
  try {
    const result = await work();
    if (done) tell(notice, done(result));
    return result;
  } catch (error) {
    tell(problem, error.message);
    return undefined;
  }
}
