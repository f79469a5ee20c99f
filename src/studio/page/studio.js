// The page: which views there are, and the keys that hold in all of them.

import { ask, button, complain, el, fill, isTyping, say } from "./common.js";
import { Teach } from "./teach.js";
import { Calibrate } from "./calibrate.js";
import { Review } from "./review.js";
import { Watch } from "./watch.js";

const main = document.getElementById("main");
const tabs = document.getElementById("tabs");
let shown = null;

function show(view, own) {
  shown?.leave?.();
  for (const tab of tabs.children) tab.setAttribute("aria-selected", String(tab === own));
  shown = view;
  main.replaceChildren(view.element);
  // What was said belongs to the view that was left.
  say("");
  view.enter?.();
}

const KEYS = [
  ["space", "play and stop"],
  ["← →", "one frame back, on; with Ctrl ten"],
  ["Home End", "first, last frame"],
  ["1 to 9", "choose a band"],
  ["Shift + arrows", "move the cross over the picture; with Ctrl in larger steps"],
  ["Enter", "pick where the cross is"],
  ["Delete", "take back the picks of the band"],
  ["m", "masks on and off"],
  ["+ − 0", "larger, smaller, whole: picture, plot, scene"],
  ["v", "veto the frame, or take the veto back: type the reason, then Enter; Escape goes back (Review)"],
  ["t", "take a picture (Calibrate, with a camera)"],
  ["r", "begin and end recording (Watch)"],
];

function help() {
  const dialog = document.getElementById("dialog");
  fill(
    dialog,
    el("h2", {}, "Keys"),
    el(
      "table",
      {},
      KEYS.map(([key, does]) => el("tr", {}, el("td", {}, el("kbd", {}, key)), el("td", {}, does))),
    ),
    el("p", {}, button("Close", () => dialog.close())),
  );
  dialog.showModal();
}

document.getElementById("keys").addEventListener("click", help);
document.addEventListener("keydown", (event) => {
  if (event.defaultPrevented || isTyping(event) || event.altKey || event.metaKey) return;
  if (event.key === "?") help();
  else if (!shown?.key?.(event)) return;
  event.preventDefault();
});

try {
  const state = await ask("state");
  const views = state.live
    ? [["Watch", new Watch(state)]]
    : [
        ["Calibrate", new Calibrate(state)],
        ["Teach", new Teach(state)],
        ["Review", new Review(state)],
      ];
  const buttons = views.map(([name, view]) => {
    const tab = button(name, () => show(view, tab), { role: "tab", "aria-selected": "false" });
    return tab;
  });
  fill(tabs, ...buttons);
  // A rig without a recording is one that is being made.
  const calibrates = state.live || state.camera || (state.rig && !state.recording && !state.run);
  const first = calibrates ? 0 : state.run ? 2 : 1;
  show(views[first][1], buttons[first]);
  document.body.dataset.ready = "yes";
} catch (error) {
  main.replaceChildren(el("p", { class: "wait bad" }, error.message));
  complain(error);
}
if (!sessionStorage.getItem("catoptra-key"))
  say("This page has no key: open the whole address that the program printed.", true);
