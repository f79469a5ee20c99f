// A run that is over: θ over time, and each frame with what was found in it.

import {
  ask,
  askPicture,
  button,
  complain,
  el,
  fileRow,
  fill,
  fixed,
  latest,
  onPage,
  opener,
  overPicture,
  say,
  swatch,
} from "./common.js";
import { Plot, lostBars } from "./plot.js";
import { Space } from "./scene.js";
import { Stage, label, outline } from "./stage.js";

// Reasons differ in shade and in their names beside it; none rests on colour alone.
const REASONS = ["--miss", "--m4", "--m1", "--m3", "--m5", "--gap"];
const AGAIN_MS = 300;

export class Review {
  constructor(state) {
    Object.assign(this, { path: state.run, run: null, other: null, row: 0, playing: false, found: null });
    this.shared = { from: 0, to: 1, cursor: null };
    const at = (t) => this.go(this.rowAt(t));
    this.theta = new Plot("θ over time with its σ", "θ (°)", this.shared, at);
    this.residual = new Plot("Residuals over time, band by band", "residual (px)", this.shared, at);
    this.residual.element.classList.add("low");
    this.stage = new Stage("The frame with outlines of the bands in all views.", {
      paint: (context, px) => this.paint(context, px),
    });
    this.space = new Space();
    this.load = latest((row) => this.showRow(row));
    this.build();
  }

  enter() {
    if (this.run) this.sayRun();
    else if (this.path) this.open(this.path).catch(complain);
    else say("Choose the folder of a run.");
  }

  leave() {
    if (this.playing) this.play();
  }

  build() {
    this.name = el("span", { class: "mono grow" }, this.path ?? "none");
    this.otherName = el("span", { class: "mono grow quiet" }, "none");
    this.slider = el("input", {
      type: "range",
      min: 0,
      max: 0,
      value: 0,
      "aria-label": "Frame of the run",
      oninput: () => this.go(Number(this.slider.value)),
    });
    this.at = el("span", { class: "mono" }, "");
    this.playButton = button("Play", () => this.play(), { "aria-pressed": "false" });
    this.legend = el("div", { class: "legend" });
    this.words = el("div", { id: "frame" });
    this.list = el("div", { id: "vetoes" });
    this.comment = el("input", {
      class: "grow",
      id: "comment",
      placeholder: "why not to trust it",
      "aria-label": "why this frame should not be trusted",
      maxLength: 400,
      onkeydown: (event) => event.key === "Escape" && this.comment.blur(),
    });
    this.vetoButton = el("button", { type: "submit" }, "Veto this frame");
    // A form: Enter in the field is the button.
    const submitted = (event) => {
      event.preventDefault();
      this.veto().catch(complain);
    };
    this.drift = el("div", {});
    this.missing = el("p", { class: "bad", hidden: true });
    const pictures = el("div", { class: "pictures" }, this.stage.element, this.space.element);
    const left = el(
      "div",
      { class: "left" },
      pictures,
      el(
        "div",
        { class: "row" },
        button("‹", () => this.go(this.row - 1)),
        this.playButton,
        button("›", () => this.go(this.row + 1)),
        button("next miss", () => this.nextMiss()),
        button("whole run", () => this.theta.whole()),
        this.slider,
        this.at,
      ),
      el("div", {}, this.theta.element, this.legend, this.residual.element),
    );
    const side = el(
      "div",
      { class: "side" },
      el(
        "section",
        {},
        fileRow("Run", this.name, opener("Runs", ["run"], (path) => this.open(path))),
        fileRow(
          "Compare",
          this.otherName,
          opener("Runs", ["run"], (path) => this.compare(path)),
          button("None", () => this.compare(null).catch(complain)),
        ),
        this.missing,
      ),
      el("section", {}, el("h2", {}, "This frame"), this.words),
      el(
        "section",
        {},
        el("h2", {}, "Veto"),
        el("form", { class: "row", onsubmit: submitted }, this.comment, this.vetoButton),
        el(
          "p",
          { class: "quiet" },
          "Written into vetoes.csv beside the run; what was measured stays, " +
            "and a veto that is taken back stays in the file.",
        ),
        this.list,
      ),
      el("section", {}, el("h2", {}, "Drift"), this.drift),
    );
    this.element = el("div", { class: "view review" }, left, side);
  }

  async open(path) {
    say(`Reading ${path} …`);
    this.run = await ask("run", { run: path });
    [this.path, this.row, this.found] = [path, 0, null];
    this.name.textContent = path;
    const { t_s: t } = this.run;
    const last = t.at(-1) ?? 1;
    Object.assign(this.shared, {
      from: t[0] ?? 0,
      to: last > (t[0] ?? 0) ? last : 1,
      whole: [t[0] ?? 0, last],
      cursor: null,
    });
    this.slider.max = Math.max(0, t.length - 1);
    fill(
      this.drift,
      ...(this.run.alarms.length
        ? this.run.alarms.map(({ t_s: from, over_s: over, what }) =>
            el(
              "p",
              { class: "alarm" },
              `from ${from.toFixed(2)} s ${over === null ? "on" : `to ${over.toFixed(2)} s`}: ${what}`,
            ),
          )
        : [el("p", {}, this.run.note ?? "None was noticed.")]),
    );
    this.vetoes = this.run.vetoes;
    this.missing.hidden = !this.run.cut;
    this.missing.textContent = `Not all of this run can be read: ${this.run.cut}`;
    this.plots();
    this.sayRun();
    this.element.dataset.rows = t.length;
    if (t.length) this.go(0);
    else this.empty("This run has no rows.");
  }

  sayRun() {
    const { cut, miss } = this.run;
    const missed = miss.filter((m) => m !== null).length;
    say(`${this.path}: ${cut ?? `${miss.length} frames, ${missed} without θ`}`, Boolean(cut));
  }

  async compare(path) {
    if (!this.run) return say("Open the run first that it is to be compared with.", true);
    this.other = path ? await ask("run", { run: path }) : null;
    this.otherName.textContent = path ?? "none";
    this.plots();
    if (path) say(`${path} is drawn with dashes, each run from its own beginning.`);
  }

  plots() {
    const { run, other } = this;
    const { t_s: x } = run;
    const lines = [{ x, y: run.theta_deg, sd: run.sd_deg, lost: run.gap, colour: "--ink", name: "θ" }];
    if (other)
      lines.push({
        // From the beginning of this run.
        x: other.t_s.map((t) => t - other.t_s[0] + x[0]),
        lost: other.gap,
        y: other.theta_deg,
        sd: other.sd_deg,
        colour: "--quiet",
        name: "the other run",
        dash: [6, 4],
      });
    const marks = run.reasons.map((_, k) => ({
      x: x.filter((_, i) => run.miss[i] === k),
      colour: REASONS[k % REASONS.length],
      shape: "tick",
    }));
    marks.push({ x: x.filter((_, i) => this.vetoes[this.seq(i)] !== undefined), colour: "--bad", shape: "cross" });
    const bars = run.alarms.map((alarm) => ({ x0: alarm.t_s, x1: alarm.over_s ?? x.at(-1), colour: "--bad" }));
    bars.push(...lostBars(x, run.gap));
    this.theta.set(lines, marks, bars);
    const strokes = [[], [5, 3], [2, 3]];
    this.residual.set(
      run.residuals.map(({ band, view, px }) => ({
        x,
        y: px,
        lost: run.gap,
        colour: onPage(run.markers.indexOf(band)),
        name: `${band} in ${view}`,
        dash: strokes[run.views.indexOf(view) % 3],
      })),
    );
    const lost = run.gap.reduce((sum, gap) => sum + gap, 0);
    fill(
      this.legend,
      el("span", {}, swatch("--ink"), "θ ± σ"),
      other ? el("span", {}, swatch("--quiet"), `compared (dashes): ${other.run}`) : null,
      ...run.reasons.map((reason, k) =>
        el(
          "span",
          {},
          swatch(REASONS[k % REASONS.length]),
          `${reason} (${run.miss.filter((m) => m === k).length})`,
        ),
      ),
      lost ? el("span", {}, swatch("--gap"), `frames lost (${lost})`) : null,
      Object.keys(this.vetoes).length ? el("span", { class: "bad" }, "× vetoed") : null,
      ...(run.views.length ? run.markers : []).map((marker, m) =>
        el(
          "span",
          {},
          swatch(onPage(m)),
          `${marker}: ${run.views.map((v, k) => `${v} ${["—", "- -", "···"][k % 3]}`).join(", ")}`,
        ),
      ),
    );
  }

  seq(i) {
    // Numbers of frames are those of rows, but for runs of a part: the rows know.
    return String(this.run.seq?.[i] ?? i);
  }

  rowAt(t) {
    const x = this.run?.t_s ?? [];
    let [low, high] = [0, x.length - 1];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (x[middle] < t) low = middle + 1;
      else high = middle;
    }
    return low > 0 && t - x[low - 1] < x[low] - t ? low - 1 : Math.max(0, low);
  }

  go(row) {
    if (!this.run?.t_s.length) return;
    this.row = Math.min(this.run.t_s.length - 1, Math.max(0, row));
    this.slider.value = this.row;
    this.shared.cursor = this.run.t_s[this.row];
    this.at.textContent = `row ${this.row}  ${this.shared.cursor.toFixed(3)} s`;
    this.theta.all();
    this.load(this.row);
  }

  nextMiss() {
    const next = this.run?.miss.findIndex((miss, i) => i > this.row && miss !== null) ?? -1;
    if (next >= 0) {
      this.go(next);
      say("");
    } else say("No frame without θ comes after this one.");
  }

  /** No frame is shown, for a reason. */
  empty(why) {
    this.found = null;
    if (this.playing) this.play();
    this.at.textContent = "";
    this.stage.show(null, this.stage.size);
    this.space.set(this.run.set_up, null);
    fill(this.words, el("p", { class: "bad" }, why));
    delete this.element.dataset.row;
  }

  async showRow(row) {
    let found;
    let picture = null;
    try {
      found = await ask("run/frame", { run: this.path, row, version: this.run.version });
      if (found.recording)
        picture = await askPicture("frame", { recording: found.recording, frame: found.frame, width: null });
    } catch (error) {
      // What was found in another frame does not stand for this one.
      this.empty(`Row ${row} is not known: ${error.message}`);
      throw error;
    }
    this.found = { ...found, row };
    if (picture) this.stage.show(picture, [picture.width, picture.height]);
    else this.stage.show(null, this.stage.size);
    this.space.set(this.run.set_up, found.scene);
    this.tell();
    this.element.dataset.row = row;
    clearTimeout(this.again);
    if (found.wait) this.again = setTimeout(() => row === this.row && this.load(row), AGAIN_MS);
    else if (this.playing) {
      if (row + 1 < this.run.t_s.length) setTimeout(() => this.playing && this.go(row + 1), 15);
      else this.play();
    }
  }

  tell() {
    const { found } = this;
    const plain = (value, digits) => (value === null || value === undefined ? "–" : fixed(value, digits));
    const theta =
      found.theta_deg === null
        ? el("span", { class: "bad" }, found.status)
        : `${plain(found.theta_deg, 3)}° ± ${plain(found.sd_deg, 3)}°`;
    const vetoed = this.vetoes[found.seq];
    fill(
      this.words,
      el(
        "p",
        {},
        el("b", {}, "θ "),
        theta,
        el("span", { class: "quiet" }, `   frame ${found.seq}, ${found.stamp_ns} ns`),
      ),
      vetoed === undefined ? null : el("p", { class: "bad" }, `vetoed: ${vetoed}`),
      found.no_picture ? el("p", { class: found.wait ? "quiet" : "bad" }, found.no_picture) : null,
      el(
        "table",
        {},
        el(
          "tr",
          {},
          el("th", {}, "Band"),
          el("th", { class: "number" }, "σ in space, mm"),
          ...this.run.views.map((v) => el("th", { class: "number" }, `${v}: residual, σ`)),
        ),
        found.bands.map((band, m) =>
          el(
            "tr",
            {},
            el("td", {}, swatch(onPage(m)), band.name),
            band.ok
              ? el("td", { class: "number" }, plain(band.sd_mm, 3))
              : el("td", { class: "bad" }, band.status),
            ...band.views.map((seen) =>
              el("td", { class: "number" }, seen ? `${plain(seen.residual_px, 2)}, ${plain(seen.sd_px, 2)} px` : "–"),
            ),
          ),
        ),
      ),
    );
    this.vetoButton.textContent = vetoed === undefined ? "Veto this frame" : "Take the veto back";
    const rows = Object.entries(this.vetoes);
    fill(
      this.list,
      this.run.vetoes_of_none ? el("p", { class: "bad" }, this.run.vetoes_of_none) : null,
      ...(rows.length
        ? [
            el(
              "ul",
              {},
              rows.map(([seq, comment]) => el("li", {}, `frame ${seq}: ${comment}`)),
            ),
          ]
        : []),
    );
  }

  async veto() {
    if (!this.found) return;
    const vetoed = this.vetoes[this.found.seq] === undefined;
    if (!this.comment.value.trim()) {
      this.comment.focus();
      return say("Enter why this frame should not be trusted, or can be again.", true);
    }
    // The frame that is shown: another one may be on its way.
    const { row, seq } = this.found;
    const reply = await ask("run/veto", {
      run: this.path,
      row,
      seq,
      version: this.run.version,
      vetoed,
      comment: this.comment.value,
    });
    this.vetoes = reply.vetoes;
    this.comment.value = "";
    // Keys step through the frames again.
    this.comment.blur();
    say(`${vetoed ? "Vetoed" : "Taken back"}: written to ${reply.file} in ${this.path}`);
    this.tell();
    this.plots();
  }

  play() {
    if (!this.run?.t_s.length) return;
    this.playing = !this.playing;
    this.playButton.setAttribute("aria-pressed", String(this.playing));
    this.playButton.textContent = this.playing ? "Stop" : "Play";
    if (this.playing) this.go(this.row + 1 < this.run.t_s.length ? this.row + 1 : 0);
  }

  key(event) {
    if (!this.run) return false;
    const by = event.ctrlKey ? 10 : 1;
    if (event.target.closest("button, input") && [" ", "Enter"].includes(event.key)) return false;
    if (event.target.type === "range" && event.key.startsWith("Arrow")) return false;
    if (event.key === " ") this.play();
    else if (event.key === "ArrowLeft") this.go(this.row - by);
    else if (event.key === "ArrowRight") this.go(this.row + by);
    else if (event.key === "Home") this.go(0);
    else if (event.key === "End") this.go(this.run.t_s.length - 1);
    else if (event.key === "v") this.comment.focus();
    else if (["+", "=", "-", "0"].includes(event.key)) this.stage.key(event);
    else return false;
    return true;
  }

  paint(context, px) {
    for (const [m, band] of (this.found?.bands ?? []).entries()) {
      for (const seen of band.views) {
        if (!seen) continue;
        outline(context, seen.outline, overPicture(m), 2 * px);
        label(context, band.name, [seen.centre[0] + 22 * px, seen.centre[1] + 5 * px], overPicture(m), px);
      }
    }
  }
}
