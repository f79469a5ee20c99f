// Pictures of a board as they arrive: corners, what they cover, and how far off the rig would be.

import {
  ask,
  askPicture,
  bitmap,
  button,
  complain,
  css,
  el,
  fileRow,
  fill,
  latest,
  onOtherColours,
  onPage,
  opener,
  overPicture,
  say,
  showSaved,
} from "./common.js";
import { Stage } from "./stage.js";

// A look at the camera, and a search for the board in its picture, no more often.
const LOOK_MS = 150;
const JUDGE_MS = 200;
const KINDS = /\.(png|jpe?g|tiff?|bmp|pgm|ppm)$/i;
const mm = (value) => `${value < 0.1 ? value.toFixed(3) : value.toFixed(2)} mm`;

function base64(file) {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onload = () => resolve(reader.result.slice(reader.result.indexOf(",") + 1));
    reader.onerror = () => reject(new Error(`${file.name}: cannot be read`));
    reader.readAsDataURL(file);
  });
}

export class Calibrate {
  constructor(state) {
    Object.assign(this, {
      rig: state.rig,
      size: [4, 3],
      pictures: [],
      chosen: -1,
      verdicts: [],
      camera: state.camera,
      live: Boolean(state.camera),
      seen: [],
      shown: false,
    });
    this.stage = new Stage("The picture with the corners that were found.", {
      paint: (context, px) => this.paint(context, px),
    });
    this.load = latest((i) => this.show(i));
    this.judge = latest(() => this.judgeAll());
    this.build();
    onOtherColours(() => this.covered());
  }

  enter() {
    this.there = true;
    if (this.camera && !this.begun) {
      this.begun = true;
      this.look();
      this.judgeCamera();
    }
    if (!this.pictures.length)
      say(
        this.camera
          ? "Hold the board in view of the camera."
          : "Drop in pictures of the board, or choose a folder of them.",
      );
  }

  leave() {
    this.there = false;
  }

  /** What the camera sees, as long as no picture that was taken is looked at. */
  async look() {
    try {
      const reply =
        this.there && this.live && !document.hidden ? await ask("camera/look", { after: this.seq ?? null }) : null;
      if (reply && this.live) {
        this.seq = reply.seq;
        this.size = this.camera.size;
        this.stage.show(await bitmap(reply.jpeg), this.size);
        this.element.dataset.look = reply.seq;
        if (reply.ended && !this.cameraEnded) say(`${this.camera.name}: ${reply.ended}`, true);
        this.cameraEnded = reply.ended;
        if (reply.silent_s !== null && !reply.ended)
          say(`${this.camera.name}: no picture for ${reply.silent_s} s; the last one is shown`, true);
        else if (this.silent) say("The camera is back.");
        this.silent = reply.silent_s !== null && !reply.ended;
      }
    } catch (error) {
      complain(error);
    }
    setTimeout(() => this.look(), LOOK_MS);
  }

  /** Looks for the board; takes its picture when that is asked for and worth it. */
  async judgeCamera() {
    try {
      if (this.there && this.byItself.checked && this.rig && !document.hidden && !this.cameraEnded) {
        const judged = await ask("camera/judge", this.form());
        this.seen = this.byItself.checked ? judged.images : [];
        this.cameraSays.textContent = judged.take ? `Taken: ${judged.why}.` : judged.why;
        if (this.live) this.stage.redraw();
        if (judged.take && this.byItself.checked) await this.takePicture(judged.seq);
      }
    } catch (error) {
      this.cameraSays.textContent = error.message;
      complain(error);
    }
    setTimeout(() => this.judgeCamera(), JUDGE_MS);
  }

  async takePicture(seq = null) {
    const { picture } = await ask("camera/take", { folder: this.folder.value, seq });
    await this.add(picture, seq === null);
    this.element.dataset.taken = String((Number(this.element.dataset.taken) || 0) + 1);
  }

  /** The camera again, after a picture that was taken. */
  watch() {
    [this.live, this.chosen, this.seq] = [true, -1, null];
    this.tell();
  }

  build() {
    const field = (id, text, input) => el("label", { class: "line", for: id }, text, input);
    const input = (id, value, more = {}) =>
      el("input", { id, value, spellcheck: false, onchange: () => this.changed(), ...more });
    this.board = input("board", "9x6:12mm");
    this.mirrors = input("mirrors", 1, { type: "number", min: 1, max: 8 });
    this.glass = input("glass", "", { type: "number", step: 0.1, min: 0, placeholder: "empty: in air" });
    this.tank = input("tank", "", { placeholder: "254x254x267mm, if it is a box" });
    this.water = input("water", "", { type: "number", step: 0.1, placeholder: "20" });
    this.distances = input("distances", "", { placeholder: "front_wall=1265mm:2mm" });
    this.inside = el("input", { id: "inside", type: "checkbox", onchange: () => this.changed() });
    this.folder = input("folder", "boards");
    this.out = el("input", {
      id: "rigout",
      class: "grow",
      value: this.rig ?? "",
      spellcheck: false,
      oninput: () => this.command(),
    });
    this.rigName = el("span", { class: "mono grow" }, this.rig ?? "none");
    this.list = el("div", { class: "entries", id: "boards" });
    this.verdict = el("div", { id: "verdict", "aria-live": "polite" });
    this.cover = el("div", { class: "closer cover" });
    this.shown = el("pre", { id: "rigcommand" }, "");
    this.result = el("div", { id: "rigresult", "aria-live": "polite" });
    this.saveButton = button("Calibrate and save", () => this.save(), { class: "main", id: "rigsave" });
    this.command = latest(() => this.showCommand());
    const files = el("input", {
      type: "file",
      multiple: true,
      accept: "image/*",
      id: "files",
      onchange: () => this.take([...files.files]).catch(complain),
    });
    this.byItself = el("input", {
      id: "byitself",
      type: "checkbox",
      onchange: () => {
        this.seen = [];
        this.cameraSays.textContent = "";
      },
    });
    this.cameraSays = el("p", { class: "quiet", id: "camerasays", "aria-live": "polite" });
    const camera = this.camera
      ? el(
          "section",
          {},
          el("h2", {}, `Camera ${this.camera.name}`),
          el(
            "div",
            { class: "row" },
            button("Take a picture", () => this.takePicture().catch(complain), { class: "main", id: "takepicture" }),
            button("Show the camera", () => this.watch()),
          ),
          el(
            "label",
            { for: "byitself" },
            this.byItself,
            "take one when the board stands still and tells something new",
          ),
          this.cameraSays,
        )
      : null;
    const left = el(
      "div",
      { class: "left" },
      this.stage.element,
      el(
        "div",
        { class: "below" },
        el("div", {}, this.cover, el("p", { class: "quiet" }, "What the corners of all pictures cover.")),
        el("section", { class: "grow" }, el("h2", {}, "How far off the rig would be"), this.verdict),
      ),
    );
    const side = el(
      "div",
      { class: "side" },
      el(
        "section",
        {},
        fileRow(
          "Rig",
          this.rigName,
          opener("Rig files", ["rig"], async (path) => {
            this.rig = path;
            this.rigName.textContent = path;
            this.out.value = path;
            this.changed();
          }),
        ),
        field("board", "Board", this.board),
        field("mirrors", "Mirrors", this.mirrors),
        field("glass", "Glass, mm", this.glass),
        field("tank", "Tank", this.tank),
        field("water", "Water, °C", this.water),
        field("distances", "Distances from the lens", this.distances),
        el("label", { for: "inside" }, this.inside, "the mirrors stand in the tank"),
      ),
      camera,
      el(
        "section",
        {},
        el("h2", {}, "Pictures"),
        el("div", { class: "row" }, el("label", { for: "files" }, "Add", files)),
        field("folder", "kept in", this.folder),
        button("Use the pictures in this folder", () => this.useFolder().catch(complain), { id: "usefolder" }),
        this.list,
      ),
      el(
        "section",
        {},
        el("div", { class: "row" }, el("label", { class: "grow", for: "rigout" }, "into", this.out), this.saveButton),
        this.shown,
        this.result,
      ),
    );
    this.element = el("div", { class: "view calibrate" }, left, side);
    this.element.addEventListener("dragover", (event) => event.preventDefault());
    this.element.addEventListener("drop", (event) => {
      event.preventDefault();
      this.take([...event.dataTransfer.files]).catch(complain);
    });
    this.tell();
  }

  /** Pictures that are dropped in are kept, then looked at one by one. */
  async take(files) {
    const refused = [];
    for (const file of files) {
      say(`Keeping ${file.name} …`);
      try {
        if (!KINDS.test(file.name)) throw new Error(`${file.name}: is not a picture`);
        const { picture } = await ask("board/keep", {
          folder: this.folder.value,
          name: file.name,
          base64: await base64(file),
        });
        await this.add(picture);
      } catch (error) {
        refused.push(error.message);
      }
    }
    const kept = files.length - refused.length;
    if (refused.length) say(`${kept} of ${files.length} kept. ${refused.join("; ")}`, true);
    else say(`${kept} kept in ${this.folder.value}.`);
  }

  async useFolder() {
    const { pictures, all } = await ask("board/pictures", { folder: this.folder.value });
    for (const picture of pictures) await this.add(picture);
    if (!pictures.length) say(`${this.folder.value} has no pictures`, true);
    else if (all > pictures.length)
      say(`The first ${pictures.length} of ${all} pictures are used; the command line takes all of them.`, true);
  }

  async add(path, look = true) {
    if (this.pictures.some((picture) => picture.path === path)) return;
    const picture = { path, found: null, used: true };
    this.pictures.push(picture);
    await this.find(picture);
    // Who holds the board goes on looking at the camera.
    if (look) this.go(this.pictures.indexOf(picture));
    this.judge();
  }

  async find(picture) {
    say(`Looking for the board in ${picture.path} …`);
    try {
      picture.found = await ask("board/find", {
        picture: picture.path,
        board: this.board.value,
        mirrors: Number(this.mirrors.value),
      });
      const seen = picture.found.images?.length;
      say(
        `${picture.path}: ${picture.found.error ?? `${seen} ${seen === 1 ? "image" : "images"} of the board found`}`,
        Boolean(picture.found.error),
      );
    } catch (error) {
      picture.found = { error: error.message, images: null, size: this.size };
      complain(error);
    }
    this.tell();
  }

  /** Another board, or another rig: all is looked at anew. */
  async changed() {
    this.verdicts = [];
    for (const picture of this.pictures) await this.find(picture);
    this.judge();
    this.command();
  }

  form() {
    return {
      pictures: this.pictures.filter((p) => p.used && p.found?.images).map((p) => p.path),
      board: this.board.value,
      rig: this.rig ?? "",
      mirrors: Number(this.mirrors.value),
      glass_mm: this.glass.value ? Number(this.glass.value) : null,
      tank: this.tank.value || null,
      mirrors_inside: this.inside.checked,
      temperature: this.water.value ? Number(this.water.value) : null,
      distances: this.distances.value,
    };
  }

  async judgeAll() {
    const form = this.form();
    if (!form.pictures.length || !this.rig) {
      this.verdicts = [];
      return this.tell();
    }
    // What cannot be judged has no verdict; that of other pictures is not shown for it.
    const judged = await ask("board/judge", form).catch((error) => ({
      pictures: form.pictures.length,
      error: error.message,
    }));
    this.verdicts = this.verdicts.filter((v) => v.pictures !== judged.pictures).concat(judged);
    this.element.dataset.judged = judged.pictures;
    this.tell();
    this.command();
  }

  tell() {
    fill(
      this.list,
      this.pictures.map((picture, i) => {
        const seen = picture.found?.images?.length ?? 0;
        const what = picture.found
          ? (picture.found.error ??
            `${seen} ${seen === 1 ? "image" : "images"}` +
              (picture.found.images.some((image) => image.blurred) ? ", blurred" : ""))
          : "…";
        return el(
          "div",
          { class: "row" },
          el("input", {
            type: "checkbox",
            checked: picture.used,
            "aria-label": `use ${picture.path}`,
            onchange: (e) => {
              picture.used = e.target.checked;
              this.judge();
              this.command();
            },
          }),
          button(picture.path.split("/").at(-1), () => this.go(i), {
            class: "grow",
            "aria-pressed": String(i === this.chosen),
          }),
          el("span", { class: picture.found?.error ? "bad grow" : "quiet" }, what),
        );
      }),
    );
    const last = this.verdicts.at(-1);
    const parts = [];
    if (!last) parts.push(el("p", { class: "quiet" }, "Shown once there are pictures and a rig file with a camera."));
    else if (last.error) parts.push(el("p", { class: "bad" }, `${last.pictures} pictures: ${last.error}`));
    else if (!last.verdict) parts.push(el("p", {}, "These pictures do not determine the errors."));
    else {
      const row = (name, [median, worst]) =>
        el(
          "tr",
          {},
          el("td", {}, name),
          el("td", { class: "number" }, mm(median)),
          el("td", { class: "number" }, mm(worst)),
        );
      parts.push(
        el(
          "table",
          {},
          el(
            "tr",
            {},
            el("th", {}, "1σ, in the volume of the boards"),
            el("th", { class: "number" }, "median"),
            el("th", { class: "number" }, "worst"),
          ),
          row("in the base frame", last.verdict.relative_mm),
          row("in the camera frame", last.verdict.absolute_mm),
          row("by noise, one frame", last.verdict.random_mm),
        ),
        el("h2", {}, "What would help most"),
        ["base", "camera"].flatMap((frame) => [
          el("p", {}, `In the ${frame} frame (median with it):`),
          el(
            "ul",
            {},
            last.verdict.helpful[frame].map(({ what, median_mm }) => el("li", {}, `${what}: ${mm(median_mm)}`)),
          ),
        ]),
      );
    }
    const steps = this.verdicts.filter((v) => v.verdict).sort((a, b) => a.pictures - b.pictures);
    if (steps.length > 1) {
      parts.push(
        el("h2", {}, "As pictures arrived"),
        el(
          "table",
          { id: "arrived" },
          el(
            "tr",
            {},
            ["pictures", "base frame", "camera frame"].map((t) => el("th", { class: "number" }, t)),
          ),
          steps.map((v) =>
            el(
              "tr",
              {},
              [v.pictures, mm(v.verdict.relative_mm[0]), mm(v.verdict.absolute_mm[0])].map((t) =>
                el("td", { class: "number" }, String(t)),
              ),
            ),
          ),
        ),
      );
    }
    fill(this.verdict, parts);
    this.covered();
  }

  /** All corners on one picture. */
  covered() {
    const size = this.pictures.find((p) => p.found?.size)?.found.size;
    if (!size) return fill(this.cover);
    const width = 260;
    const canvas = el("canvas", {
      width: width * 2,
      height: Math.round((width * 2 * size[1]) / size[0]),
      role: "img",
      "aria-label": "corners of all pictures",
    });
    const context = canvas.getContext("2d");
    context.fillStyle = css("--panel");
    context.fillRect(0, 0, canvas.width, canvas.height);
    const scale = canvas.width / size[0];
    this.pictures
      .filter((p) => p.used)
      .forEach((picture, i) => {
        context.fillStyle = css(onPage(i));
        for (const image of picture.found?.images ?? [])
          for (const [x, y] of image.corners) context.fillRect(x * scale - 1.5, y * scale - 1.5, 3, 3);
      });
    fill(this.cover, canvas);
  }

  go(i) {
    if (i < 0 || i >= this.pictures.length) return;
    [this.chosen, this.live] = [i, false];
    this.load(i);
    this.tell();
  }

  async show(i) {
    const picture = await askPicture("board/show", { picture: this.pictures[i].path });
    if (this.live) return;
    this.size = [picture.width, picture.height];
    this.stage.show(picture, this.size);
    this.element.dataset.shown = i;
  }

  key(event) {
    if (event.target.closest("button, input") && [" ", "Enter"].includes(event.key)) return false;
    if (event.key === "t" && this.camera) this.takePicture().catch(complain);
    else if (event.key === "ArrowLeft") this.go(this.chosen - 1);
    else if (event.key === "ArrowRight") this.go(this.chosen + 1);
    else if (event.key === "Home") this.go(0);
    else if (event.key === "End") this.go(this.pictures.length - 1);
    else if (["+", "=", "-", "0"].includes(event.key)) this.stage.key(event);
    else return false;
    return true;
  }

  paint(context, px) {
    const images = this.live
      ? this.seen.map((corners) => ({ corners }))
      : (this.pictures[this.chosen]?.found?.images ?? []);
    images.forEach((image, k) => {
      context.strokeStyle = overPicture(k);
      context.lineWidth = 1.6 * px;
      for (const [x, y] of image.corners) {
        context.beginPath();
        context.arc(x, y, 4 * px, 0, 7);
        context.stroke();
      }
    });
  }

  async showCommand() {
    const form = this.form();
    if (!form.pictures.length || !this.rig || !this.out.value) {
      this.shown.textContent = "The equivalent command appears here once there are pictures.";
      return;
    }
    try {
      this.shown.textContent = (await ask("board/save", { form, out: this.out.value, dry: true })).command;
    } catch (error) {
      this.shown.textContent = error.message;
    }
  }

  async save() {
    this.saveButton.disabled = true;
    say("Calibrating …");
    try {
      const done = await ask("board/save", { form: this.form(), out: this.out.value, dry: false });
      showSaved(this.result, done);
    } catch (error) {
      fill(this.result, el("p", { class: "bad" }, error.message));
      complain(error);
    }
    this.saveButton.disabled = false;
  }
}
