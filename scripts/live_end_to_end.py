#!/usr/bin/env python3
"""Measures `catoptra live` end to end: a stream made by ffmpeg from a recording, tracked, θ received as datagrams.

Prints frames sent, rows logged, datagrams received, latency from a frame's arrival to θ at the receiver, CPU and memory.
Needs ffmpeg, and Python's mcap and mcap-protobuf-support (`make test` puts them into target/venv).

Example:
  target/venv/bin/python scripts/live_end_to_end.py --seconds 600
"""

import argparse
import json
import pathlib
import socket
import subprocess
import sys
import tempfile
import threading
import time

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def receive(controller, got, stop):
    controller.settimeout(0.5)
    while not stop.is_set():
        try:
            datagram = controller.recv(65536)
        except TimeoutError:
            continue
        got[json.loads(datagram)["seq"]] = time.time_ns()


def usage(pid):
    """CPU seconds and resident megabytes of a process, now."""
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    resident = int(pathlib.Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096
    return (int(fields[11]) + int(fields[12])) / 100, resident / 1e6


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recording", default="sample_frames/planar.mkv")
    parser.add_argument("--rig", default="calibration/dev_tank/rig.toml")
    parser.add_argument("--catoptra", default="target/release/catoptra")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--speed", type=float, default=1, help="times the recording's own pace")
    arguments = parser.parse_args()

    port = free_port()
    controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    controller.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    controller.bind(("127.0.0.1", 0))
    got, stop = {}, threading.Event()
    receiver = threading.Thread(target=receive, args=(controller, got, stop))
    receiver.start()

    sent = round(arguments.seconds * arguments.speed * 60)
    place = tempfile.TemporaryDirectory()
    # As a camera encodes it, each frame on its own or from earlier ones: a recording's order of coding costs two frames.
    encoded = pathlib.Path(place.name) / "camera.mkv"
    subprocess.run(
        ["ffmpeg", "-v", "error", "-i", arguments.recording, "-c:v", "libx264", "-preset", "veryfast", "-crf", "14"]
        + ["-tune", "zerolatency", "-x264-params", "slices=1", str(encoded)], check=True)
    # In MPEG-TS, at its own pace, over and over; where it begins anew the stamps jump by some frames.
    sender = subprocess.Popen(
        ["ffmpeg", "-v", "error", "-readrate", str(arguments.speed), "-stream_loop", "-1", "-i", str(encoded)]
        + ["-frames:v", str(sent), "-c:v", "copy", "-f", "mpegts"]
        + [f"tcp://127.0.0.1:{port}?listen=1"], stderr=subprocess.PIPE)
    time.sleep(1)
    with place:
        out = pathlib.Path(place.name) / "out"
        live = subprocess.Popen(
            [arguments.catoptra, "live", f"tcp://127.0.0.1:{port}", "--rig", arguments.rig, "-o", str(out)]
            + ["--udp", f"127.0.0.1:{controller.getsockname()[1]}"])
        memory, cpu, began = [], 0.0, time.time()
        while sender.poll() is None:
            time.sleep(1)
            try:
                cpu, resident = usage(live.pid)
                memory.append(resident)
            except FileNotFoundError:
                break
        took = time.time() - began
        time.sleep(2)
        live.send_signal(2)
        live.wait()
        stop.set()
        receiver.join()
        arrivals, skipped = {}, 0
        with open(out / "log.mcap", "rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, _, _, estimate in reader.iter_decoded_messages(topics=["/catheter/estimate"]):
                arrivals[estimate.seq] = estimate.arrival_ns
                skipped += estimate.deflection_status.word == "skipped_overload"
    latency_ms = sorted((got[seq] - at) * 1e-6 for seq, at in arrivals.items() if seq in got)
    at = lambda share: latency_ms[min(len(latency_ms) - 1, int(share * len(latency_ms)))]
    print(f"frames sent, at 60 x {arguments.speed:g} Hz   {sent}")
    print(f"rows logged                   {len(arrivals)}, of them skipped {skipped}")
    print(f"datagrams received            {len(got)}")
    print(f"arrival to θ at the receiver  p50 {at(0.5):.2f} ms, p99 {at(0.99):.2f} ms, max {latency_ms[-1]:.2f} ms")
    print(f"CPU                           {100 * cpu / took:.0f} % of one core")
    tenth = max(1, len(memory) // 10)
    print(f"memory                        {sum(memory[tenth:2 * tenth]) / tenth:.0f} MB after a tenth of the run, "
          f"{sum(memory[-tenth:]) / tenth:.0f} MB in the end")


if __name__ == "__main__":
    sys.exit(main())
