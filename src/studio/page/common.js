// What all views share: asking the program, making elements, colours.

let key = sessionStorage.getItem("catoptra-key") ?? "";

/** Takes the key out of the address: it is not to be shown, shared or remembered. */
function takeKey() {
  const given = location.hash.slice(1);
  if (!/^[0-9a-f]{32}$/.test(given)) return;
  key = given;
  sessionStorage.setItem("catoptra-key", key);
  history.replaceState(null, "", location.pathname);
}
takeKey();
window.addEventListener("hashchange", takeKey);

async function post(name, body, signal) {
  let reply;
  try {
    reply = await fetch(`/api/${name}`, {
      method: "POST",
      headers: { "content-type": "application/json", "x-catoptra-key": key },
      body: JSON.stringify(body ?? {}),
      signal,
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Error("the program does not answer: it has ended, or is not reached");
  }
  if (!reply.ok) {
    const told = await reply.json().catch(() => ({}));
    const error = new Error(told.error ?? `the program answers ${reply.status}`);
    error.status = reply.status;
    throw error;
  }
  return reply;
}

/** JSON that the program answers; null when it has nothing. */
export async function ask(name, body, signal) {
  const reply = await post(name, body, signal);
  return reply.status === 204 ? null : reply.json();
}

/** A picture that the program answers. */
export async function askPicture(name, body, signal) {
  const reply = await post(name, body, signal);
  return createImageBitmap(await reply.blob());
}

/** A picture from base64. */
export function bitmap(base64) {
  const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
  return createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
}

/** An element; text is always text. */
export function el(tag, props = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "class") element.className = value;
    else if (name in element && !name.startsWith("aria")) element[name] = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

export const button = (text, does, props = {}) => el("button", { type: "button", onclick: does, ...props }, text);

/** A button that opens another file of these kinds. */
export const opener = (title, kinds, open) =>
  button("Open …", () => choose(title, kinds, (path) => open(path).catch(complain)));

/** Which file is open, and buttons to open another. */
export const fileRow = (what, name, ...buttons) => el("div", { class: "row" }, el("b", {}, what), name, buttons);

/** Puts these into an element, in place of what was there. */
export function fill(element, ...children) {
  element.replaceChildren(
    ...children.flat(2).filter((child) => child !== null && child !== undefined && child !== false),
  );
}

/** What the page is doing, at its foot. */
export function say(text, bad = false) {
  const foot = document.getElementById("said");
  foot.textContent = text;
  foot.classList.toggle("bad", bad);
}

export function complain(error) {
  if (error.name !== "AbortError") say(error.message, true);
}

/** Shows what a command that saves came to; `more` goes between its warnings and its text. */
export function showSaved(place, done, ...more) {
  const { code, error, warnings, text } = done.told;
  const good = code === 0;
  const words = good ? `Saved: ${done.out}` : error;
  const listed = warnings.map((warning) => el("li", {}, warning));
  fill(
    place,
    el("p", { class: good ? "good" : "bad" }, words),
    listed.length ? el("ul", {}, listed) : null,
    ...more,
    text ? el("pre", {}, text.trim()) : null,
  );
  say(words, !good);
}

/** A number with so many digits behind the point; what rounds to zero has no sign. */
export function fixed(value, digits) {
  const size = Math.abs(value).toFixed(digits);
  return value < 0 && Number(size) !== 0 ? `−${size}` : size;
}

/** Colours of markers: over pictures, and the names of those on the page. */
const OVER_PICTURES = ["#f0b928", "#00c896", "#56b4e9", "#e696c3", "#f0e442", "#c8c8ff"];
export const overPicture = (m) => OVER_PICTURES[m % OVER_PICTURES.length];
export const onPage = (m) => `--m${(m % 6) + 1}`;

/** A colour of the page as it is now: light or dark. */
export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export function swatch(name) {
  const mark = el("span", { class: "swatch", "aria-hidden": "true" });
  mark.style.background = `var(${name})`;
  return mark;
}

/** Calls this when the page becomes light or dark. */
export function onOtherColours(call) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", call);
}

export const isTyping = (event) => event.target.closest("input:not([type=range]), textarea, select, dialog") !== null;

/** Runs one after the other; of those that wait only the last is kept. */
export function latest(work) {
  let running = false;
  let waiting = null;
  return async function next(...values) {
    if (running) {
      waiting = values;
      return;
    }
    running = true;
    try {
      await work(...values);
    } catch (error) {
      complain(error);
    }
    running = false;
    if (waiting) {
      const again = waiting;
      waiting = null;
      next(...again);
    }
  };
}

/** A canvas as sharp as the screen: gives its context and size in CSS pixels. */
export function sharp(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  const [w, h] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

/** Draws when something has changed, once a frame at most. */
export function redrawer(draw, ...elements) {
  let asked = false;
  const redraw = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      draw();
    });
  };
  const observer = new ResizeObserver(redraw);
  elements.forEach((element) => observer.observe(element));
  onOtherColours(redraw);
  return redraw;
}

/** Lets a person choose a file of these kinds below the starting folder. */
function choose(title, kinds, chosen) {
  const dialog = document.getElementById("dialog");
  const show = async (folder) => {
    let listed;
    try {
      listed = await ask("list", { folder });
    } catch (error) {
      complain(error);
      return;
    }
    const enter = (entry) => {
      if (entry.kind === "folder" || !kinds.includes(entry.kind)) return show(entry.path);
      dialog.close();
      return chosen(entry.path);
    };
    const wanted = listed.entries.filter((entry) => entry.kind === "folder" || kinds.includes(entry.kind));
    const up = listed.folder === "." ? null : button("↑ the folder above", () => show(`${listed.folder}/..`));
    fill(
      dialog,
      el("h2", {}, `${title} in ${listed.folder}`),
      el(
        "div",
        { class: "entries" },
        up,
        wanted.map((entry) => button(entry.kind === "folder" ? `${entry.name}/` : entry.name, () => enter(entry))),
      ),
      wanted.length ? null : el("p", { class: "quiet" }, "Nothing of that kind is here."),
      button("Cancel", () => dialog.close()),
    );
    if (!dialog.open) dialog.showModal();
  };
  show(".");
}
