// What all pages of the studio share: questions to the server, and elements.

/** An answer of the server as JSON; throws an Error with its one line and `status`. */
export const ask = async (path, value) => {
  const options = value === undefined ? {} : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(value) };
  return read(await reach(path, options));
};

/** The same for bytes, as a photo; `told(share)` hears how much of them has gone. */
export const send = (path, bytes, told) => new Promise((done, failed) => {
  const request = new XMLHttpRequest();
  request.open("POST", path);
  request.setRequestHeader("Content-Type", "application/octet-stream");
  request.upload.addEventListener("progress", (e) => { if (e.lengthComputable) told(e.loaded / e.total); });
  request.addEventListener("error", () => failed(new Error(NO_SERVER)));
  request.addEventListener("load", () => {
    let value = {};
    try { value = JSON.parse(request.responseText); } catch { value = { problem: request.responseText.trim() }; }
    if (request.status < 300) done(value);
    else failed(Object.assign(new Error(value.problem || `status ${request.status}`), { status: request.status }));
  });
  request.send(bytes);
});

export const NO_SERVER = "The studio does not answer. If its program has ended, start it again: nothing that was saved is lost.";

const reach = async (path, options) => {
  try { return await fetch(path, options); } catch { throw new Error(NO_SERVER); }
};
const read = async (answer) => {
  const text = await answer.text();
  let value = {};
  try { value = JSON.parse(text); } catch { value = { problem: text.trim() }; }
  if (!answer.ok) throw Object.assign(new Error(value.problem || `status ${answer.status}`), { status: answer.status });
  return value;
};

export const $ = (id) => document.getElementById(id);

/** An element with attributes (`on...` are listeners, `text` is text) and children. No markup is ever parsed. */
export const element = (name, attributes = {}, ...children) => {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key === "text") made.textContent = value;
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, String(value));
  }
  made.append(...children.filter((c) => c !== null && c !== undefined));
  return made;
};

/** Shows a line at the top of the page; an empty one hides it. */
export const complain = (error) => {
  const line = $("line"), text = error ? error.message || String(error) : "";
  if (line.textContent !== text) line.textContent = text;
};

/** Says something to screen readers. */
export const say = (text) => { $("said").textContent = text; };

/** Says something to everybody, for a moment. */
export const note = (text) => {
  say(text);
  $("note").textContent = text;
  clearTimeout(note.end);
  note.end = setTimeout(() => { $("note").textContent = ""; }, 6000);
};

/** Shows in an element what is waited for, and how long already; the answer ends it. */
export const waiting = (place, words) => {
  const start = performance.now(), show = () => {
    const past = Math.floor((performance.now() - start) / 1000);
    place.textContent = `${words} …${past > 2 ? ` ${past} s` : ""}`;
  };
  show();
  const clock = setInterval(show, 1000);
  return () => clearInterval(clock);
};

/** Runs `work` while a button is busy; what goes wrong is shown. */
export const busy = async (button, work) => {
  if (button.getAttribute("aria-busy") === "true") return;
  button.setAttribute("aria-busy", "true");
  button.disabled = true;
  try {
    complain(null);
    await work();
  } catch (error) {
    complain(error);
  } finally {
    button.removeAttribute("aria-busy");
    button.disabled = false;
  }
};

export const seconds = (s) => (s < 10 ? `${s.toFixed(1)} s` : s < 90 ? `${Math.round(s)} s` : `${Math.floor(s / 60)} min ${Math.round(s % 60)} s`);
