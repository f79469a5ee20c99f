#!/usr/bin/env python3
"""Render the poses of a path-traced recording again with `catoptra simulate`, and compare the two.

Both recordings are tracked with the same exact rig. For each band and view the script prints the difference of its
centre in the picture, and writes difference pictures. Needs ffmpeg, NumPy, Pillow, mcap and mcap-protobuf-support
(`make test` installs the last four into target/venv).

FOLDER is laid out as sample_frames: RUN.mkv, truth/RUN.csv. --rig is made by scripts/rig_from_truth.py, its colours by
`calibrate markers`; sample_frames/truth/rig.toml is one.

Example:
  scripts/compare_with_path_tracer.py sample_frames planar --rig sample_frames/truth/rig.toml -o compared
"""

import argparse
import csv
import math
import pathlib
import subprocess
import tomllib

import numpy
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

MARKERS = ("base", "coil", "tip")


def poses(truth, rig, out):
    """The truth as a table of a tracked run, in the base frame."""
    base = tomllib.loads(rig.read_text())["base"]["base_from_camera"]
    turn, shift = numpy.array(base["rotation"]), numpy.array(base["translation_mm"])
    head = ["seq", "t_s", "stamp_ns", "theta_deg", "theta_sd_deg", "polar_deg", "azimuth_deg"]
    for marker in MARKERS:
        head += [f"{marker}_{what}" for what in ("x_mm", "y_mm", "z_mm", "sd_mm", "status")]
    head += ["tan_x", "tan_y", "tan_z", "tan_sd_deg", "gap"]
    with truth.open(newline="") as file, out.open("w", newline="") as to:
        table = csv.writer(to)
        table.writerow(head)
        for seq, row in enumerate(csv.DictReader(file)):
            vector = lambda name: numpy.array([float(row[f"{name}_{axis}"]) for axis in "xyz"])
            tangent = turn @ vector("tan")
            theta = math.degrees(math.atan2(tangent[0], tangent[2]))
            cells = [seq, row["t_s"], round(float(row["t_s"]) * 1e9), theta, 0, 0, 0]
            for marker in MARKERS:
                cells += [*(turn @ vector(marker) + shift), 0, "ok"]
            table.writerow([*cells, *tangent, 0, 0])


def centres(log):
    """By stamp, marker and view: centre in the picture, and its covariance's trace."""
    found = {}
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, message, decoded in reader.iter_decoded_messages(topics=["/catheter/estimate"]):
            for marker in decoded.markers:
                for view in marker.views:
                    if view.HasField("band"):
                        band = view.band
                        sd = math.sqrt((band.covariance_px2[0] + band.covariance_px2[3]) / 2)
                        place = (band.centre_px.x, band.centre_px.y)
                        found[message.publish_time, marker.name, view.name] = (place, sd, band.fit_rms)
    return found


def frame(video, number, to):
    select = f"select=eq(n\\,{number})"
    subprocess.run(["ffmpeg", "-v", "error", "-y", "-i", video, "-vf", select, "-frames:v", "1", to], check=True)
    return numpy.asarray(Image.open(to).convert("RGB")).astype(float)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("run", help="name of the recording and its truth, without ending")
    parser.add_argument("--rig", type=pathlib.Path, required=True, help="the exact rig, with colours")
    parser.add_argument("--codec", default="h264", help="as the recording is stored: h264 or ffv1")
    parser.add_argument("--noise", default="10000,5")
    parser.add_argument("--catoptra", default="catoptra")
    parser.add_argument("--pictures", type=int, nargs="*", default=[], metavar="N", help="frames to compare as pictures")
    parser.add_argument("-o", "--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    out, video = arguments.out, arguments.folder / f"{arguments.run}.mkv"
    out.mkdir(parents=True, exist_ok=True)
    table = out / "poses.csv"
    poses(arguments.folder / "truth" / f"{arguments.run}.csv", arguments.rig, table)
    run = lambda *words: subprocess.run([arguments.catoptra, *map(str, words), "-q"], check=True)
    drawn = out / "simulated"
    run("simulate", "--rig", arguments.rig, "--motion", table, "--codec", arguments.codec, "--noise", arguments.noise, "-o", drawn)
    run("track", video, "--rig", arguments.rig, "-o", out / "traced-track")
    # Its own rig: the same, but for where this recorder samples chroma.
    run("track", drawn / "recording.mkv", "--rig", drawn / "rig.toml", "-o", out / "simulated-track")
    traced, simulated = (centres(out / f"{name}-track" / "log.mcap") for name in ("traced", "simulated"))
    print("| band, view | frames | mean x, y (px) | RMS of a coordinate (px) | σ of both together (px) | fit RMS, traced and simulated |")
    print("|---|---|---|---|---|---|")
    for marker, view in sorted({key[1:] for key in traced}):
        keys = sorted(key for key in traced if key[1:] == (marker, view) and key in simulated)
        off = numpy.array([numpy.subtract(simulated[key][0], traced[key][0]) for key in keys])
        sd = math.sqrt(numpy.mean([traced[key][1] ** 2 + simulated[key][1] ** 2 for key in keys]))
        fits = [numpy.mean([of[key][2] for key in keys]) for of in (traced, simulated)]
        mean, rms = off.mean(axis=0), math.sqrt((off**2).mean())
        print(f"| {marker}, {view} | {len(keys)} | {mean[0]:+.3f}, {mean[1]:+.3f} | {rms:.3f} | {sd:.3f} | {fits[0]:.2f}, {fits[1]:.2f} |")
    for number in arguments.pictures:
        pair = [frame(path, number, out / f"{name}-{number}.png") for path, name in ((video, "traced"), (drawn / "recording.mkv", "simulated"))]
        centre = [simulated[key][0] for key in simulated]
        low, high = numpy.min(centre, axis=0).astype(int) - 40, numpy.max(centre, axis=0).astype(int) + 40
        low = numpy.maximum(low, 0)
        part = [picture[low[1] : high[1], low[0] : high[0]] for picture in pair]
        panels = [*part, numpy.clip(128 + 2 * (part[1] - part[0]), 0, 255)]
        stacked = Image.fromarray(numpy.vstack(panels).astype(numpy.uint8))
        stacked.resize((2 * stacked.width, 2 * stacked.height), Image.NEAREST).save(out / f"difference-{number}.png")


if __name__ == "__main__":
    main()
