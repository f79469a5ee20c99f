#!/usr/bin/env python3
"""How long the studio takes from a click to its mask, with pictures of 1280x1024 and of 2448x2048 pixels; page weight; first picture.

    scripts/studio_clicks.py [--catoptra PROGRAM] [--browser PATH] [--clicks 60]

The larger pictures are those of the sample, enlarged twice and cut, with a rig to match. Measured at the server, for a program that
asks as the page does, and in the page of a browser (Playwright), from the click to the answer that is drawn next. Needs ffmpeg.
"""

import argparse
import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

TREE = Path(__file__).resolve().parent.parent
PICKS = {"base": (431, 408), "coil": (431, 565), "tip": (430, 607)}
LENGTHS = {"base": 6, "coil": 12, "tip": 6}
SIZES = {1: (1280, 1024), 2: (2448, 2048)}


def rig(scale):
    """The sample's rig without its bands, for pictures `scale` times as large."""
    text = (TREE / "calibration/dev_tank/rig.toml").read_text()
    parts = re.split(r"(?=^\[)", text, flags=re.M)
    gone = ("[[marker", "[catheter", "[base", "[provenance.markers", "[provenance.base")
    width, height = SIZES[scale]

    def scaled(line):
        key, _, value = line.partition("=")
        number = lambda change: re.sub(r"-?\d+\.?\d*", lambda found: f"{change(float(found[0])):.9f}", value)
        place = lambda v: min(scale * v + (scale - 1) / 2, width - 1)
        match key.strip():
            case "width_px":
                return f"width_px = {width}"
            case "height_px":
                return f"height_px = {height}"
            case "focal_px" | "blur_px" | "chroma_offset_px" | "colour_offset_px":
                return f"{key}={number(lambda v: scale * v)}"
            case "principal_point_px" | "region_px":
                return f"{key}={number(place)}"
        return line

    lines = "".join(part for part in parts if not part.startswith(gone)).split("\n")
    return "\n".join(map(scaled, lines))


def percentiles(took_ms):
    took_ms = sorted(took_ms)
    return f"median {statistics.median(took_ms):.0f} ms, 95 of 100 within {took_ms[int(len(took_ms) * 0.95) - 1]:.0f} ms"


def at_server(url, scale, clicks):
    base, key = url.split("/#")

    def ask(name, body):
        headers = {"content-type": "application/json", "x-catoptra-key": key}
        return urllib.request.urlopen(urllib.request.Request(f"{base}/api/{name}", json.dumps(body).encode(), headers)).read()

    bands = [{"name": name, "length_mm": length} for name, length in LENGTHS.items()]
    form = {"recording": "rest.mkv", "rig": "bare.toml", "frame": 0, "tube_mm": 3.2, "bands": bands, "coil": None, "end": None,
            "rigid_mm": None, "exposure_ms": None, "regions": [], "picks": []}
    ask("teach/prepare", {"recording": "rest.mkv", "frame": 0})
    took = []
    for k in range(clicks):
        band = list(PICKS)[k % 3]
        x, y = (scale * v + (k % 5 - 2) * 0.4 for v in PICKS[band])
        began = time.monotonic()
        found = json.loads(ask("teach/click", {"form": form, "band": band, "view": None, "x": x, "y": y}))
        took.append((time.monotonic() - began) * 1e3)
        assert found.get("mask"), found
    return percentiles(took)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--catoptra", type=Path, default=TREE / "target/release/catoptra")
    parser.add_argument("--browser", default="/usr/bin/chromium")
    parser.add_argument("--clicks", type=int, default=60)
    args = parser.parse_args()
    page = TREE / "src/studio/page"
    print(f"page: {sum(file.stat().st_size for file in page.iterdir()) / 1000:.0f} kB")
    for scale, (width, height) in SIZES.items():
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            (folder / "bare.toml").write_text(rig(scale))
            enlarged = f"scale={1280 * scale}:{1024 * scale}:flags=bicubic,crop={width}:{height}:0:0"
            make = ["ffmpeg", "-v", "error", "-nostdin", "-i", TREE / "sample_frames/rest.mkv", "-vf", enlarged, "-c:v", "libx264", "-preset", "ultrafast", "-qp", "12", folder / "rest.mkv"]
            subprocess.run([str(word) for word in make], check=True)
            studio = subprocess.Popen([str(args.catoptra.resolve()), "studio", "rest.mkv", "--rig", "bare.toml", "--no-open"], cwd=folder, stdout=subprocess.PIPE, text=True)
            try:
                url = studio.stdout.readline().strip()
                print(f"{width}x{height}, at the server: {at_server(url, scale, args.clicks)}", flush=True)
                picks = ",".join(f"{name}@{scale * x},{scale * y}" for name, (x, y) in PICKS.items())
                browse = [sys.executable, TREE / "tests/python/studio.py", args.browser, url, "--measure", args.clicks, "--picks", picks, "--size", f"{width}x{height}"]
                said = subprocess.run([str(word) for word in browse], stdout=subprocess.PIPE, text=True, check=True).stdout
                print(f"{width}x{height}, in the page: " + said.strip().replace("\n", "; "), flush=True)
            finally:
                studio.terminate()
                studio.wait()


if __name__ == "__main__":
    main()
