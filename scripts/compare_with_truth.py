#!/usr/bin/env python3
"""Compare a track of a sample recording with the renderer's truth, and print a Markdown table.

Needs a table in the frame of the truth, and Python's standard library only. The truth of the sample recordings is in
the camera frame (`catoptra track ... --frame camera`), that of `catoptra simulate` in the base frame. Errors are
root mean squares over all frames, of the distance in space for markers and of the angle for the tangent. "one axis" is
that error per coordinate (for the tangent: per direction across; for θ: θ itself), to be compared with σ, the root mean
square of Catoptra's own standard deviations.

Example:
  catoptra track sample_frames/planar.mkv --rig sample_frames/truth/rig.toml --frame camera -o planar
  scripts/compare_with_truth.py sample_frames/truth/planar.csv planar/track.csv --rig sample_frames/truth/rig.toml
"""

import argparse
import csv
import math
import sys
import tomllib


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def vector(row, form):
    return [float(row[form.format(axis)]) for axis in "xyz"]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def rms(values):
    return math.sqrt(sum(v * v for v in values) / len(values))


def angle_deg(a, b):
    cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    return math.degrees(math.atan2(math.sqrt(dot(cross, cross)), dot(a, b)))


def theta_deg(tangent, rotation):
    return math.degrees(math.atan2(dot(rotation[0], tangent), dot(rotation[2], tangent)))


def line(name, unit, digits, errors, axes, sigmas, frames):
    error, sigma = rms(errors), rms(sigmas)
    values = [error, max(map(abs, errors)), error / math.sqrt(axes), sigma]
    cells = [f"{v:.{digits}f}{unit}" for v in values]
    return "| " + " | ".join([name, *cells, f"{len(errors)} of {frames}"]) + " |"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("truth", help="CSV from sample_frames/truth, or truth.csv of catoptra simulate")
    parser.add_argument("table", help="track.csv in the same frame")
    parser.add_argument("--rig", required=True, help="rig.toml that the recording was tracked with")
    arguments = parser.parse_args()
    truth, table = read(arguments.truth), read(arguments.table)
    with open(arguments.rig, "rb") as file:
        rig = tomllib.load(file)
    # Tables of this program name the unit; the renderer's are in the camera frame.
    in_base = f"{rig['marker'][0]['name']}_x_mm" in truth[0]
    rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]] if in_base else rig["base"]["base_from_camera"]["rotation"]
    place = "{}_{{}}_mm" if in_base else "{}_{{}}"
    if len(truth) != len(table) or any(abs(float(t["t_s"]) - float(e["t_s"])) > 1e-6 for t, e in zip(truth, table)):
        sys.exit("truth and table are not of the same frames")
    pairs = list(zip(truth, table))
    print("| | RMS error | largest | one axis | σ | frames |\n|---|---|---|---|---|---|")
    for marker in (m["name"] for m in rig["marker"]):
        answered = [(t, e) for t, e in pairs if e[f"{marker}_x_mm"]]
        if not answered:
            sys.exit(f"{marker}: not located in any frame")
        errors = [math.dist(vector(t, place.format(marker)), vector(e, marker + "_{}_mm")) for t, e in answered]
        if min(errors) > 100:
            frame = "base" if in_base else "camera"
            sys.exit(f"{marker}: more than 100 mm off everywhere; was this tracked with --frame {frame}?")
        print(line(marker, " mm", 3, errors, 3, [float(e[f"{marker}_sd_mm"]) for _, e in answered], len(pairs)))
    answered = [(vector(t, "tan_{}"), vector(e, "tan_{}"), e) for t, e in pairs if e["tan_x"]]
    errors = [angle_deg(t, e) for t, e, _ in answered]
    print(line("coil tangent", "°", 2, errors, 2, [float(e["tan_sd_deg"]) for *_, e in answered], len(pairs)))
    errors = [theta_deg(e, rotation) - theta_deg(t, rotation) for t, e, _ in answered]
    print(line("θ", "°", 2, errors, 1, [float(e["theta_sd_deg"]) for *_, e in answered], len(pairs)))


if __name__ == "__main__":
    main()
