#!/usr/bin/env python3
"""Makes the records of sample_dynamics: Eq. 7 of the paper as the truth inside Eq. 6, moved by chirps as in the paper.

    scripts/simulate_dynamics.py OUT [--length SECONDS]

scipy integrates the plant between changes of the input, without any code of Catoptra. The amplifier takes a new command
60 times a second and holds it; the camera takes frames on its own 60 Hz clock, a few of which are lost or missed, and θ
has the tracker's noise. Needs numpy and scipy.
"""

import argparse
import pathlib

import numpy as np
from scipy.signal import cont2discrete, tf2ss

NUM, DEN = [1.761e4, 6344.0], [1.0, 4.59, 1.136]  # Eq. 7
TURNS, AREA_M2, B0_T = 100, 8.0e-6, 3.0
MASS_KG, LENGTH_M, GRAVITY = 0.03e-3, 0.1, 9.80665  # the mass is what the water does not carry
NOISE_RAD = np.radians(0.11)
RATE_HZ = 60.0
STEP_S = 1e-3 / 6  # of the integration; a hundredth of a command

PLANT = f"""\
# The coil of sample_dynamics, for Eq. 6 (simulated: scripts/simulate_dynamics.py).
turns = {TURNS}
area_mm2 = {AREA_M2 * 1e6}
b0_t = {B0_T}
# What the water does not carry.
mass_g = {MASS_KG * 1e3}
length_mm = {LENGTH_M * 1e3}
"""


def torque(current, theta):
    return current * AREA_M2 * TURNS * B0_T * np.cos(theta) - MASS_KG * GRAVITY * LENGTH_M * np.sin(theta)


def chirp(length, low, high, amplitude=0.1):
    t = np.arange(int(round(length * RATE_HZ))) / RATE_HZ
    return t, amplitude * np.sin(2 * np.pi * (low * t + (high - low) * t**2 / (2 * length)))


def simulate(commands, length):
    """θ every STEP_S: each short step with the torque of its middle, by the exact solution of the linear part."""
    a, b, c, d = tf2ss(NUM, DEN)
    ad, bd, *_ = cont2discrete((a, b, c, d), STEP_S)
    half_a, half_b, *_ = cont2discrete((a, b, c, d), STEP_S / 2)
    steps = int(round(length / STEP_S))
    current = commands[np.minimum((np.arange(steps) * STEP_S * RATE_HZ + 1e-9).astype(int), len(commands) - 1)]
    ad, bd, half_a, half_b, c = ad, bd[:, 0], half_a, half_b[:, 0], c[0]
    x, theta = np.zeros(2), np.empty(steps)
    for k in range(steps):
        theta[k] = c @ x
        middle = c @ (half_a @ x + half_b * torque(current[k], theta[k]))
        x = ad @ x + bd * torque(current[k], middle)
    return theta


def write(folder, name, length, low, high, rng):
    t_command, current = chirp(length, low, high)
    theta = simulate(current, length)
    # The camera begins a little later than the amplifier, at its own phase, and its stamps wander by some tenths of a millisecond.
    frames = 0.0123 + np.arange(int((length - 0.1) * RATE_HZ)) / RATE_HZ + rng.normal(0, 2e-4, int((length - 0.1) * RATE_HZ))
    measured = np.interp(frames, np.arange(len(theta)) * STEP_S, theta) + rng.normal(0, NOISE_RAD, len(frames))
    lost = rng.random(len(frames)) < 0.0004
    missed = rng.random(len(frames)) < 0.0008
    with open(folder / f"{name}.csv", "w", newline="") as out:
        out.write("seq,t_s,stamp_ns,theta_deg,theta_sd_deg,gap\r\n")
        gap = seq = 0
        for k, stamp in enumerate(np.round(frames * 1e9).astype(np.int64)):
            if lost[k]:
                gap += 1
                continue
            angle = "," if missed[k] else f"{np.degrees(measured[k]):.4f},{np.degrees(NOISE_RAD):.2f}"
            out.write(f"{seq},{stamp // 10**9}.{stamp % 10**9:09d},{stamp},{angle},{gap}\r\n")
            gap, seq = 0, seq + 1
    with open(folder / f"{name}_currents.csv", "w", newline="") as out:
        out.write("t_s,axial_a\r\n")
        for t, i in zip(t_command, current):
            out.write(f"{t:.6f},{i:.6f}\r\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--length", type=float, help="of all records, in place of their own")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "plant.toml").write_text(PLANT)
    rng = np.random.default_rng(20181001)
    for name, length, low, high in [
        ("training", 300, 0.5, 8),
        ("validation_1", 360, 1, 8),
        ("validation_2", 300, 0.5, 4),
    ]:
        write(args.out, name, args.length or length, low, high, rng)


if __name__ == "__main__":
    main()
