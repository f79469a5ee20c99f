// A live run.

import { ask, bitmap, button, complain, el, fill, fixed, onPage, overPicture, say, swatch } from "./common.js";
import { Plot, lostBars } from "./plot.js";
import { Stage, label, outline } from "./stage.js";

const SECONDS = 20;
// What is drawn costs the computer that tracks, too: no more often than the eye follows.
const ASK_MS = 200;
const PICTURE_MS = 200;
// Samples of currents that wait for a frame to be drawn against: as many as the program keeps.
const MAX_WAITING = 3600;
const AXES = ["x", "y", "z"];

export class Watch {
  constructor(state) {
    this.live = state.live;
    Object.assign(this, {
      rows: [],
      currents: [],
      after: null,
      currentsAfter: null,
      seq: null,
      bands: [],
      there: false,
      paused: false,
    });
    this.shared = { from: 0, to: SECONDS, cursor: null };
    this.theta = new Plot("θ of the last seconds with its σ", "θ (°)", this.shared);
    this.tip = new Plot(
      "Place of the tip in the last seconds",
      `tip (mm, ${this.live.in_base ? "base" : "camera"} frame)`,
      this.shared,
    );
    this.coils = new Plot("Currents of the coils in the last seconds", "currents (A)", this.shared);
    for (const plot of [this.tip, this.coils]) plot.element.classList.add("low");
    this.coils.element.hidden = true;
    this.stage = new Stage("The live picture with outlines of the bands.", {
      paint: (context, px) => this.paint(context, px),
    });
    this.big = el("div", { class: "big", id: "theta" }, "θ –");
    this.figures = el("div", { class: "figures" });
    this.alarms = el("div", { id: "alarms", "aria-live": "assertive" });
    this.pause = button("Hold the picture", () => this.hold(), { "aria-pressed": "false" });
    const { source, folder, hows } = this.live;
    this.record = button("Record pictures", () => this.turn(), { id: "record", "aria-pressed": "false" });
    const how = {
      windows: "parts around the bands, into the log",
      ffv1: "whole, without loss (large)",
      h264: "whole, H.264",
    };
    this.how = el(
      "select",
      { id: "how", "aria-label": "how pictures are recorded" },
      (hows ?? []).map((word) => el("option", { value: word }, `${word}: ${how[word] ?? ""}`)),
    );
    this.recorded = el("div", { id: "recorded", "aria-live": "polite" });
    this.element = el(
      "div",
      { class: "view watch" },
      el(
        "div",
        { class: "left" },
        this.stage.element,
        el(
          "div",
          {},
          this.theta.element,
          this.tip.element,
          el(
            "div",
            { class: "legend" },
            el("span", {}, swatch("--ink"), "θ ± σ"),
            el("span", {}, swatch("--miss"), "no θ"),
            el("span", {}, swatch("--gap"), "frames lost"),
            AXES.map((axis, k) => el("span", {}, swatch(onPage(k)), `tip ${axis}`)),
          ),
          this.coils.element,
        ),
      ),
      el(
        "div",
        { class: "side" },
        el("section", {}, el("div", { class: "quiet" }, `${source} into ${folder}`), this.big, this.pause),
        hows
          ? el(
              "section",
              {},
              el("h2", {}, "Recording of pictures"),
              el("div", { class: "row" }, this.record, this.how),
              this.recorded,
            )
          : null,
        el("section", {}, el("h2", {}, "Status"), this.figures),
        el("section", {}, el("h2", {}, "Alarms"), this.alarms),
      ),
    );
    this.begun = false;
  }

  enter() {
    if (this.begun) return;
    this.begun = true;
    this.follow();
    this.pictures();
  }

  key(event) {
    if (event.key === "r" && this.live.hows) this.turn();
    else if (event.key === " " && !event.target.closest("button")) this.hold();
    else return false;
    return true;
  }

  /** Begins or ends the recording of pictures. */
  async turn() {
    const on = !this.recording?.on;
    try {
      this.tellRecording(await ask("watch/record", { on, how: this.how.value }));
      say(on ? "Recording of pictures has begun." : "Recording of pictures has ended. The log continues.");
    } catch (error) {
      complain(error);
    }
  }

  /** Whether the run can be told what to do. */
  reachable(yes) {
    for (const either of [this.record, this.pause]) either.disabled = !yes;
    this.how.disabled = !yes || Boolean(this.recording?.on);
  }

  tellRecording(state, pictures) {
    if (!state) return;
    this.recording = state;
    this.record.textContent = state.on ? "Stop recording" : "Record pictures";
    this.record.setAttribute("aria-pressed", String(state.on));
    this.how.disabled = state.on;
    if (state.on) this.how.value = state.how;
    this.element.dataset.recording = String(state.on);
    const places = [...new Set(state.places)].join(", ");
    const counts = pictures ? `${pictures[0]} recorded, ${pictures[1]} not` : "";
    const said = [state.on ? "on" : "off", places, counts, state.problem].join();
    if (said === this.recordingSaid) return;
    this.recordingSaid = said;
    fill(
      this.recorded,
      el(
        "p",
        { class: "quiet" },
        state.on
          ? `Recording into ${state.places.at(-1) ?? "…"}. ${counts}`
          : places
            ? `Not recording. Recorded so far: ${places}. ${counts}`
            : "Not recording.",
      ),
      state.problem ? el("p", { class: "bad" }, state.problem) : null,
    );
  }

  hold() {
    this.paused = !this.paused;
    this.pause.setAttribute("aria-pressed", String(this.paused));
    this.pause.textContent = this.paused ? "Resume" : "Hold the picture";
  }

  async follow() {
    try {
      const reply = await ask("watch", { after: this.after, currents_after: this.currentsAfter });
      this.take(reply);
      if (!this.there) say("Watching.");
      this.reachable(true);
      this.there = true;
    } catch (error) {
      this.there = false;
      say(`The run is over, or the program is not reached: ${error.message}. What there is of it is in ${this.live.folder}.`);
      this.big.textContent = "θ – over, or not reached";
      this.big.classList.add("bad");
      this.said = null;
      this.recordingSaid = null;
      fill(this.figures, el("p", { class: "quiet whole" }, "A run that ended has its counts and latencies in its report."));
      fill(this.alarms, el("p", { class: "bad" }, "Not known: the program does not answer."));
      fill(this.recorded, el("p", { class: "quiet" }, "Not known."));
      this.reachable(false);
      setTimeout(() => this.follow(), 1000);
      return;
    }
    setTimeout(() => this.follow(), ASK_MS);
  }

  async pictures() {
    try {
      const reply = this.paused || document.hidden ? null : await ask("watch/picture", { after: this.seq });
      if (reply) {
        this.seq = reply.seq;
        this.bands = reply.bands;
        this.stage.show(await bitmap(reply.jpeg), this.live.size);
        this.element.dataset.picture = reply.seq;
      }
    } catch (error) {
      if (this.there) complain(error);
    }
    setTimeout(() => this.pictures(), PICTURE_MS);
  }

  take({ rows, currents, status }) {
    this.tellRecording(status.recording, status.pictures);
    for (const row of rows) {
      // A clock that was set back, or began anew: what was before has no place on its axis.
      if (row.t_s < (this.rows.at(-1)?.t_s ?? row.t_s)) this.rows = [];
      this.rows.push(row);
    }
    this.currents.push(...currents);
    if (currents.length) this.currentsAfter = currents.at(-1).host_ns;
    const last = this.rows.at(-1);
    // Host's time and camera's stand to each other as in the last frame.
    const shift = (last?.host_s ?? null) === null ? null : last.t_s - last.host_s;
    if (shift === null) this.currents = this.currents.slice(-MAX_WAITING);
    const missed = last ? this.draw(last, shift) : 0;
    this.tell(status, last, missed);
  }

  /** The plots of the last seconds; how many frames in them have no θ. */
  draw(last, shift) {
    this.after = last.seq;
    this.rows = this.rows.filter((row) => row.t_s > last.t_s - SECONDS - 1);
    // Seconds before now.
    const origin = last.t_s;
    const x = this.rows.map((row) => row.t_s - origin);
    Object.assign(this.shared, { from: -SECONDS, to: 0 });
    const missed = x.filter((_, i) => !this.rows[i].theta_deg);
    const lost = this.rows.map((row) => row.gap);
    this.theta.set(
      [
        {
          x,
          y: this.rows.map((row) => row.theta_deg?.[0] ?? null),
          sd: this.rows.map((row) => row.theta_deg?.[1] ?? 0),
          lost,
          colour: "--ink",
        },
      ],
      [{ x: missed, colour: "--miss", shape: "tick" }],
      lostBars(x, lost),
    );
    this.tip.set(
      AXES.map((_, k) => ({
        x,
        y: this.rows.map((row) => row.tip_mm?.[k] ?? null),
        lost,
        colour: onPage(k),
        dash: [[], [5, 3], [2, 3]][k],
      })),
    );
    this.coils.element.hidden = !(this.currents.length && shift !== null);
    if (!this.coils.element.hidden) {
      this.currents = this.currents.filter((sample) => sample.host_s + shift > last.t_s - SECONDS - 1);
      const times = this.currents.map((sample) => sample.host_s + shift - origin);
      const coils = Math.max(0, ...this.currents.map((sample) => sample.a.length));
      this.coils.set(
        [...Array(coils).keys()].map((k) => ({
          x: times,
          y: this.currents.map((sample) => sample.a[k] ?? null),
          colour: onPage(k),
          dash: [[], [5, 3], [2, 3]][k % 3],
        })),
      );
    }
    this.element.dataset.seq = last.seq;
    return missed.length;
  }

  /** The angle now, and how the run goes. */
  tell(status, last, missed) {
    // What was measured long ago is not the angle now.
    const silent = status.silent_s === null ? null : `no frame for ${status.silent_s.toFixed(0)} s`;
    const now = silent === null ? last?.theta_deg : null;
    const [theta, sd] = now ?? [];
    this.big.textContent = now ? `θ ${fixed(theta, 2)}° ± ${fixed(sd, 2)}°` : `θ – ${silent ?? last?.status ?? "no frame yet"}`;
    this.big.classList.toggle("bad", !now);
    const ms = (v) => `${v.toFixed(2)} ms`;
    const figures = [
      [status.frames, "frames"],
      [`${status.rate.toFixed(1)} / s`, "in the last second"],
      [status.lost, "lost"],
      [status.skipped, "passed over"],
      [ms(status.p50_ms), "arrival to θ, median of the last second"],
      [ms(status.p99_ms), "99 of 100 within, last second"],
      [ms(status.max_ms), "longest of the last second"],
      [missed, `without θ in ${SECONDS} s`],
      [status.backlog, "rows wait for the disk"],
    ];
    if (status.disk_gb !== null) figures.push([`${status.disk_gb.toFixed(1)} GB`, "free on the disk"]);
    if (status.unlogged) figures.push([status.unlogged, "rows not logged"]);
    if (status.not_shown) figures.push([status.not_shown, "rows only in the log"]);
    fill(
      this.figures,
      ...figures.map(([value, name]) => el("div", {}, el("b", {}, String(value)), el("span", {}, name))),
    );
    const words = status.alarms
      .filter((alarm) => alarm.over_s === null)
      .map((alarm) => `${alarm.what}\n${alarm.advice}`);
    const over = status.alarms
      .filter((alarm) => alarm.over_s !== null)
      .map((alarm) => `over, from ${alarm.t_s.toFixed(1)} s to ${alarm.over_s.toFixed(1)} s: ${alarm.what}`);
    words.push(...status.warnings);
    if (silent)
      words.push("no frames come\nLook at the camera, its cable or the sender of the stream; the run waits for them");
    if (status.skipped)
      words.push(
        "frames are passed over: the tracker does not keep up\n" +
          "End other programs, use a smaller picture or a lower frame rate; each frame has its row all the same",
      );
    if (status.disk_nearly_full)
      words.push("the disk is nearly full\nFree some of it before rows are lost, or write elsewhere with -o");
    if (status.unlogged)
      words.push("rows cannot be written\nThe disk is full or too slow: free some of it, or write elsewhere with -o");
    const said = [...words, ...over].join();
    if (said === this.said) return;
    this.said = said;
    fill(
      this.alarms,
      ...(words.length
        ? words.map((word) => {
            const [what, cure] = word.split("\n");
            return el("div", { class: "alarm" }, el("b", {}, what), el("div", {}, cure ?? ""));
          })
        : [el("p", { class: "good" }, "None.")]),
      ...over.map((word) => el("p", { class: "quiet" }, word)),
    );
  }

  paint(context, px) {
    for (const [m, views] of this.bands.entries()) {
      for (const band of views) {
        if (!band) continue;
        outline(context, band.outline, overPicture(m), 2 * px);
        label(context, this.live.markers[m], [band.centre[0] + 22 * px, band.centre[1] + 5 * px], overPicture(m), px);
      }
    }
  }
}
