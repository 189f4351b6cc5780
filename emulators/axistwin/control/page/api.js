// What the panel asks of the control API: requests, and events over the WebSocket.

const TOKEN = "axistwin-token"; // kept until the tab is closed
export const COME_AGAIN_MS = 1000;
const LET_GO = 4002; // how the daemon closes when lines have come or gone

/** An answer that is an error; its message is for people, status is HTTP's (0: no answer). */
export class ProblemError extends Error {
  constructor(status, message) {
    super(message);
    this.status = status;
  }
}

export const hasToken = () => sessionStorage.getItem(TOKEN) !== null;
export const keepToken = (token) => sessionStorage.setItem(TOKEN, token);

/** The JSON at `path` below /api/v1.  Throws ProblemError. */
export async function ask(path, { method = "GET", body } = {}) {
  const token = sessionStorage.getItem(TOKEN);
  const headers = {};
  if (token) headers.Authorization = `Bearer ${token}`;
  if (body !== undefined) headers["Content-Type"] = "application/json";
  let answer;
  try {
    answer = await fetch(`api/v1/${path}`, { method, headers, body: JSON.stringify(body) });
  } catch {
    throw new ProblemError(0, "The daemon does not answer. Is it still running?");
  }
  const content = await answer.json();
  if (!answer.ok) throw new ProblemError(answer.status, content.message);
  return content;
}

const path = (device) => `devices/${encodeURIComponent(device)}`;

export const getDevice = (device) => ask(path(device));
export const getControls = async (device) => (await ask(`${path(device)}/controls`)).controls;
export const getState = (device) => ask(`${path(device)}/state`);
export const getControl = (device, name) => ask(`${path(device)}/controls/${encodeURIComponent(name)}`);
export const setControl = (device, name, value) =>
  ask(`${path(device)}/controls/${encodeURIComponent(name)}`, { method: "PUT", body: { value } });
export const switchPower = (device, action, offS = 0) =>
  ask(`${path(device)}/power`, { method: "POST", body: { action, off_s: offS } });

/** The subprotocols that bring the token: a WebSocket of a browser has no header for it. */
function protocols() {
  const token = sessionStorage.getItem(TOKEN);
  if (!token) return [];
  const code = btoa(token).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
  return ["axistwin", `axistwin.bearer.${code}`];
}

/** Tell `hear` every event of `devices` and what goes over `lines` (all devices: none named), and
 *  `page.link` whether it is connected.  Comes again when it is cut, with `page.renew` if what is
 *  shown is no more what there is.  Returns what ends it. */
export function watch(devices, hear, page, lines = []) {
  const query = new URLSearchParams([...devices.map((each) => ["device", each]), ...lines.map((each) => ["traffic", each])]);
  const url = new URL(`api/v1/events?${query}`, location.href);
  url.protocol = url.protocol.replace("http", "ws");
  url.hash = "";
  let socket;
  let timer;
  function join() {
    socket = new WebSocket(url, protocols());
    socket.onopen = () => page.link(true);
    socket.onmessage = (message) => hear(JSON.parse(message.data));
    socket.onclose = ({ code }) => {
      page.link(false);
      timer = setTimeout(code === LET_GO ? page.renew : join, COME_AGAIN_MS);
    };
  }
  join();
  return () => {
    clearTimeout(timer);
    socket.onclose = socket.onmessage = null;
    socket.onopen = () => socket.close(); // a browser complains of one that is closed before
    if (socket.readyState === WebSocket.OPEN) socket.close();
  };
}
