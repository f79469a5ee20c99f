#!/usr/bin/env python3
"""Calibrate a set with known truth as a user would, with clicks beside the bands, many times, and track its recordings.

Each try displaces the click on every band by 2 to 4 pixels in a random direction, from where the band's middle is in the
direct view of planar.mkv's first frame. A line says how many tries teach, why others do not, and how the errors spread.

Needs numpy. SET is a folder with intrinsics/, mirror/, rest.mkv, planar.mkv, circle.mkv and truth/.

Example:
  CATOPTRA=target/release/catoptra scripts/teaching_trials.py SET --tries 30
"""

import argparse
import csv
import json
import os
import pathlib
import random
import subprocess
import sys
import tempfile

import numpy as np
from compare_formats import aligned

BANDS = {"base": "6mm", "coil": "12mm", "tip": "6mm"}


def refracted(direction, normal, ratio):
    """Snell's law for unit vectors, `normal` along the direction's way; `ratio`: index before over index behind."""
    cosine = direction @ normal
    return ratio * direction + (np.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine) * normal


def seen_at(point, rig):
    """Pixel of a point in the direct view: the ray through it is found by Newton's method."""
    tank = rig["tank"]

    def missed_by(slope):
        at, along = np.zeros(3), np.array([*slope, 1.0]) / np.sqrt(1 + slope @ slope)
        if tank:
            inwards = -np.array(tank["front"]["n"])
            for distance, ratio in ((tank["front"]["d_outer"], tank["n_air"] / tank["n_glass"]),
                                    (tank["front"]["d_inner"], tank["n_glass"] / tank["n_water"])):
                at = at + along * ((-distance - at @ inwards) / (along @ inwards))
                along = refracted(along, inwards, ratio)
        at = at + along * ((point[2] - at[2]) / along[2])
        return (at - point)[:2]

    slope = point[:2] / point[2]
    for _ in range(10):
        here = missed_by(slope)
        jacobian = np.stack([(missed_by(slope + step) - here) / 1e-6 for step in 1e-6 * np.eye(2)], 1)
        slope = slope - np.linalg.solve(jacobian, here)
    k1, k2, p1, p2, k3 = rig["dist"]
    x, y = slope
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    bent = np.array([x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y, 1])
    return (np.array(rig["K"]) @ bent)[:2]


def run(*arguments):
    command = [os.environ.get("CATOPTRA", "catoptra"), *map(str, arguments), "--quiet"]
    return subprocess.run(command, capture_output=True, text=True)


def must(*arguments):
    done = run(*arguments)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, arguments))}: {done.stderr}")


def table(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def one_try(number, at_px, folder, draft, work, known):
    """The reason why it does not teach, or the errors by recording and quantity; `known`: those of rigs before it."""
    chance = random.Random(number)
    picks = []
    for name, length in BANDS.items():
        angle, off = chance.uniform(0, 2 * np.pi), chance.uniform(2, 4)
        x, y = at_px[name] + off * np.array([np.cos(angle), np.sin(angle)])
        picks += ["--pick", f"{name}@{x:.0f},{y:.0f}:{length}"]
    rig = work / f"rig{number}.toml"
    taught = run("calibrate", "markers", folder / "planar.mkv", "--rig", draft, "--tube", "3.2mm", "--rigid", "14mm", *picks, "-o", rig)
    if taught.returncode:
        return taught.stderr.strip().splitlines()[0] + " | " + " ".join(picks[1::2]), {}
    text = rig.read_text()
    if text not in known:
        known[text] = tracked(number, rig, folder, work)
    return known[text]


def tracked(number, rig, folder, work):
    based = run("calibrate", "base", folder / "rest.mkv", "--rig", rig, "--planar", folder / "planar.mkv")
    if based.returncode:
        return based.stderr.strip().splitlines()[0], {}
    found = {}
    for name in ("planar", "circle"):
        out = work / f"{name}{number}"
        run("track", folder / f"{name}.mkv", "--rig", rig, "-o", out)
        rows, truth = table(out / "track.csv"), table(folder / "truth" / f"{name}.csv")
        frames, answered, errors = aligned(truth, rows)
        found[name, "answered"] = (answered / frames, 0, 0)
        for quantity, (error, square) in errors.items():
            beyond = int((square * (2 if quantity == "tangent" else 3) > 25).sum())
            found[name, quantity] = (np.sqrt((error**2).mean()), square.mean(), beyond)
        if name == "planar":
            true = {round(float(row["t_s"]) * 1000): float(row["theta_deg"]) for row in truth}
            pairs = [(float(row["theta_deg"]) - true[round(float(row["t_s"]) * 1000)], float(row["theta_sd_deg"]))
                     for row in rows if row["theta_deg"] and round(float(row["t_s"]) * 1000) in true]
            error, sd = np.array(pairs).T
            found[name, "theta"] = (np.sqrt((error**2).mean()), ((error / sd) ** 2).mean(), int((np.abs(error / sd) > 5).sum()))
    return None, found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=pathlib.Path)
    parser.add_argument("--tries", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="number of the first try, the seed of its clicks")
    arguments = parser.parse_args()
    folder = arguments.set
    truth = json.loads((folder / "truth" / "rig.json").read_text())
    start = table(folder / "truth" / "planar.csv")[0]
    at_px = {name: seen_at(np.array([float(start[f"{name}_{axis}"]) for axis in "xyz"]), truth) for name in BANDS}
    with tempfile.TemporaryDirectory() as place:
        work = pathlib.Path(place)
        draft = work / "draft.toml"
        must("calibrate", "camera", folder / "intrinsics", "--board", "9x6:12mm", "-o", draft)
        tank = ["--tank", "254x254x267mm", "--glass", "5mm"] if truth["tank"] else []
        must("calibrate", "rig", folder / "mirror", "--board", "9x6:12mm", "--rig", draft, *tank)
        tries, known = [], {}
        for number in range(arguments.first, arguments.first + arguments.tries):
            reason, found = one_try(number, at_px, folder, draft, work, known)
            if reason:
                print(f"try {number}: {reason}", flush=True)
            tries.append(found)
    taught = [found for found in tries if found]
    print(f"{folder.name}: {len(taught)} of {len(tries)} tries taught, {len(known)} different rigs")
    print("| recording | | RMS error, median (largest) of the tries | NSE | answers beyond 5 σ, most |\n|---|---|---|---|---|")
    for recording, quantity in sorted({key for found in taught for key in found}):
        here = np.array([found[recording, quantity] for found in taught if (recording, quantity) in found])
        if quantity == "answered":
            print(f"| {recording} | answered | {np.median(here[:, 0]):.1%} (least {here[:, 0].min():.1%}) | | |")
        else:
            print(f"| {recording} | {quantity} | {np.median(here[:, 0]):.3f} ({here[:, 0].max():.3f}) "
                  f"| {np.median(here[:, 1]):.2f} ({here[:, 1].max():.2f}) | {here[:, 2].max():.0f} |")


if __name__ == "__main__":
    main()
