#!/usr/bin/env python3
"""What watching a live run costs: runs with two pages in a browser and without, side by side.

    scripts/studio_watch_trial.py [--catoptra PROGRAM] [--browser PATH] [--seconds 60] [--pairs 2] [--pages 2]

Plays the sample over and over at its own pace. A run without pages and one with pages follow each other, PAIRS times. Prints for
each: frames, rows missing, frames lost and passed over, and the latency. Needs ffmpeg, Playwright and a browser; nothing else
should run meanwhile.
"""

import argparse
import csv
import re
import subprocess
import sys
import tempfile
from pathlib import Path

TREE = Path(__file__).resolve().parent.parent


def run(args, recording, folder, pages):
    command = [args.catoptra, "live", recording, "--realtime", "--rig", TREE / "calibration/dev_tank/rig.toml", "-o", folder, "--duration", str(args.seconds)]
    browser = None
    if pages:
        watch = [sys.executable, TREE / "tests/python/studio_watch.py", args.browser, "-", "--pages", pages, "--seconds", args.seconds - 12]
        browser = subprocess.Popen([str(word) for word in watch], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert browser.stdout.readline() == "ready\n", "the browser does not start"
    live = subprocess.Popen([*map(str, command), "--studio"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    url = None
    for line in live.stderr:
        if found := re.search(r"http://\S+", line):
            url = found.group()
            break
    assert url, "the run did not say where it is shown"
    if browser:
        browser.stdin.write(f"{url}\n")
        browser.stdin.flush()
    said, warned = live.communicate()
    shown = browser.communicate()[0] if browser else ""
    assert live.returncode == 0, warned
    assert not browser or browser.returncode == 0, shown
    rows = list(csv.DictReader((folder / "track.csv").open()))
    gaps = sum(int(row["gap"]) for row in rows)
    missing = int(rows[-1]["seq"]) + 1 - len(rows)
    skipped = sum(row["coil_status"] == "skipped_overload" for row in rows)
    latency = re.search(r"median ([\d.]+) ms, 99 of 100 within ([\d.]+) ms, longest ([\d.]+) ms", said)
    print(f"{pages} pages: {len(rows)} frames, {missing} rows missing, {gaps} lost, {skipped} passed over, "
          f"median {latency[1]} ms, 99 of 100 within {latency[2]} ms, longest {latency[3]} ms", flush=True)
    if shown:
        print("    " + shown.strip().replace("\n", "\n    "), flush=True)
    return missing, float(latency[2])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--catoptra", type=Path, default=TREE / "target/release/catoptra")
    parser.add_argument("--browser", default="/usr/bin/chromium")
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--pairs", type=int, default=2)
    parser.add_argument("--pages", type=int, default=2)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        recording = Path(place) / "long.mkv"
        loop = ["ffmpeg", "-v", "error", "-nostdin", "-stream_loop", str(args.seconds // 4 + 2), "-i", TREE / "sample_frames/planar.mkv", "-c", "copy", recording]
        subprocess.run([*map(str, loop)], check=True)
        found = {0: [], args.pages: []}
        for pair in range(args.pairs):
            # Each comes first as often as the other.
            for pages in (0, args.pages) if pair % 2 == 0 else (args.pages, 0):
                found[pages].append(run(args, recording, Path(place) / f"run{pair}-{pages}", pages))
    without, watched = ([p99 for _, p99 in found[pages]] for pages in (0, args.pages))
    print(f"99 of 100 within: without {sorted(without)} ms, watched {sorted(watched)} ms")
    sys.exit(0 if all(missing == 0 for runs in found.values() for missing, _ in runs) else 1)


if __name__ == "__main__":
    main()
