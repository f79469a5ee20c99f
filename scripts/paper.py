#!/usr/bin/env python3
"""The experiment of the paper (Tuna et al., 2018) with a simulated catheter: currents, rod dynamics, a tracker's
measurements, identification and validation, as Tables I and II beside the paper's numbers.

The result is a page, paper.html.

Without pictures: positions and tangents get the noise of `catoptra track` on a video of the paper's bench, described in
docs/rigs/paper_bench.toml. With --pictures PAUSES the circles at these pauses are also rendered, tracked and validated.
Needs Python's standard library and catoptra.

Example:
  scripts/paper.py --catoptra target/release/catoptra -o paper
"""

import argparse
import concurrent.futures
import csv
import json
import os
import pathlib
import subprocess
import time

import paper_page

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAUSES = (1, 3, 5, 8, 10, 12, 15, 18, 20, 25, 50, 100)
# As in src/validate/timing.rs: below it validate says that the phase means little.
WEAK_CORRELATION = 0.7
TABLE_1 = {"Training (300)": (1.5109, 3.2593), "Validation 1 (360)": (1.6524, 4.6544), "Validation 2 (300)": (0.4682, 1.4190)}
TABLE_2 = {
    "circle": (12.33, 9.51, 5.26, 4.80, 3.52, 3.46, 3.32, 3.22, 3.14, 3.24, 3.17, 3.24),
    "lemniscate": (12.54, 16.27, 12.08, 6.79, 5.68, 4.76, 3.71, 2.54, 2.45, 2.22, 2.19, 2.24),
}
# σ of one frame on the bench's video, `catoptra plan`: mm and degrees.
NOISE = "0.024,0.064"
# The prototype as a pendulum: wire and tube less what the water carries, in their moment about the clamp.
PLANT = "turns = 100\narea_mm2 = 11.25175\nb0_t = 3.0\nmass_g = 0.102\nlength_mm = 119.65\n"


def table(head, rows):
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in (head, ["---"] * len(head), *rows)]
    return "\n".join(lines) + "\n"


class Paper:
    def __init__(self, catoptra, out, periods):
        self.catoptra, self.out, self.periods = catoptra, out, periods
        out.mkdir(parents=True, exist_ok=True)

    def run(self, *words):
        subprocess.run([self.catoptra, *map(str, words), "-q"], check=True, cwd=self.out, stdout=subprocess.DEVNULL)

    def run_all(self, commands):
        """In parallel, one per core."""
        with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(lambda words: self.run(*words), commands))

    def dynamics(self, scale):
        """Chirps of all records, the model, and Table I."""
        (self.out / "plant.toml").write_text(PLANT)
        records = {"training": (300, 0.5, 8), "validation_1": (360, 1, 8), "validation_2": (300, 0.5, 4)}
        moved = []
        for seed, (name, (seconds, low, high)) in enumerate(records.items(), 1):
            band = ["--from", f"{low}Hz", "--to", f"{high}Hz"]
            self.run("excite", "chirp", "--duration", f"{seconds * scale}s", *band, "-o", f"{name}_currents.csv")
            sees = ["--noise", NOISE, "--missing", "1", "--seed", seed]
            moved.append(("catheter", "run", f"{name}_currents.csv", *sees, "-o", f"{name}.csv"))
        self.run_all(moved)
        currents = [word for name in records for word in ("--currents", f"{name}_currents.csv")]
        judged = [word for name in list(records)[1:] for word in ("--validate", f"{name}.csv")]
        ways = ["--order", "15", "--all-frequencies", "--bootstrap", "0"]
        self.run("identify", "training.csv", *judged, *currents, "--plant", "plant.toml", *ways, "-o", "dynamics")

    def paths(self, shape, pauses):
        """A path at all pauses, and the RMS errors after alignment."""
        follow = ["--pause", ",".join(f"{pause}ms" for pause in pauses), "--periods", self.periods, "-o", shape]
        self.run("catheter", "follow", shape, *follow)
        moved = []
        # The longest first.
        for seed, pause in sorted(enumerate(pauses, 1), reverse=True):
            currents = f"{shape}/currents_{pause}ms.csv"
            sees = ["--noise", NOISE, "--missing", "1", "--seed", seed]
            moved.append(("catheter", "run", currents, *sees, "-o", f"{shape}_{pause}ms.csv"))
        self.run_all(moved)
        return self.validated(shape, pauses, [f"{shape}_{pause}ms.csv" for pause in pauses], f"{shape}-validation", ["--start", "0"])

    def validated(self, shape, pauses, runs, folder, more):
        known = ["--periods", self.periods, "--pause", ",".join(f"{pause}ms" for pause in pauses), "--desired", f"{shape}/desired.csv"]
        self.run("validate", *runs, *known, *more, "-o", folder)
        return json.loads((self.out / folder / "validation.json").read_text())

    def pictures(self, pauses):
        """Circles rendered on the bench, tracked, and validated from what was tracked."""
        rig = ROOT / "docs" / "rigs" / "paper_bench.toml"
        catheter = ROOT / "sample_dynamics" / "catheter.toml"
        tracks = []
        for pause in pauses:
            drawn, tracked = f"circle_{pause}ms-pictures", f"circle_{pause}ms-track"
            motion = ["--motion", f"circle/currents_{pause}ms.csv", "--catheter", catheter]
            self.run("simulate", "--rig", rig, *motion, "-o", drawn)
            self.run("track", f"{drawn}/recording.mkv", "--rig", f"{drawn}/rig.toml", "-o", tracked)
            tracks.append(f"{tracked}/track.csv")
        return self.validated("circle", pauses, tracks, "circle-pictures-validation", ["--start", "0"])


def entries(validation):
    return validation["runs"] if isinstance(validation, dict) else validation


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--catoptra", default="catoptra")
    parser.add_argument("--fast", action="store_true", help="chirps a tenth as long, two periods instead of four")
    parser.add_argument("--pictures", default="", metavar="PAUSES", help="also render the circles at these pauses, ms: 5,20")
    parser.add_argument("-o", "--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    began = time.monotonic()
    catoptra = str(pathlib.Path(arguments.catoptra).resolve()) if "/" in arguments.catoptra else arguments.catoptra
    paper = Paper(catoptra, arguments.out, 2 if arguments.fast else 4)
    paper.dynamics(0.1 if arguments.fast else 1.0)
    found = {shape: entries(paper.paths(shape, PAUSES)) for shape in TABLE_2}
    pauses = [int(pause) for pause in arguments.pictures.split(",") if pause]
    seen = entries(paper.pictures(pauses)) if pauses else []
    took_s = lambda: f"{time.monotonic() - began:.0f} s"
    body = page(paper.out, found, seen, [f"circle_{pause}ms-track" for pause in pauses], arguments.fast)
    head, foot = paper_page.shell(paper.out / "circle-validation" / "report.html")
    (paper.out / "paper.html").write_text(head + body + f"<p>Made in {took_s()}.</p>\n" + foot)
    print(f"Table I: error energy, percent\n\n{table(*table_1(paper.out / 'dynamics' / 'signals.csv'))}")
    print(f"Table II: RMS distance after alignment, mm\n\n{table(*table_2(found))}")
    print(f"written: {paper.out / 'paper.html'}, in {took_s()}")


def page(out, found, seen, tracked, fast):
    """The body of the page."""
    circles = found["circle"]
    parts = [
        "<h1>The paper's experiment, simulated</h1>\n",
        paper_page.words(INTRODUCTION, *([FAST] if fast else [])),
        "<h2>Table I: error energy of the models, percent</h2>\n",
        paper_page.table(*table_1(out / "dynamics" / "signals.csv")),
        paper_page.words(*REASONS["table 1"]),
        "<h2>Table II: RMS distance after alignment (mm), by pause (ms)</h2>\n",
        paper_page.table(*table_2(found)),
        paper_page.words(*REASONS["table 2"]),
        "<h2>Fig. 8: a tracked picture</h2>\n",
        paper_page.figure_8(out, tracked[-1] if tracked else None),
        "<h2>Fig. 9: the circle at 100 ms</h2>\n",
        paper_page.figure_9(out),
        "<h2>Fig. 10: how the magnitude is found</h2>\n",
        paper_page.figure_10(out),
        "<h2>Fig. 11: magnitude and phase of the circles</h2>\n",
        *paper_page.figure_11(circles, paper_page.models(out)),
        paper_page.words(*REASONS["figure 11"]),
        "<h2>Fig. 12: circles and lemniscates at all pauses</h2>\n",
        paper_page.figure_12(out, list(found), PAUSES),
        paper_page.words(*REASONS["figure 12"]),
        "<h2>Fig. 13: tracking errors</h2>\n",
        paper_page.figure_13(found, TABLE_2, PAUSES),
        paper_page.words(*REASONS["figure 13"]),
    ]
    if seen:
        plain = {run["pause_ms"]: run for run in circles}
        rows = [[run["pause_ms"], f"{plain[run['pause_ms']]['rms_aligned_mm']:.3f}", f"{run['rms_aligned_mm']:.3f}"] for run in seen]
        parts.append("<h2>The same from rendered pictures</h2>\n")
        parts.append(paper_page.table(["pause (ms)", "without pictures (mm)", "rendered and tracked (mm)"], rows))
        parts.append(paper_page.words(*REASONS["pictures"]))
    parts += ["<h2>What is reproduced, and what is not</h2>\n", paper_page.table(*REPRODUCED, words=3)]
    return "".join(parts)


def table_2(found):
    """RMS distances beside the paper's, and what the circles' size and delay are."""
    rows = []
    for shape, published in TABLE_2.items():
        rows.append([f"{shape}, paper", *(f"{value:.2f}" for value in published)])
        rows.append([f"{shape}, here", *(f"{run['rms_aligned_mm']:.2f}" for run in found[shape])])
        if shape == "circle":
            rows.append(["magnitude here (dB)", *(f"{run['magnitude_db']:.1f}" for run in found[shape])])
            rows.append(["phase here (°)", *(phase(run) for run in found[shape])])
    return ["", *PAUSES], rows


def phase(run):
    """A circle's phase, in brackets where it means little."""
    degrees = f"{run['phase_deg']:.0f}"
    return f"({degrees})" if run["correlation"] < WEAK_CORRELATION else degrees


def table_1(signals):
    """Error energy, percent, of the models' simulations, from the signals that `identify` writes."""
    errors = {}
    with signals.open(newline="") as file:
        for row in csv.DictReader(file):
            sums = errors.setdefault(row["record"], {})
            for model in ("full", "reduced", "refined"):
                if row["output"] and row.get(model):
                    own = sums.setdefault(model, [0.0, 0.0])
                    own[0] += (float(row["output"]) - float(row[model])) ** 2
                    own[1] += float(row["output"]) ** 2
    percent = lambda sums, model: f"{100 * sums[model][0] / sums[model][1]:.3f}" if model in sums else "–"
    rows = []
    for (name, published), sums in zip(TABLE_1.items(), errors.values()):
        rows.append([name, *published, *(percent(sums, model) for model in ("full", "reduced", "refined"))])
    head = ["record (s)", "paper, order 15", "paper, order 2", "here, order 15", "here, order 2", "here, order 2 by output error"]
    return head, rows


INTRODUCTION = (
    "Nothing here was measured on a catheter: the rod of sample_dynamics/catheter.toml (the laboratory's dimensions and one of its "
    "stiffnesses; the damping is a guess) moves under the paper's chirps, circles and lemniscates, is seen with the noise that "
    "`catoptra track` has on a video of docs/rigs/paper_bench.toml and with one frame in a hundred missing, and is identified and "
    "validated as the laboratory's runs would be. Blue is here, orange the paper's."
)
FAST = (
    "This is the fast run: chirps are a tenth as long as the paper's and paths have two periods instead of four, so that models and "
    "errors are worse than those of `make paper`, and only one period counts."
)
REASONS = {
    "table 1": (
        "Not to be compared cell by cell: the paper's records have what a laboratory has (cables, a scanner, a tank that moves, a "
        "tracker with 0.6° of noise in θ), here there are 0.06° of noise and lost frames, and damping and drag are guesses. Of two "
        "models of one record the smaller leaves more: what the rod's higher modes and its drag, which is not linear, do.",
    ),
    "table 2": (
        "Long pauses: the paper's 2 to 4 mm are its model against its catheter. Here both are the same model, so that what is left is "
        "noise and motion; such an error cannot come out of a simulation.",
        "A phase in brackets means little: the motion hardly correlates with the path.",
        "Short pauses: the errors rise as in the paper, since the catheter no longer follows; where, and how steeply, is the work of "
        "damping and drag, which nobody has published. The lemniscate is twice as fast along x as the circle and begins earlier, here as there.",
    ),
    "figure 11": (
        "The paper's points are only in its drawing; what it says of them is a cut-off (−3 dB) of 1 to 2 Hz and a phase that falls off "
        "beyond it. Eq. 7 is from the torque to θ and is drawn relative to rest: its zero and slow pole make it rise below 0.1 Hz. The circles' "
        "points are taken after the first period; at 1 ms four periods are 0.8 s, less than the catheter needs to swing in, in the paper's "
        "runs as well. The dotted line is the linearised rod under the circle's first harmonic, held for a pause.",
    ),
    "figure 12": (
        "The paper draws all pauses in space; here they are drawn along the tube's axis, so that the loss of size and the turn of the "
        "lemniscates by their delay show. Offsets between desired and observed are the paper's own (see Fig. 9).",
    ),
    "figure 13": (
        "The rise below 20 ms is reproduced, the floor above is not: see Table II.",
    ),
    "pictures": (
        "Rendered, stored as video, tracked: what the pictures and the tracker add to the noise that was put on instead.",
    ),
}
REPRODUCED = (
    ["of the paper", "reproduced", "why not, or how far"],
    [
        ["Table I", "in kind", "smaller errors: no laboratory around the catheter"],
        ["Table II, short pauses", "in kind", "damping and drag are not published"],
        ["Table II, long pauses", "no", "the error of its model cannot come out of a simulation"],
        ["Fig. 8", "yes", "rendered; in make paper, which has pictures"],
        ["Fig. 9", "yes", "without the offset of Fig. 9a, which is its model's error"],
        ["Fig. 10", "yes", "the same method"],
        ["Fig. 11", "in kind", "the cut-off depends on the guessed damping; the paper's points are not published"],
        ["Fig. 12", "in kind", "seen along the tube"],
        ["Fig. 13", "short pauses", "as Table II"],
    ],
)


if __name__ == "__main__":
    main()
