#!/usr/bin/env python3
"""Receives θ from `catoptra live SOURCE --udp 127.0.0.1:5005 …` and prints it. Needs Python's standard library only."""

import json
import socket
import sys

port = int(sys.argv[1]) if len(sys.argv) > 1 else 5005
receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiver.bind(("127.0.0.1", port))
expected = None
while True:
    frame = json.loads(receiver.recv(65536))
    if expected is not None and frame["seq"] != expected:
        print(f"{frame['seq'] - expected} datagrams lost on the way", file=sys.stderr)
    expected = frame["seq"] + 1
    if frame["status"] == "ok":
        print(f"{frame['stamp_ns'] * 1e-9:.6f} s  θ {frame['theta_deg']:+7.2f}° ± {frame['theta_sd_deg']:.2f}", flush=True)
    else:
        print(f"{frame['stamp_ns'] * 1e-9:.6f} s  {frame['status']}", flush=True)
