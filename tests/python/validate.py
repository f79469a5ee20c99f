"""Validation along a desired path, with only numpy and scipy.

    validate.py make DIR PAUSE_MS…     writes circle.csv (the path) and a simulated run <pause>ms.csv for each pause time
    validate.py check DIR RESULT       evaluates the runs of RESULT/validation.csv again and compares every number

The simulated catheter follows the commands with a first-order lag (corner 1.3 Hz), scaled by 0.96, rotated by 3 degrees
about the y axis and shifted; it is observed at 60 Hz with 0.05 mm of noise, some frames miss the tip and some are lost.
Commands begin at 1.5 s.
"""

import csv
import json
import sys
from pathlib import Path

import numpy as np

N, PERIODS, START_S, CORNER_HZ = 200, 4, 1.5, 1.3


def path():
    t = 2 * np.pi * np.arange(N) / N
    flat = np.stack([12.5 * np.cos(t), 12.5 * np.sin(t), 0 * t], axis=1)
    tilt = np.deg2rad(8)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    return flat @ turn.T + [1, -2, 95]


def make(folder, pauses_ms):
    folder.mkdir(parents=True, exist_ok=True)
    points = path()
    with open(folder / "circle.csv", "w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["x_mm", "y_mm", "z_mm"])
        out.writerows([[f"{v:.6f}" for v in p] for p in points])
    b = np.deg2rad(3)
    turn = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    centre = points.mean(axis=0)
    seen = (points - centre) * 0.96 @ turn.T + centre + [0.8, -0.5, 0.3]
    for pause_ms in pauses_ms:
        random = np.random.default_rng(int(round(pause_ms * 10)))
        pause = pause_ms * 1e-3
        end = START_S + N * PERIODS * pause
        rows, lost, seq = [], 0, 0
        stamps = np.round((0.003 + np.arange(0, end + 0.5, 1 / 60) + random.normal(0, 2e-4, len(np.arange(0, end + 0.5, 1 / 60)))) * 1e9)
        rest = seen[0]
        # The state at every command: exactly, however long the pause.
        decay = np.exp(-2 * np.pi * CORNER_HZ * pause)
        states = [rest]
        for k in range(N * PERIODS):
            states.append(seen[k % N] + (states[-1] - seen[k % N]) * decay)
        for stamp in stamps:
            if random.random() < 0.01:
                lost += 1
                continue
            t = stamp * 1e-9 - START_S
            k = int(np.floor(t / pause))
            if t < 0:
                place = rest
            elif k >= N * PERIODS:
                place = states[-1]
            else:
                place = seen[k % N] + (states[k] - seen[k % N]) * np.exp(-2 * np.pi * CORNER_HZ * (t - k * pause))
            place = place + random.normal(0, 0.05, 3)
            missed = random.random() < 0.02
            cells = ["", "", "", "", "ambiguous"] if missed else [*(f"{v:.4f}" for v in place), "0.05", "ok"]
            rows.append([seq, f"{stamp * 1e-9:.9f}", int(stamp), *cells, lost])
            seq, lost = seq + 1, 0
        with open(folder / f"{pause_ms:g}ms.csv", "w", newline="") as file:
            out = csv.writer(file)
            out.writerow("seq,t_s,stamp_ns,tip_x_mm,tip_y_mm,tip_z_mm,tip_sd_mm,tip_status,gap".split(","))
            out.writerows(rows)


def close(name, found, expected, within):
    assert abs(found - expected) <= within, f"{name}: catoptra says {found}, expected {expected} within {within}"


def points_of(run, pause, start_ns):
    """One observed point per command, NaN where there is none, and by how much its frames are later than the middle of the
    pause, in pauses; as docs/validate.md describes it."""
    from scipy.interpolate import CubicSpline

    stamps = np.array([int(row["stamp_ns"]) for row in run])
    places = np.array([[float(row[f"tip_{a}_mm"] or "nan") for a in "xyz"] for row in run])
    t = (stamps - start_ns) * 1e-9
    commands = N * PERIODS
    inside = (t >= 0) & (t < commands * pause)
    steps = np.sort(np.diff(t[inside]))
    interval = steps[len(steps) // 2]
    known = ~np.isnan(places[:, 0])
    t, places = t[known], places[known]
    points = np.full((commands, 3), np.nan)
    later = np.zeros(commands)
    if pause >= interval:
        number = np.floor(t / pause + 1e-12).astype(int)
        for k in range(commands):
            if np.any(number == k):
                points[k] = places[number == k].mean(axis=0)
                later[k] = t[number == k].mean() / pause - (k + 0.5)
    else:
        spline = CubicSpline(t, places, bc_type="natural")
        middle = (np.arange(commands) + 0.5) * pause
        after = np.searchsorted(t, middle, side="right")
        for k in range(commands):
            if 0 < after[k] < len(t) and t[after[k]] - t[after[k] - 1] < 1.5 * interval:
                points[k] = spline(middle[k])
    return points, later


def circle_radius(points):
    from scipy.optimize import least_squares

    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    flat = centred @ axes[:2].T
    start = [0, 0, np.linalg.norm(flat, axis=1).mean()]
    fit = least_squares(lambda p: np.hypot(flat[:, 0] - p[0], flat[:, 1] - p[1]) - p[2], start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return fit.x[2], np.sqrt(np.mean((centred @ axes[2]) ** 2))


def lag_points(desired, observed, numbers):
    """Peak of the correlation coefficient over circular lags, sub-sample by a cosine of the path's period."""
    y = observed - observed.mean(axis=0)
    r = []
    for lag in range(N):
        x = desired[(numbers - lag) % N]
        x = x - x.mean(axis=0)
        r.append(np.sum(x * y) / np.sqrt(np.sum(x * x) * np.sum(y * y)))
    r = np.array(r)
    k = int(np.argmax(r))
    a, b, c = r[k - 1], r[k], r[(k + 1) % N]
    w = 2 * np.pi / N
    lag = k + np.arctan((c - a) / np.sin(w) / ((2 * b - a - c) / (1 - np.cos(w)))) / w
    return lag - N if lag > N / 2 else lag


def filled(desired, points, known):
    """Missing points by a Fourier series through the others, with the harmonics that the path has."""
    power = np.sum(np.abs(np.fft.rfft(desired, axis=0)[1:51]) ** 2, axis=1)
    harmonics = 1 + int(np.flatnonzero(power >= 1e-4 * power.max())[-1])
    angle = np.outer(np.arange(len(points)), np.arange(1, harmonics + 1)) * 2 * np.pi / N
    waves = np.hstack([np.ones((len(points), 1)), np.cos(angle), np.sin(angle)])
    series = waves @ np.linalg.lstsq(waves[known], points[known], rcond=None)[0]
    return np.where(known[:, None], points, series)


def check(folder, result):
    from scipy.spatial.transform import Rotation

    desired = path().round(6)
    rows = list(csv.DictReader(open(result / "validation.csv")))
    for row, entry in zip(rows, json.load(open(result / "validation.json"))["runs"], strict=True):
        pause_ms = float(row["pause_ms"])
        close("pause in the JSON", entry["pause_ms"], pause_ms, 0)
        run = list(csv.DictReader(open(folder / f"{pause_ms:g}ms.csv")))
        points, later = (all[N:] for all in points_of(run, pause_ms * 1e-3, int(START_S * 1e9)))
        known = ~np.isnan(points[:, 0])
        numbers = np.arange(N, N * PERIODS)[known]
        observed, wanted = points[known], desired[numbers % N]
        close("points left out", int(row["points_left_out"]), int(np.sum(~known)), 0)
        close("frames missed", int(row["frames_missed"]), sum(
            1 for r in run if r["tip_status"] != "ok" and 0 <= int(r["stamp_ns"]) - START_S * 1e9 < N * PERIODS * pause_ms * 1e6), 0)
        close("unaligned", float(row["rms_unaligned_mm"]), np.sqrt(np.mean(np.sum((observed - wanted) ** 2, axis=1))), 1e-6)
        whole, everywhere = filled(desired, points, known), np.arange(N, N * PERIODS)
        a, b = observed - observed.mean(axis=0), wanted - wanted.mean(axis=0)
        rotation, rssd = Rotation.align_vectors(b, a)
        close("aligned", float(row["rms_aligned_mm"]), rssd / np.sqrt(len(a)), 1e-6)
        close("rotation", float(row["rotation_deg"]), np.rad2deg(rotation.magnitude()), 1e-5)
        for axis, name in enumerate("xyz"):
            if row[f"gain_{name}"]:
                close(f"gain {name}", float(row[f"gain_{name}"]), np.std(whole[:, axis]) / np.std(desired[everywhere % N, axis]), 1e-9)
        (radius, off_plane), (wanted_radius, _) = circle_radius(observed), circle_radius(desired)
        close("radius", float(row["observed_size_mm"]), radius, 1e-6)
        close("off the plane", float(row["plane_rms_mm"]), off_plane, 1e-6)
        close("magnitude", float(row["magnitude_db"]), 20 * np.log10(radius / wanted_radius), 1e-6)
        lag = lag_points(desired, whole, everywhere) + later[known].mean()
        close("lag", float(row["lag_ms"]), lag * pause_ms, 1e-6)
        close("phase", (float(row["phase_deg"]) + 360 * lag / N + 180) % 360 - 180, 0, 1e-6)
        print(f"{pause_ms:g} ms: {row['rms_aligned_mm']} mm, {row['magnitude_db']} dB, {row['phase_deg']} degrees agree")


if __name__ == "__main__":
    if sys.argv[1] == "make":
        make(Path(sys.argv[2]), [float(ms) for ms in sys.argv[3:]])
    else:
        check(Path(sys.argv[2]), Path(sys.argv[3]))
