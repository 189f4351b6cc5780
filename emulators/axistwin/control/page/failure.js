// Whether a line is served.

import { make, write } from "./dom.js";

/** An alert, empty as long as the line is served: why not at first, and what events tell. */
export function makeFailure(line, reason) {
  const element = make("p", { class: "failure", role: "alert" });
  const show = (why) => write(element, why ? `Not served any more: ${why}` : "");
  const hear = (event) => {
    if (event.event !== "line" || event.line !== line) return;
    if (event.kind === "line_failed") show(event.details.error);
    else if (event.kind === "line_removed") show("the line was removed");
  };
  show(reason);
  return { element, hear };
}
