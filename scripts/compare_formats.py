#!/usr/bin/env python3
"""Encode a recording with known truth in many formats, or degrade it, teach and track each, and print a Markdown table.

For each format the recording is tracked twice: with the rig as it is (taught on another recording), and with the
markers taught anew on PLANAR in this format. Errors are root mean squares after a rigid alignment of all points; in
brackets is the squared error divided by what σ predicts (1: σ is honest). "refused" counts frames without a tangent.

Needs ffmpeg with its usual encoders, and numpy.

Example:
  scripts/compare_formats.py sample_frames --rig calibration/dev_tank/rig.toml \\
      --teach "--tube 3.2mm --rigid 14mm --pick base@431,408:6mm --pick coil@431,565:12mm --pick tip@430,607:6mm"
"""

import argparse
import csv
import os
import pathlib
import re
import shlex
import shutil
import subprocess
import sys
import tempfile

import numpy as np

H264 = "-c:v libx264 -preset medium -pix_fmt yuv420p -crf"
TAGS = "-color_range tv -colorspace bt709 -color_primaries bt709 -color_trc bt709"
TO_709 = "-vf scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int+lanczos"
FORMATS = {
    "as it is": None,
    **{f"H.264 4:2:0 crf {crf}": f"{TO_709} {TAGS} {H264} {crf}" for crf in (10, 14, 20, 23, 27, 30)},
    "H.264 4:2:0 crf 23, zero latency": f"{TO_709} {TAGS} -c:v libx264 -preset veryfast -tune zerolatency -pix_fmt yuv420p -crf 23",
    "H.264 4:2:0 crf 14, interlaced": f"{TO_709},setfield=tff,tinterlace=interleave_top {TAGS} {H264} 14 -flags +ildct+ilme",
    "H.265 4:2:0 crf 20": f"{TO_709} {TAGS} -c:v libx265 -preset medium -pix_fmt yuv420p -x265-params log-level=none -crf 20",
    "H.265 4:2:0 crf 28": f"{TO_709} {TAGS} -c:v libx265 -preset medium -pix_fmt yuv420p -x265-params log-level=none -crf 28",
    "VP9 4:2:0 crf 24": f"{TO_709} {TAGS} -c:v libvpx-vp9 -deadline good -cpu-used 4 -pix_fmt yuv420p -b:v 0 -crf 24",
    "AV1 4:2:0 crf 24": f"{TO_709} {TAGS} -c:v libaom-av1 -cpu-used 6 -pix_fmt yuv420p -b:v 0 -crf 24",
    "AV1 4:2:0 crf 35, SVT": f"{TO_709} {TAGS} -c:v libsvtav1 -preset 6 -pix_fmt yuv420p -crf 35",
    "MPEG-4 q 2": f"{TO_709} {TAGS} -c:v mpeg4 -q:v 2 -pix_fmt yuv420p",
    "Theora q 9": f"{TO_709} {TAGS} -c:v libtheora -q:v 9 -pix_fmt yuv420p",
    "Motion JPEG 4:2:0 q 2": "-c:v mjpeg -q:v 2 -pix_fmt yuvj420p",
    "Motion JPEG 4:2:0 q 5": "-c:v mjpeg -q:v 5 -pix_fmt yuvj420p",
    "Motion JPEG 4:2:0 q 10": "-c:v mjpeg -q:v 10 -pix_fmt yuvj420p",
    "Motion JPEG 4:2:2 q 2": "-c:v mjpeg -q:v 2 -pix_fmt yuvj422p",
    "H.264 4:2:2 crf 14": f"{TO_709} {TAGS} -c:v libx264 -pix_fmt yuv422p -crf 14",
    "H.264 4:4:4 crf 14": f"{TO_709} {TAGS} -c:v libx264 -pix_fmt yuv444p -crf 14",
    "ProRes 4:2:2": f"{TO_709} {TAGS} -c:v prores_ks -profile:v 3 -pix_fmt yuv422p10le",
    "ProRes 4:4:4": f"{TO_709} {TAGS} -c:v prores_ks -profile:v 4 -pix_fmt yuv444p10le",
    "FFV1 4:2:0": f"{TO_709} {TAGS} -c:v ffv1 -level 3 -pix_fmt yuv420p",
    "FFV1 4:2:2": f"{TO_709} {TAGS} -c:v ffv1 -level 3 -pix_fmt yuv422p",
    "FFV1 4:4:4, 601, full range": "-vf scale=out_color_matrix=bt601:out_range=pc:flags=accurate_rnd+full_chroma_int -color_range pc"
    " -colorspace smpte170m -c:v ffv1 -level 3 -pix_fmt yuv444p",
    "FFV1 4:4:4, 2020": "-vf scale=out_color_matrix=bt2020:out_range=tv:flags=accurate_rnd+full_chroma_int -color_range tv"
    " -colorspace bt2020nc -c:v ffv1 -level 3 -pix_fmt yuv444p",
    "FFV1 RGB": "-c:v ffv1 -level 3 -pix_fmt bgr0",
    # Copies: one coder after the other.
    "H.264 4:2:0 crf 20, then FFV1": [f"{TO_709} {TAGS} {H264} 20", "-c:v ffv1 -level 3"],
    "H.264 4:2:0 crf 20, then RGB, chroma in pairs": [f"{TO_709} {TAGS} {H264} 20", "-vf scale=flags=neighbor,format=bgr0 -c:v ffv1 -level 3"],
    "H.264 4:2:0 crf 20, then Motion JPEG q 2": [f"{TO_709} {TAGS} {H264} 20", "-c:v mjpeg -q:v 2 -pix_fmt yuvj420p"],
    "FFV1 RGB from Bayer": "-vf format=bayer_rggb8,format=gbrp -c:v ffv1 -level 3 -pix_fmt bgr0",
}

AS_RGB = "-c:v ffv1 -level 3 -pix_fmt bgr0"
# On stored values: light times k is a factor of k^(1/2.2).
DEGRADATIONS = {
    "as it is": None,
    "half the exposure": f"-vf lutrgb=r=val*0.73:g=val*0.73:b=val*0.73 {AS_RGB}",
    "a quarter of it": f"-vf lutrgb=r=val*0.53:g=val*0.53:b=val*0.53 {AS_RGB}",
    "noise of 8 grey values": f"-vf format=gbrp,noise=alls=28:allf=t {AS_RGB}",
    "cast of warm light": f"-vf colorchannelmixer=rr=1:gg=0.85:bb=0.65 {AS_RGB}",
    "white balance drifts": f"-vf format=yuv444p,eq=gamma_r='1+0.15*t':gamma_b='1-0.15*t':eval=frame {AS_RGB}",
    "gamma 1.3": f"-vf lutrgb=r=gammaval(1/1.3):g=gammaval(1/1.3):b=gammaval(1/1.3) {AS_RGB}",
    "colours half grey": f"-vf format=yuv444p,hue=s=0.5 {AS_RGB}",
    "half the size": f"-vf scale=iw/2:ih/2:flags=area {AS_RGB}",
    "twice the size": f"-vf scale=iw*2:ih*2:flags=spline {AS_RGB}",
    "a bar passes": f"-filter_complex color=c=0x5a5650:s=30x260:r=60[bar];[0:v][bar]overlay=x=250+200*t:y=500:shortest=1:format=gbrp {AS_RGB}",
}
SIZES = {"half the size": 0.5, "twice the size": 2.0}


def encode(source, target, how):
    if how is None:
        shutil.copy(source, target)
        return
    steps = [how] if isinstance(how, str) else how
    for number, step in enumerate(steps, 1):
        to = target if number == len(steps) else target.with_suffix(f".{number}.mkv")
        command = ["ffmpeg", "-v", "error", "-y", "-i", str(source), "-fps_mode", "passthrough", *shlex.split(step), str(to)]
        subprocess.run(command, check=True)
        source = to


def resized(rig, by):
    """The text of a rig file for pictures that are larger by this factor."""
    def numbers(change):
        return lambda found: found[1] + re.sub(r"[-\d.]+", lambda n: f"{change(float(n[0])):.9g}", found[2])

    for key in ("width_px", "height_px", "focal_px", "blur_px"):
        rig = re.sub(rf"(?m)^({key} = )(.*)$", numbers(lambda v: v * by), rig)
    for key in ("principal_point_px", "region_px"):
        rig = re.sub(rf"(?m)^({key} = )(.*)$", numbers(lambda v: (v + 0.5) * by - 0.5), rig)
    return rig


def resized_picks(options, by):
    return re.sub(r"(@(?:\w+:)?)(\d+),(\d+)", lambda p: f"{p[1]}{round(int(p[2]) * by)},{round(int(p[3]) * by)}", options)


def aligned(truth, track):
    """Errors of points and tangents, and their normalised squares, after the best rigid motion."""
    want = {round(float(row["t_s"]) * 1000): row for row in truth}
    points, tangents, frames = [], [], 0
    for row in track:
        at = row["t_s"] and round(float(row["t_s"]) * 1000)
        true = next((want[k] for k in (at, at + 1, at - 1) if k in want), None) if at != "" else None
        if true is None:
            continue
        frames += 1
        for name in ("base", "coil", "tip"):
            if row.get(f"{name}_x_mm"):
                points.append((name, [float(row[f"{name}_{a}_mm"]) for a in "xyz"], [float(true[f"{name}_{a}"]) for a in "xyz"],
                               float(row[f"{name}_sd_mm"])))
        if row.get("tan_x"):
            tangents.append(([float(row[f"tan_{a}"]) for a in "xyz"], [float(true[f"tan_{a}"]) for a in "xyz"],
                             float(row["tan_sd_deg"])))
    if not tangents:
        return frames, 0, {}
    names = np.array([p[0] for p in points])
    found, true, sd = (np.array([p[i] for p in points]) for i in (1, 2, 3))
    weight = np.ones(len(found))
    for _ in range(5):
        a, b = np.average(found, 0, weight), np.average(true, 0, weight)
        u, _, v = np.linalg.svd(((found - a) * weight[:, None]).T @ (true - b))
        rotation = v.T @ np.diag([1, 1, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
        error = np.linalg.norm((found - a) @ rotation.T + b - true, axis=1)
        weight = 1 / (1 + (error / 0.2) ** 2)
    result = {}
    for name in ("base", "coil", "tip"):
        here = names == name
        if here.any():
            result[name] = (error[here], (error[here] / sd[here]) ** 2 / 3)
    found = np.array([t[0] for t in tangents]) @ rotation.T
    true = np.array([t[1] for t in tangents])
    cosine = (found * true).sum(1) / np.linalg.norm(found, axis=1) / np.linalg.norm(true, axis=1)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    result["tangent"] = (angle, (angle / np.array([t[2] for t in tangents])) ** 2 / 2)
    return frames, len(tangents), result


def cells(truth, video, rig, catoptra, work):
    run = subprocess.run([catoptra, "track", str(video), "--rig", str(rig), "-o", str(work), "--quiet"], capture_output=True, text=True)
    table = work / "track.csv"
    if not table.exists():
        return f"refused: {(run.stderr.strip().splitlines() or ['?'])[-1][:90]} |" + " |" * 4
    with open(table, newline="") as file:
        frames, answered, errors = aligned(truth, csv.DictReader(file))
    text = [f"{answered} of {frames}"]
    for name, unit in (("base", " mm"), ("coil", " mm"), ("tip", " mm"), ("tangent", "°")):
        if name in errors:
            error, square = errors[name]
            far = int((square * (2 if name == "tangent" else 3) > 25).sum())
            text.append(f"{np.sqrt((error**2).mean()):.3f}{unit} ({square.mean():.2f}{f', {far} > 5 σ' if far else ''})")
        else:
            text.append("")
    return " | ".join(text) + " |"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=pathlib.Path, help="folder with planar.mkv, circle.mkv and truth/circle.csv")
    parser.add_argument("--rig", required=True, type=pathlib.Path, help="finished rig, for all formats")
    parser.add_argument("--teach", required=True, help="options of `catoptra calibrate markers` for planar.mkv")
    parser.add_argument("--degrade", action="store_true", help="degrade the recording instead of encoding it")
    parser.add_argument("--only", help="formats whose name contains this")
    parser.add_argument("--keep", type=pathlib.Path, help="folder for the encoded files, used again when they are there")
    arguments = parser.parse_args()
    catoptra = os.environ.get("CATOPTRA", "catoptra")
    with open(arguments.recordings / "truth" / "circle.csv", newline="") as file:
        truth = list(csv.DictReader(file))
    print("| format | rig | answered | base | coil | tip | tangent |\n|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        work = pathlib.Path(folder)
        keep = arguments.keep or work / "videos"
        keep.mkdir(exist_ok=True)
        for number, (name, how) in enumerate((DEGRADATIONS if arguments.degrade else FORMATS).items()):
            if arguments.only and arguments.only not in name:
                continue
            videos = {}
            for run in ("planar", "circle"):
                videos[run] = keep / f"{run}_{''.join(c if c.isalnum() else '_' for c in name)}.mkv"
                if not videos[run].exists():
                    encode(arguments.recordings / f"{run}.mkv", videos[run], how)
            size = SIZES.get(name, 1.0)
            given = work / f"given{number}.toml"
            given.write_text(resized(arguments.rig.read_text(), size))
            print(f"| {name} | given |", cells(truth, videos["circle"], given, catoptra, work / f"given{number}"), flush=True)
            rig = work / f"rig{number}.toml"
            shutil.copy(given, rig)
            taught = subprocess.run([catoptra, "calibrate", "markers", str(videos["planar"]), "--rig", str(rig), *shlex.split(resized_picks(arguments.teach, size))],
                                    capture_output=True, text=True)
            if taught.returncode:
                reason = next((l for l in taught.stderr.splitlines() if "error" in l.lower()), "?")
                print(f"| | taught | refused: {reason[:120]} | | | | |", flush=True)
                continue
            print("| | taught |", cells(truth, videos["circle"], rig, catoptra, work / f"taught{number}"), flush=True)


if __name__ == "__main__":
    sys.exit(main())
