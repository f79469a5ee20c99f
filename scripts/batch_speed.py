#!/usr/bin/env python3
"""What a recording costs besides its frames, and how many recordings per second are tracked.

    scripts/batch_speed.py [--catoptra PROGRAM] [--count 60] [--jobs 1,2]

Cuts the sample into recordings of 8, 24 and 48 frames, tracks COUNT of each in one process, one thread each, and fits a line: the
slope is what a frame costs (decoding and tracking), the intercept what a recording costs besides. Both as processor time, which
other programs on the machine change little, and as time on the clock, which wants a quiet machine. Then recordings per second with
1 and 2 jobs, and the memory of the process. Needs ffmpeg.
"""

import argparse
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

TREE = Path(__file__).resolve().parent.parent


def track(args, folder, manifest, out, jobs):
    command = [args.catoptra, "track", "--manifest", manifest, "--rig", TREE / "calibration/dev_tank/rig.toml", "-o", out, "--jobs", jobs, "--threads", 1, "-q"]
    began = time.monotonic()
    child = subprocess.Popen([str(word) for word in command], cwd=folder)
    _, status, used = os.wait4(child.pid, 0)
    assert status == 0, status
    return time.monotonic() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def line(xs, ys):
    slope = statistics.linear_regression(xs, ys)
    return slope.intercept, slope.slope


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--catoptra", type=Path, default=TREE / "target/release/catoptra")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--jobs", default="1,2")
    parser.add_argument("--repeats", type=int, default=2)
    args = parser.parse_args()
    args.catoptra = args.catoptra.resolve()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        frames, clock, cpu = [], [], []
        for length in (8, 24, 48):
            recording = folder / f"{length}.mkv"
            cut = ["ffmpeg", "-v", "error", "-nostdin", "-i", TREE / "sample_frames/planar.mkv", "-frames:v", length, "-c:v", "libx264",
                   "-preset", "ultrafast", "-qp", "8", "-g", "1", "-bf", "0", recording]
            subprocess.run([str(word) for word in cut], check=True)
            names = [f"{length}-{k}.mkv" for k in range(args.count)]
            for name in names:
                os.link(recording, folder / name)
            (folder / f"{length}.tsv").write_text("recording\n" + "\n".join(names) + "\n")
        for repeat in range(args.repeats):
            for length in (8, 24, 48):
                took, used, memory = track(args, folder, f"{length}.tsv", f"out{repeat}-{length}", 1)
                frames.append(length)
                clock.append(took / args.count * 1e3)
                cpu.append(used / args.count * 1e3)
                print(f"{length} frames: {clock[-1]:.0f} ms per recording, {cpu[-1]:.0f} ms of the processor, {memory:.0f} MB", flush=True)
        for name, ys in (("clock", clock), ("processor", cpu)):
            fixed, each = line(frames, ys)
            print(f"{name}: {fixed:.1f} ms per recording and {each:.2f} ms per frame")
        for jobs in args.jobs.split(","):
            took, _, memory = track(args, folder, "8.tsv", f"jobs{jobs}", jobs)
            print(f"--jobs {jobs}: {args.count / took:.2f} recordings per second, {memory:.0f} MB at most")


if __name__ == "__main__":
    main()
