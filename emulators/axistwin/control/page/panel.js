// The front panel: which view is shown, and the connection.  Everything comes from the control API.

import { COME_AGAIN_MS, hasToken, keepToken } from "./api.js";
import { deviceView } from "./device.js";
import { make, write } from "./dom.js";
import { lineView } from "./line.js";
import { overview } from "./overview.js";

const main = document.getElementById("main");
const connection = document.getElementById("connection");
let leave = () => {};
let turn = 0;

/** Tell whether events come. */
function link(isUp) {
  write(connection, isUp ? "live" : "no connection");
  connection.className = isUp ? "up" : "down";
}

/** Nothing is watched. */
function unlink() {
  write(connection, "");
  connection.className = "";
}

const VIEWS = { device: deviceView, line: lineView };

/** The view that the address names: `#/`, `#/device/NAME` or `#/line/NAME`. */
function makeView() {
  const page = { link, renew };
  const [, kind, name] = location.hash.match(/^#\/(device|line)\/(.+)$/) ?? [];
  return name ? VIEWS[kind](decodeURIComponent(name), page) : overview(page);
}

/** Show what the address names. */
async function go({ isFirst = false } = {}) {
  const mine = ++turn;
  leave();
  leave = () => {};
  let view;
  try {
    view = await makeView();
  } catch (error) {
    view = { title: "Problem", element: error.status === 401 ? tokenForm() : refusal(error), leave: () => {} };
    unlink();
  }
  show(view, mine, !isFirst);
}

/** The lines have changed: show the view anew, as soon as what it shows is there. */
async function renew() {
  const mine = turn;
  try {
    show(await makeView(), mine, main.contains(document.activeElement));
  } catch { // perhaps it is just being added again
    setTimeout(() => mine === turn && renew(), COME_AGAIN_MS);
  }
}

/** Show `view`, unless the user has gone elsewhere since the turn `mine`. */
function show(view, mine, isFocused) {
  if (mine !== turn) {
    view.leave();
    return;
  }
  leave();
  leave = view.leave;
  document.title = `${view.title} – axistwin`;
  main.replaceChildren(view.element);
  if (isFocused) (main.querySelector("h1") ?? main).focus();
}

const refusal = (error) => make("div", {}, make("h1", { tabindex: -1 }, "That did not work"), make("p", {}, error.message),
  make("p", {}, make("button", { type: "button", onclick: () => go() }, "Try again"), " ", make("a", { href: "#/" }, "All devices")));

/** Asks for the token that the daemon wants. */
function tokenForm() {
  const wrong = hasToken() ? "The token that you gave is not the daemon's." : "";
  const field = make("input", { id: "token", type: "password", autocomplete: "off", required: true });
  const send = (event) => {
    event.preventDefault();
    keepToken(field.value.trim());
    go();
  };
  return make("form", { class: "panel", onsubmit: send }, make("h1", { tabindex: -1 }, "Token"),
    make("p", {}, "This daemon asks for the token that it was started with. The panel keeps it until you close the tab."),
    make("p", { class: "failure", role: "alert" }, wrong),
    make("div", { class: "row" }, make("label", { for: "token" }, "Token"), field, make("button", {}, "Go on")));
}

document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault(); // the address says which view is shown
  main.focus();
});
window.addEventListener("hashchange", () => go());
go({ isFirst: true });
