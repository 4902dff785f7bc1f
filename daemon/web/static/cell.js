// The connection to the cell: who is logged in, the newest state, and requests. Nothing here draws.

const QUIET_MS = 3000; // without a word for so long the page is grey: the daemon speaks every second
const RETRY_MS = 1500;

export const cell = {
  state: null, // the newest state, as the daemon sent it
  heard: 0, // performance.now() of it
  me: null, // {user, role, csrf, look, users}
  changed: () => {}, // called after every change of the above
};

let stream = null;

export class Refused extends Error {
  constructor(status, error) {
    super(error.text);
    this.status = status;
    this.error = error;
  }
}

export const silentFor = () => (cell.state === null ? Infinity : (performance.now() - cell.heard) / 1e3);
export const isStale = () => 1e3 * silentFor() > QUIET_MS;

const RANK = { viewer: 0, operator: 1, integrator: 2 };
export const may = (role) => Boolean(cell.me && cell.me.role && RANK[cell.me.role] >= RANK[role]);

export async function get(path) {
  return answer(await fetch(path, { headers: { Accept: "application/json" } }));
}

async function post(path, content) {
  const headers = { "Content-Type": "application/json", "X-Cellward-Csrf": (cell.me && cell.me.csrf) || "" };
  return answer(await fetch(path, { method: "POST", headers, body: JSON.stringify(content) }));
}

async function answer(response) {
  const content = await response.json().catch(() => null);
  if (response.ok) return content;
  if (response.status === 401 && cell.me && cell.me.user) await who(); // the session is over
  throw new Refused(response.status, (content && content.error) || { text: `HTTP ${response.status}`, hint: "" });
}

// Ask the engine for something, as the command line does.
export const ask = async (method, params = {}) => (await post(`/api/do/${method}`, params)).done;

export async function login(token) {
  cell.me = { ...cell.me, ...(await post("/api/login", { token })), look: true };
  listen();
  cell.changed();
}

export async function logout() {
  await post("/api/logout", {});
  await who();
}

export async function who() {
  cell.me = await get("/api/me");
  if (cell.me.look) listen();
  else if (stream) {
    stream.close();
    stream = null;
    cell.state = null;
  }
  cell.changed();
}

function listen() {
  if (stream) return;
  stream = new EventSource("/api/events");
  stream.addEventListener("state", (event) => {
    cell.state = JSON.parse(event.data);
    cell.heard = performance.now();
    cell.changed();
  });
  let opened = false;
  stream.addEventListener("open", () => {
    if (opened) who().catch(() => {}); // connected again, perhaps to a daemon that was restarted
    opened = true;
  });
  stream.addEventListener("error", () => {
    // The browser connects again by itself unless the daemon refused it; then we ask why.
    if (stream && stream.readyState === EventSource.CLOSED) {
      stream = null;
      setTimeout(() => who().catch(() => listen()), RETRY_MS);
    }
  });
}
