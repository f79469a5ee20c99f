// Bands taught by clicks.

import {
  ask,
  askPicture,
  button,
  complain,
  el,
  fileRow,
  fill,
  latest,
  onPage,
  opener,
  overPicture,
  say,
  showSaved,
  swatch,
} from "./common.js";
import { Stage, label, outline } from "./stage.js";

const USUAL = [
  ["base", 6],
  ["coil", 12],
  ["tip", 6],
];
const percent = (share) => `${(share * 100).toFixed(1)} %`;
// A class of other colours: where it is, and its mean.
const other = (name) => name.replace(/, (\d+ \d+ \d+)$/, " (R G B $1)");
const middle = (corners) => corners && [0, 1].map((k) => corners.reduce((sum, c) => sum + c[k], 0) / corners.length);
// A close-up on the screen, and what it shows, pixels.
const CLOSE = 96;
const CLOSE_PX = 44;
const number = (input) => (input.value === "" ? null : Number(input.value));
const tenth = (v) => Math.round(v * 10) / 10;

export class Teach {
  constructor(state) {
    Object.assign(this, {
      recording: state.recording,
      rig: state.rig,
      size: [4, 3],
      times: [],
      done: false,
      frame: 0,
      playing: false,
      views: [],
      regions: new Map(),
      bands: USUAL.map(([name, length_mm]) => ({ name, length_mm })),
      now: 0,
      picks: [],
      looks: new Map(),
      whole: null,
      masks: true,
      showRegions: true,
      view: "",
      asked: 0,
      chosen: {},
      states: [],
    });
    this.stage = new Stage(
      "The picture. Click on a band, or move the cross with Shift and the arrows and press Enter.",
      {
        paint: (context, px) => this.paint(context, px),
        click: (at) => this.pick(at).catch(complain),
        grab: (at, reach) => this.grab(at, reach),
      },
    );
    this.build();
    this.load = latest((i) => this.showFrame(i));
    this.preview = latest(() => this.lookEverywhere());
    this.command = latest(() => this.showCommand());
    this.begun = false;
  }

  enter() {
    this.stage.redraw();
    if (this.begun) return;
    this.begun = true;
    if (this.rig) this.openRig(this.rig).catch(complain);
    if (this.recording) this.openRecording(this.recording).catch(complain);
    if (!this.recording || !this.rig) say("Choose a recording and a rig file that has its views.");
  }

  leave() {
    if (this.playing) this.play();
  }

  build() {
    this.names = {
      recording: el("span", { class: "mono grow" }, this.recording ?? "none"),
      rig: el("span", { class: "mono grow" }, this.rig ?? "none"),
    };
    this.slider = el("input", {
      type: "range",
      min: 0,
      max: 0,
      value: 0,
      "aria-label": "Frame",
      oninput: () => this.go(Number(this.slider.value)),
    });
    this.at = el("span", { class: "mono", id: "at" }, "");
    const jump = (by, text, name) =>
      button(text, () => this.go(this.frame + by), { "aria-label": name });
    this.playButton = button("Play", () => this.play(), { "aria-pressed": "false" });
    this.viewChoice = el("select", { id: "view", onchange: () => (this.view = this.viewChoice.value) });
    this.maskBox = el("input", {
      type: "checkbox",
      checked: true,
      onchange: () => {
        this.masks = this.maskBox.checked;
        this.closer();
        this.stage.redraw();
      },
    });
    this.regionBox = el("input", {
      type: "checkbox",
      checked: true,
      onchange: () => {
        this.showRegions = this.regionBox.checked;
        this.stage.redraw();
      },
    });
    this.tube = el("input", {
      class: "short",
      id: "tube",
      type: "number",
      min: 0.1,
      step: 0.1,
      value: 3.2,
      oninput: () => this.changed(),
    });
    // As the rig has it, unless something else is said.
    const optional = (id) =>
      el("input", {
        class: "short",
        id,
        type: "number",
        min: 0.1,
        step: 0.1,
        placeholder: "–",
        oninput: () => this.changed(),
      });
    [this.rigid, this.exposure] = [optional("rigid"), optional("exposure")];
    this.coil = el("select", {
      id: "coil",
      onchange: () => {
        this.chosen.coil = this.coil.value;
        this.changed();
      },
    });
    this.end = el("select", {
      id: "end",
      onchange: () => {
        this.chosen.end = this.end.value;
        this.changed();
      },
    });
    this.bandList = el("div", { id: "bands" });
    this.near = el("div", { class: "closer" });
    this.told = el("div", { id: "told" });
    this.regionList = el("div", {});
    this.out = el("input", {
      class: "grow",
      id: "out",
      value: this.rig ?? "",
      spellcheck: false,
      oninput: () => this.command(),
    });
    this.saveButton = button("Learn and save", () => this.save(), { class: "main", id: "save" });
    this.shown = el("pre", { id: "command" }, "");
    this.result = el("div", { id: "result", "aria-live": "polite" });
    const left = el(
      "div",
      { class: "left" },
      this.stage.element,
      el(
        "div",
        {},
        this.near,
        el(
          "div",
          { class: "row" },
          jump(-10, "−10", "ten frames back"),
          jump(-1, "‹", "one frame back"),
          this.playButton,
          jump(1, "›", "one frame on"),
          jump(10, "+10", "ten frames on"),
          this.slider,
          this.at,
        ),
        el(
          "div",
          { class: "row" },
          el("label", { for: "view" }, "Clicks are in view", this.viewChoice),
          el("label", {}, this.maskBox, "masks"),
          el("label", {}, this.regionBox, "regions (drag corners)"),
          button("zoom in", () =>
            this.stage.zoomAt(this.stage.cross ?? this.stage.middle ?? this.size.map((v) => v / 2), 1.6),
          ),
          button("whole picture", () => this.stage.reset()),
        ),
      ),
    );
    const side = el(
      "div",
      { class: "side" },
      el(
        "section",
        {},
        fileRow(
          "Recording",
          this.names.recording,
          opener("Recordings", ["recording"], (path) => this.openRecording(path)),
        ),
        fileRow("Rig", this.names.rig, opener("Rig files", ["rig"], (path) => this.openRig(path))),
      ),
      el(
        "section",
        {},
        el("h2", {}, "Bands, from the clamp to the tip"),
        this.bandList,
        el(
          "div",
          { class: "row" },
          button("Add a band", () => this.addBand()),
          button("Clear all picks", () => this.clear()),
        ),
        el(
          "div",
          { class: "row" },
          el("label", { for: "tube" }, "Tube", this.tube, "mm"),
          el("label", { for: "coil" }, "Coil", this.coil),
          el("label", { for: "end" }, "Ends the tube", this.end),
        ),
        el(
          "div",
          { class: "row" },
          el(
            "label",
            {
              for: "rigid",
              title:
                "length of the stiff part around the middle of the coil, if longer than its band; " +
                  "empty: as the rig has it",
            },
            "Stiff length at the coil",
            this.rigid,
            "mm",
          ),
          el(
            "label",
            { for: "exposure", title: "empty: learned from the recording, where motion blur shows" },
            "Exposure time",
            this.exposure,
            "ms",
          ),
        ),
      ),
      el("section", {}, el("h2", {}, "What is seen"), this.told),
      el("section", {}, el("details", {}, el("summary", {}, "Regions of the views"), this.regionList)),
      el(
        "section",
        {},
        el("h2", {}, "Learn from the whole recording"),
        el("div", { class: "row" }, el("label", { class: "grow", for: "out" }, "into", this.out), this.saveButton),
        this.shown,
        this.result,
      ),
    );
    this.element = el("div", { class: "view" }, left, side);
    this.listBands();
    this.tell();
  }

  async openRecording(path) {
    [this.recording, this.times, this.done, this.frame] = [path, [], false, 0];
    this.names.recording.textContent = path;
    this.asked += 1;
    this.clear();
    // The first picture is shown before the times of all others are known.
    this.go(0);
    await this.index(this.asked);
  }

  /** The times of the frames, as far as they are known. */
  async index(of) {
    if (of !== this.asked) return;
    const reel = await ask("reel", { recording: this.recording, known: this.times.length });
    if (of !== this.asked) return;
    this.times.push(...reel.times_us);
    [this.size, this.done] = [reel.size, reel.done];
    this.slider.max = this.times.length - 1;
    this.showTime();
    if (reel.error) say(reel.error, true);
    if (!reel.done) setTimeout(() => this.index(of).catch(complain), 150);
  }

  async openRig(path) {
    const rig = await ask("teach/rig", { rig: path });
    this.rig = path;
    this.names.rig.textContent = path;
    this.out.value = path;
    this.views = rig.views;
    this.regions = new Map();
    if (rig.bands.length) this.bands = rig.bands.map(({ name, length_mm }) => ({ name, length_mm }));
    if (rig.tube_mm) this.tube.value = rig.tube_mm;
    [this.rigCoil, this.rigEnd, this.chosen] = [rig.coil, rig.end, {}];
    [this.rigRigid, this.rigid.value, this.exposure.value] = [rig.rigid_mm, rig.rigid_mm ?? "", ""];
    fill(
      this.viewChoice,
      el("option", { value: "" }, "automatic"),
      ...this.views.map((v) => el("option", { value: v.name }, v.name)),
    );
    this.view = "";
    this.clear();
    this.listBands();
    this.listRegions();
    if (this.views.length)
      say(`${path}: views ${this.views.map((v) => v.name).join(", ")}. Click on band ${this.bands[0]?.name}.`);
    else say(`${path} has no views yet: calibrate them from pictures of a board`, true);
  }

  go(i) {
    const last = Math.max(0, this.times.length - 1);
    this.frame = Math.min(last, Math.max(0, i));
    this.slider.value = this.frame;
    this.showTime();
    this.load(this.frame);
  }

  showTime() {
    const t = (this.times[this.frame] ?? 0) / 1e6;
    this.at.textContent = `frame ${this.frame} of ${this.times.length}${this.done ? "" : " …"}  ${t.toFixed(3)} s`;
  }

  async showFrame(i) {
    if (!this.recording) return;
    const picture = await askPicture("frame", { recording: this.recording, frame: i, width: null });
    this.size = [picture.width, picture.height];
    this.stage.show(picture, this.size);
    this.element.dataset.frame = i;
    clearTimeout(this.rest);
    if (this.playing) {
      if (i + 1 < this.times.length) setTimeout(() => this.playing && this.go(i + 1), 15);
      else this.play();
    } else {
      // The first click on a frame is to be as quick as the next ones.
      this.rest = setTimeout(() => ask("teach/prepare", { recording: this.recording, frame: i }).catch(complain), 120);
    }
  }

  play() {
    this.playing = !this.playing;
    this.playButton.setAttribute("aria-pressed", String(this.playing));
    this.playButton.textContent = this.playing ? "Stop" : "Play";
    if (this.playing) this.go(this.frame + 1 < this.times.length ? this.frame + 1 : 0);
  }

  key(event) {
    const by = event.ctrlKey ? 10 : 1;
    if (event.shiftKey && event.key.startsWith("Arrow")) return (this.stage.key(event), true);
    if (event.target.closest("button, input") && [" ", "Enter"].includes(event.key)) return false;
    if (event.key === " ") this.play();
    else if (event.target.type === "range" && event.key.startsWith("Arrow")) return false;
    else if (event.key === "ArrowLeft") this.go(this.frame - by);
    else if (event.key === "ArrowRight") this.go(this.frame + by);
    else if (event.key === "Home") this.go(0);
    else if (event.key === "End") this.go(this.times.length - 1);
    else if (/^[1-9]$/.test(event.key) && !event.ctrlKey) this.select(Number(event.key) - 1);
    else if (event.key === "m") this.maskBox.click();
    else if (event.key === "Delete" || event.key === "Backspace") this.unpick(this.now);
    else if (["Enter", "+", "=", "-", "0"].includes(event.key)) this.stage.key(event);
    else return false;
    return true;
  }

  select(i) {
    if (i >= this.bands.length) return;
    this.now = i;
    this.listBands();
    say(`Click on band ${this.bands[i].name}.`);
  }

  form(frame = this.frame) {
    const picked = this.picks.length ? this.picks[0].frame : frame;
    const usual = this.usual();
    return {
      recording: this.recording,
      rig: this.rig,
      frame: picked,
      tube_mm: Number(this.tube.value),
      bands: this.bands.map(({ name, length_mm }) => ({ name, length_mm: Number(length_mm) })),
      coil: this.coil.value === usual.coil ? null : this.coil.value,
      end: this.end.value === usual.end ? null : this.end.value,
      rigid_mm: number(this.rigid) === (this.rigRigid ?? null) ? null : number(this.rigid),
      exposure_ms: number(this.exposure),
      regions: [...this.regions].map(([view, corners]) => ({ view, corners: corners.map((c) => c.map(tenth)) })),
      picks: this.picks.map(({ band, view, x, y }) => ({ band, view, x, y })),
    };
  }

  async pick(at) {
    const [x, y] = at.map(tenth);
    if (!this.recording || !this.rig) return say("A recording and a rig file are needed first.", true);
    const band = this.bands[this.now]?.name;
    if (!band) return say("Add a band first.", true);
    if (x < 0 || y < 0 || x > this.size[0] - 1 || y > this.size[1] - 1) return say("That is outside of the picture.");
    // The frame that is shown: another one may be on its way, and the answer too.
    const frame = Number(this.element.dataset.frame ?? this.frame);
    if (this.picks.some((pick) => pick.frame !== frame)) {
      this.clear();
      say("All picks must be in one frame; those in the other frame were discarded.");
    }
    const began = performance.now();
    const look = await ask("teach/click", { form: this.form(frame), band, view: this.view || null, x, y });
    if (this.picks.some((pick) => pick.frame !== frame)) return undefined;
    this.took = performance.now() - began;
    this.element.dataset.took = this.took.toFixed(1);
    this.picks = this.picks.filter((pick) => pick.band !== band || pick.view !== look.view);
    this.picks.push({ band, view: look.view, x, y, frame });
    this.looks.set(`${band}@${look.view}`, look);
    this.whole = null;
    if (look.error) say(look.error, true);
    else say(`${band} in view ${look.view}: found in ${this.took.toFixed(0)} ms`);
    const next = this.bands.findIndex((b) => !this.picks.some((pick) => pick.band === b.name));
    if (!look.error && next >= 0) this.now = next;
    this.refresh();
    if (next < 0) this.preview();
  }

  async lookEverywhere() {
    say("Looking in all views …");
    const form = this.form();
    const whole = await ask("teach/preview", form);
    // Picks may have changed meanwhile, or are being learned.
    if (this.saveButton.disabled || JSON.stringify(form) !== JSON.stringify(this.form())) return;
    this.whole = whole;
    this.element.dataset.preview = String((Number(this.element.dataset.preview) || 0) + 1);
    if (whole.error) say(whole.error, true);
    else say("All bands are measured in this frame. Learn and save reads the whole recording.");
    this.refresh();
  }

  unpick(i) {
    const name = this.bands[i]?.name;
    this.picks = this.picks.filter((pick) => pick.band !== name);
    for (const at of [...this.looks.keys()]) if (at.startsWith(`${name}@`)) this.looks.delete(at);
    this.whole = null;
    this.now = i;
    this.refresh();
  }

  clear() {
    [this.picks, this.whole, this.now] = [[], null, 0];
    this.looks = new Map();
    this.refresh();
  }

  /** Something of the form is another: what was seen with the old one is not true any more. */
  changed() {
    this.whole = null;
    this.looks = new Map();
    const all = this.bands.every((band) => this.picks.some((pick) => pick.band === band.name));
    if (all && this.picks.length) this.preview();
    this.refresh(false);
  }

  refresh(list = true) {
    if (!this.bandList) return;
    if (list) this.listBands();
    else this.states.forEach((state) => state());
    this.tell();
    this.closer();
    this.stage.redraw();
    this.command?.();
  }

  /** Every band that was found, in every view, six times as large. */
  closer() {
    const places = [];
    if (this.whole) {
      for (const view of this.whole.views)
        view.bands.forEach((band, m) => {
          const at = band.seen?.centre ?? middle(band.located);
          if (at) places.push([`${band.name}, ${view.name}`, m, at, band.mask, band.seen?.outline ?? band.located]);
        });
    } else {
      for (const [at, look] of this.looks) {
        const m = this.bands.findIndex((band) => band.name === at.split("@")[0]);
        if (look.rectangle)
          places.push([`${at.split("@")[0]}, ${look.view}`, m, middle(look.rectangle), look.mask, look.rectangle]);
      }
    }
    fill(
      this.near,
      places.map(([name, m, at, mask, line]) => {
        const canvas = el("canvas", {
          width: CLOSE * 2,
          height: CLOSE * 2,
          role: "img",
          "aria-label": `close-up of ${name}`,
        });
        const draw = () => {
          const context = canvas.getContext("2d");
          const scale = (CLOSE * 2) / CLOSE_PX;
          context.setTransform(scale, 0, 0, scale, CLOSE - (at[0] + 0.5) * scale, CLOSE - (at[1] + 0.5) * scale);
          context.imageSmoothingEnabled = false;
          if (this.stage.picture) context.drawImage(this.stage.picture, 0, 0, this.size[0], this.size[1]);
          context.translate(0.5, 0.5);
          if (this.masks && mask) {
            context.globalAlpha = 0.5;
            context.fillStyle = overPicture(m);
            for (const [y, from, to] of mask) context.fillRect(from - 0.5, y - 0.5, to - from, 1);
            context.globalAlpha = 1;
          }
          outline(context, line, "#fff", 1.6 / scale);
        };
        draw();
        return el("figure", {}, canvas, el("figcaption", {}, swatch(onPage(m)), name));
      }),
    );
  }

  addBand() {
    this.bands.push({ name: `band${this.bands.length + 1}`, length_mm: 6 });
    this.now = this.bands.length - 1;
    this.whole = null;
    this.refresh();
  }

  move(i, by) {
    const j = i + by;
    if (j < 0 || j >= this.bands.length) return;
    [this.bands[i], this.bands[j]] = [this.bands[j], this.bands[i]];
    this.now = j;
    this.changed();
    this.listBands();
  }

  remove(i) {
    this.unpick(i);
    this.bands.splice(i, 1);
    this.now = 0;
    this.refresh();
  }

  rename(i, name) {
    const old = this.bands[i].name;
    if (this.bands.some((band, k) => k !== i && band.name === name)) {
      say(`There is a band ${name} already: choose another name.`, true);
      return this.listBands();
    }
    const roles = ["coil", "end"].filter((role) => this[role].value === old);
    this.bands[i].name = name;
    // What it was chosen for, it still is; what it is by its place needs no choice.
    for (const role of roles)
      if (this.chosen[role] === old || this.usual()[role] !== name) this.chosen[role] = name;
    this.picks.forEach((pick) => pick.band === old && (pick.band = name));
    this.looks = new Map(
      [...this.looks].map(([at, look]) => [at.startsWith(`${old}@`) ? name + at.slice(old.length) : at, look]),
    );
    this.roles();
    this.changed();
  }

  /** What the command takes where nothing is said. */
  usual() {
    const names = this.bands.map((band) => band.name);
    return {
      coil: this.rigCoil ?? (names.includes("coil") ? "coil" : (names[1] ?? names[0])),
      end: this.rigEnd ?? names.at(-1),
    };
  }

  roles() {
    const usual = this.usual();
    const offer = (choice, role, more) => {
      fill(choice, ...this.bands.map((b) => el("option", { value: b.name }, b.name)), ...more);
      const names = [...choice.options].map((option) => option.value);
      choice.value = [this.chosen[role], usual[role], names[0]].find((name) => names.includes(name)) ?? "";
    };
    offer(this.coil, "coil", []);
    offer(this.end, "end", [el("option", { value: "none" }, "no band")]);
  }

  state(band) {
    const own = this.picks.filter((pick) => pick.band === band.name);
    if (!own.length) return ["not picked yet", false];
    const bad = own.map((pick) => this.looks.get(`${band.name}@${pick.view}`)).find((look) => look?.error);
    if (bad) return [bad.error, true];
    const seen = this.whole?.views.map((view) => [view.name, view.bands.find((b) => b.name === band.name)]);
    if (!seen) return [own.map((pick) => `picked at ${pick.x},${pick.y} in ${pick.view}`).join("; "), false];
    const parts = seen.map(([name, b]) =>
      b.seen ? `${name} σ ${b.seen.sd_px.toFixed(2)} px` : `${name}: ${b.miss ?? "not found"}`,
    );
    const at = this.whole.positions?.[this.bands.indexOf(band)];
    if (at?.sd_mm) parts.push(`in space σ ${at.sd_mm.toFixed(3)} mm`);
    return [parts.join("; "), seen.some(([, b]) => !b.seen)];
  }

  listBands() {
    this.states = [];
    fill(
      this.bandList,
      ...this.bands.map((band, i) => {
        const what = el("div");
        // Told anew by itself: who types in the list keeps the place.
        const state = () => {
          const [words, bad] = this.state(band);
          what.className = bad ? "what bad" : "what";
          fill(what, swatch(onPage(i)), words);
        };
        state();
        this.states.push(state);
        const tool = (text, name, does) =>
          button(text, does, { "aria-label": `${name} ${band.name}`, title: name });
        return el(
          "div",
          { class: i === this.now ? "band now" : "band" },
          button(String(i + 1), () => this.select(i), {
            class: "number",
            "aria-pressed": String(i === this.now),
            "aria-label": `pick ${band.name}`,
          }),
          el("input", {
            value: band.name,
            "aria-label": `name of band ${i + 1}`,
            spellcheck: false,
            onchange: (e) => this.rename(i, e.target.value),
          }),
          el(
            "label",
            {},
            el("input", {
              type: "number",
              min: 0.1,
              step: 0.5,
              value: band.length_mm,
              "aria-label": `length of ${band.name} in mm`,
              onchange: (e) => {
                band.length_mm = e.target.value;
                this.changed();
              },
            }),
            "mm",
          ),
          el(
            "span",
            { class: "tools" },
            tool("↑", "up", () => this.move(i, -1)),
            tool("↓", "down", () => this.move(i, 1)),
            tool("×", "remove", () => this.remove(i)),
          ),
          what,
        );
      }),
    );
    this.roles();
  }

  /** What the clicks show, in words. */
  tell() {
    const rows = [];
    const row = (name, view, exposure, worst) =>
      rows.push(
        el(
          "tr",
          {},
          el("td", {}, name),
          el("td", {}, view),
          el(
            "td",
            { class: exposure?.advice ? "bad" : "" },
            exposure ? (exposure.advice ?? `fine, brightest ${exposure.level.toFixed(0)} of 255`) : "–",
          ),
          el(
            "td",
            { class: worst?.verdict === "TOO ALIKE" ? "bad" : "" },
            worst
              ? `${worst.verdict}: ${percent(worst.hits)} found, ` +
                `${percent(worst.mistaken)} of ${other(worst.other)} taken for it`
              : "–",
          ),
        ),
      );
    if (this.whole) {
      for (const view of this.whole.views)
        for (const band of view.bands) row(band.name, view.name, band.exposure, band.separations?.[0]);
    } else {
      for (const [at, look] of this.looks)
        if (!look.error) row(at.split("@")[0], look.view, look.exposure, look.separations[0]);
    }
    const parts = [];
    if (!rows.length)
      parts.push(
        el(
          "p",
          { class: "quiet" },
          "Choose a band, click on it in any view. What is taken for it shows at once; " +
            "when all are picked, they are measured in all views.",
        ),
      );
    const look = [...this.looks.values()].at(-1);
    if (!this.whole && look?.blob) {
      const { blob } = look;
      parts.push(
        el(
          "p",
          {},
          `Patch of its colour: ${blob.length_px.toFixed(1)} × ${blob.width_px.toFixed(1)} px, ` +
            `centre ${blob.centre[0].toFixed(2)}, ${blob.centre[1].toFixed(2)}, σ ${blob.sd_px.toFixed(2)} px. ` +
            `Contrast ${look.contrast.toFixed(1)}.`,
        ),
      );
    }
    if (rows.length)
      parts.push(
        el(
          "table",
          {},
          el(
            "tr",
            {},
            ["Band", "View", "Brightness", "Colour (threshold 0.5)"].map((t) => el("th", {}, t)),
          ),
          rows,
        ),
      );
    const others = this.whole?.blobs.filter((blob) => blob.rejected) ?? [];
    if (others.length) {
      parts.push(
        el("h2", {}, "Not the bands"),
        el(
          "ul",
          {},
          others
            .slice(0, 12)
            .map((blob) =>
              el(
                "li",
                {},
                `colour of ${blob.band} in ${blob.view} at ${blob.bounds[0]},${blob.bounds[1]}: ${blob.rejected}`,
              ),
            ),
        ),
      );
      if (others.length > 12) parts.push(el("p", { class: "quiet" }, `and ${others.length - 12} more`));
    }
    for (const region of this.whole?.regions ?? []) {
      const [[x0, y0], [x1, y1]] = region.corners;
      const corners = [
        [x0, y0],
        [x1, y0],
        [x1, y1],
        [x0, y1],
      ];
      parts.push(
        el(
          "p",
          {},
          `A smaller region of ${region.view}, which must still hold the whole motion, ` +
            `leaves out ${region.leaves_out} of them. `,
          button("Take it", () => this.setRegion(region.view, corners)),
        ),
      );
    }
    fill(this.told, ...parts);
  }

  region(view) {
    return this.regions.get(view.name) ?? view.region;
  }

  setRegion(name, corners) {
    const inside = ([x, y]) => [Math.min(this.size[0] - 1, Math.max(0, x)), Math.min(this.size[1] - 1, Math.max(0, y))];
    this.regions.set(name, corners.map(inside));
    this.listRegions();
    this.changed();
  }

  /** A corner of a region that can be dragged. */
  grab([x, y], reach) {
    if (!this.showRegions) return null;
    for (const view of this.views) {
      const corners = this.region(view);
      const i = corners.findIndex(([cx, cy]) => Math.hypot(cx - x, cy - y) < reach);
      if (i < 0) continue;
      return ([nx, ny]) => {
        const moved = corners.map((c) => [...c]);
        moved[i] = [nx, ny];
        this.setRegion(view.name, moved);
      };
    }
    return null;
  }

  listRegions() {
    fill(
      this.regionList,
      ...this.views.map((view) => {
        const corners = this.region(view);
        const text = corners.map((c) => c.map(tenth).join(",")).join(" ");
        const input = el("input", {
          class: "mono grow",
          value: text,
          spellcheck: false,
          "aria-label": `corners of ${view.name}`,
          placeholder: "x,y x,y x,y …",
          onchange: () => {
            const read = input.value
              .trim()
              .split(/\s+/)
              .map((c) => c.split(",").map(Number));
            if (read.length < 3 || read.some((c) => c.length !== 2 || c.some(Number.isNaN)))
              return say("A region is three corners or more: x,y x,y x,y", true);
            this.setRegion(view.name, read);
          },
        });
        const [w, h] = this.size;
        const draw = () =>
          this.setRegion(view.name, [
            [0, 0],
            [w - 1, 0],
            [w - 1, h - 1],
            [0, h - 1],
          ]);
        return el(
          "div",
          { class: "row" },
          el("b", {}, view.name),
          input,
          corners.length ? null : button("Draw", draw),
          this.regions.has(view.name)
            ? button("As it was", () => {
                this.regions.delete(view.name);
                this.listRegions();
                this.changed();
              })
            : null,
        );
      }),
    );
  }

  paint(context, px) {
    const of = (name) => this.bands.findIndex((band) => band.name === name);
    const here = this.picks.length ? this.picks[0].frame === this.frame : true;
    if (this.showRegions) {
      for (const view of this.views) {
        const corners = this.region(view);
        if (!corners.length) continue;
        outline(context, corners, "rgba(0,0,0,.6)", 3 * px);
        outline(context, corners, "#fff", 1.4 * px, [8 * px, 6 * px]);
        context.fillStyle = "#fff";
        for (const [x, y] of corners) context.fillRect(x - 4 * px, y - 4 * px, 8 * px, 8 * px);
        const [x, y] = corners.reduce((a, b) => (a[0] + a[1] < b[0] + b[1] ? a : b));
        label(context, view.name, [x + 10 * px, y + 20 * px], "#fff", px);
      }
    }
    if (!here) return;
    const mask = (runs, m) => {
      if (!this.masks || !runs) return;
      context.fillStyle = overPicture(m);
      context.globalAlpha = 0.45;
      for (const [y, from, to] of runs) context.fillRect(from - 0.5, y - 0.5, to - from, 1);
      context.globalAlpha = 1;
    };
    if (this.whole) {
      for (const view of this.whole.views) {
        view.bands.forEach((band, m) => {
          mask(band.mask, m);
          if (band.located && !band.seen) outline(context, band.located, overPicture(m), 1.5 * px, [3 * px, 3 * px]);
          if (!band.seen) return;
          outline(context, band.seen.outline, overPicture(m), 2 * px);
          const [cx, cy] = band.seen.centre;
          label(
            context,
            `${band.name} σ ${band.seen.sd_px.toFixed(2)}`,
            [cx + 22 * px, cy + 5 * px],
            overPicture(m),
            px,
          );
        });
      }
      for (const blob of this.whole.blobs.filter((b) => b.rejected)) {
        const [x0, y0, x1, y1] = blob.bounds;
        outline(
          context,
          [
            [x0 - 1, y0 - 1],
            [x1, y0 - 1],
            [x1, y1],
            [x0 - 1, y1],
          ],
          overPicture(Math.max(0, of(blob.band))),
          1.2 * px,
          [4 * px, 3 * px],
        );
      }
    } else {
      for (const [at, look] of this.looks) {
        const name = at.split("@")[0];
        const m = Math.max(0, of(name));
        mask(look.mask, m);
        outline(context, look.rectangle, overPicture(m), 2 * px);
        if (look.rectangle) {
          const x = Math.max(...look.rectangle.map((c) => c[0]));
          const y = look.rectangle.reduce((sum, c) => sum + c[1], 0) / 4;
          label(context, name, [x + 10 * px, y + 5 * px], overPicture(m), px);
        }
      }
    }
    for (const { band, x, y } of this.picks) {
      context.strokeStyle = overPicture(Math.max(0, of(band)));
      context.lineWidth = 1.5 * px;
      context.beginPath();
      context.moveTo(x - 6 * px, y);
      context.lineTo(x + 6 * px, y);
      context.moveTo(x, y - 6 * px);
      context.lineTo(x, y + 6 * px);
      context.stroke();
    }
  }

  async showCommand() {
    if (!this.recording || !this.rig || !this.out.value || !this.picks.length) {
      this.shown.textContent = "The equivalent command appears here once a band is picked.";
      return;
    }
    try {
      this.shown.textContent = (await ask("teach/save", { form: this.form(), out: this.out.value, dry: true })).command;
    } catch (error) {
      this.shown.textContent = error.message;
    }
  }

  async save() {
    this.saveButton.disabled = true;
    const began = performance.now();
    const passed_s = () => ((performance.now() - began) / 1000).toFixed(0);
    const busy = () => say(`Learning from the whole recording … ${passed_s()} s`);
    busy();
    const clock = setInterval(busy, 1000);
    fill(this.result, el("p", { class: "quiet" }, "Learning from the whole recording …"));
    try {
      const done = await ask("teach/save", { form: this.form(), out: this.out.value, dry: false });
      clearInterval(clock);
      const next =
        `Next: catoptra track ${this.recording} --rig ${done.out} ` +
        `(with --frame camera where the rig has no base frame)`;
      showSaved(
        this.result,
        done,
        done.told.code === 0 ? el("p", { class: "quiet" }, next) : null,
        done.page ? el("p", { class: "quiet" }, `What was seen, as a page: ${done.page}`) : null,
      );
      this.result.dataset.code = done.told.code;
    } catch (error) {
      clearInterval(clock);
      fill(this.result, el("p", { class: "bad" }, error.message));
      complain(error);
    }
    this.saveButton.disabled = false;
  }
}
