// Calls of the server's interface. The token of this run comes with the address that the terminal
// shows; it is kept so that a reload and further tabs work.

const KEY = "roadsight-token";

export function takeToken() {
  const found = /(?:^#|&)token=([\w-]+)/.exec(location.hash);
  if (!found) return;
  localStorage.setItem(KEY, found[1]);
  history.replaceState(null, "", location.pathname);
}

class ApiError extends Error {
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

async function call(path, options = {}) {
  const headers = { "X-Roadsight-Token": localStorage.getItem(KEY) ?? "", ...options.headers };
  let answer;
  try {
    answer = await fetch(`/api/${path}`, { ...options, headers });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError("The studio does not answer: is it still running in the terminal?", 0);
  }
  if (answer.ok) return answer;
  const told = await answer.json().catch(() => ({ error: answer.statusText }));
  throw new ApiError(told.error || `error ${answer.status}`, answer.status);
}

export const siteUrl = (stem, rest) => `sites/${encodeURIComponent(stem)}/${rest}`;

export async function get(path, options) {
  return (await call(path, options)).json();
}

export async function getBytes(path, options) {
  return (await call(path, options)).arrayBuffer();
}

export async function getBlob(path, options) {
  return (await call(path, options)).blob();
}

// A file that the server makes of what is sent, saved as it names it.
export async function download(path, content) {
  const answer = await call(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content) });
  const [, name] = /filename="?([^";]+)"?/.exec(answer.headers.get("Content-Disposition") ?? "") ?? [, "export"];
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await answer.blob());
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  return name;
}

// version: of what the content rests on; the server refuses it where there is another one by now.
export async function send(method, path, content, { version, ...options } = {}) {
  const headers = { "Content-Type": "application/json", ...(version === undefined ? {} : { "If-Match": version }) };
  return (await call(path, { ...options, method, headers, body: JSON.stringify(content) })).json();
}
