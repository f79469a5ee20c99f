#!/usr/bin/env python3
"""The catheter compared with PyElastica's Cosserat rod: one case at rest, two in motion, in a plane and with twist.

    python3 -m venv venv && venv/bin/pip install pyelastica
    venv/bin/python scripts/compare_with_pyelastica.py target/release/catoptra

A solid rod, 100 mm long, 3 mm thick, in air without weight, with a coil set at its end in a field of 3 T. PyElastica's
rod also stretches and shears, here by some ten-thousandths; ours does not. Not part of the tests: it takes a minute or
two.
"""

import csv
import itertools
import subprocess
import sys
import tempfile
from pathlib import Path

import elastica as ea
import numpy as np

LENGTH, RADIUS, DENSITY, YOUNG, SHEAR = 0.1, 1.5e-3, 1100.0, 5.0e6, 1.8e6
MOMENT = 1.125e-3  # A m² for 1 A, of coils y and z along their axes
FIELD = np.array([3.0, 0.0, 0.0])
STEP_S, END_S = 0.1, 0.6
# Currents of coils x, y and z after the step. The side coil y twists the rod about its axis.
STEPS = {"in a plane": np.array([0.0, 0.0, 0.05]), "with twist": np.array([0.0, 0.03, 0.03])}
TIP_N = np.array([2.0e-3, 1.0e-3, 0.0])

CATHETER = f"""
[tube]
outer_radius_mm = {RADIUS * 1e3}
inner_radius_mm = 0.0
flexible_mm = {LENGTH * 1e3 - 0.2}
tail_mm = 0.1
young_mpa = {YOUNG / 1e6}
shear_mpa = {SHEAR / 1e6}
density_kg_m3 = {DENSITY}
[coils]
length_mm = 0.1
moment_per_ampere_mm2 = [[0.0, 0.0, 0.0], [0.0, {MOMENT * 1e6}, 0.0], [0.0, 0.0, {MOMENT * 1e6}]]
limit_ma = 100.0
[surroundings]
b0_t = [3.0, 0.0, 0.0]
gravity_m_s2 = [0.0, 0.0, 0.0]
fluid_kg_m3 = 0.0
[motion]
damping_s = 0.0
added_mass = 0.0
drag = 0.0
linear_drag_pa_s = 0.0
"""


def ours(program, folder, name, currents, tip_n, step="0.25ms"):
    """Times and places of the tip."""
    (folder / "catheter.toml").write_text(CATHETER)
    (folder / f"{name}.csv").write_text(currents)
    force = ",".join(str(v * 1e3) for v in tip_n)
    command = [program, "catheter", "run", f"{name}.csv", "--catheter", "catheter.toml", "--rate", "200", "--step", step,
               "--duration", f"{END_S}s", f"--tip-force-mn={force}", "-o", f"{name}_run.csv"]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    with open(folder / f"{name}_run.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    time = np.array([float(row["t_s"]) for row in rows])
    tip = np.array([[float(row[f"tip_{axis}_mm"]) for axis in "xyz"] for row in rows])
    return time, tip


class Coils(ea.NoForces):
    """The couple of the coils, in the last element; `current` gives those of x, y and z at a time."""

    def __init__(self, current):
        super().__init__()
        self.current = current

    def apply_torques(self, system, time=0.0):
        frame = system.director_collection[..., -1]  # rows: d1, d2, d3
        moment = frame.T @ (MOMENT * self.current(time))
        system.external_torques[..., -1] += frame @ np.cross(moment, FIELD)


class Record(ea.CallBackBaseClass):
    def __init__(self, every, into):
        super().__init__()
        self.every, self.into = every, into

    def make_callback(self, system, time, current_step):
        if current_step % self.every == 0:
            self.into.append((time, *(system.position_collection[..., -1] * 1e3)))


class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping, ea.CallBacks):
    pass


def theirs(elements, current, tip_n, damping, end_s):
    """Times and places of the tip."""
    simulator = Simulator()
    # Its first element does not turn: the rod begins half an element before the clamp.
    length = LENGTH / (elements - 0.5)
    rod = ea.CosseratRod.straight_rod(
        elements, np.array([0.0, 0.0, -length / 2]), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]),
        LENGTH + length / 2, RADIUS, DENSITY,
        youngs_modulus=YOUNG, shear_modulus=SHEAR)
    simulator.append(rod)
    simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(Coils, current=current)
    simulator.add_forcing_to(rod).using(ea.EndpointForces, np.zeros(3), tip_n, ramp_up_time=1e-6)
    step = 0.1 * length / np.sqrt(YOUNG / DENSITY)
    if damping:
        simulator.dampen(rod).using(ea.AnalyticalLinearDamper, uniform_damping_constant=damping, time_step=step)
    kept = []
    every = max(1, round(0.005 / step))
    simulator.collect_diagnostics(rod).using(Record, every=every, into=kept)
    simulator.finalize()
    ea.integrate(ea.PositionVerlet(), simulator, end_s, round(end_s / step), progress_bar=False)
    kept = np.array(kept)
    return kept[:, 0], kept[:, 1:]


def main():
    program = str(Path(sys.argv[1]).resolve())
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        # 1. at rest under a force at the tip; theirs by damping
        _, tip = ours(program, folder, "rest", "t_s,x_a,y_a,z_a\n0,0,0,0\n", TIP_N)
        for elements in (20, 40):
            _, their_tip = theirs(elements, lambda _: np.zeros(3), TIP_N, 20.0, 2.0)
            off = np.linalg.norm(their_tip[-1] - tip[-1])
            still = np.linalg.norm(their_tip[-1] - their_tip[-20])
            print(f"at rest, {elements} elements: tip {tip[-1].round(4)} mm, theirs {their_tip[-1].round(4)} mm, "
                  f"{off:.4f} mm apart (theirs moves by {still:.1e} mm)")
        # 2. a step of the currents, without losses: ours with two steps of time, theirs with two numbers of elements
        for name, step_a in STEPS.items():
            currents = f"t_s,x_a,y_a,z_a\n{STEP_S},{','.join(map(str, step_a))}\n"
            runs = {}
            for step in ("0.5ms", "0.25ms"):
                time, runs[f"ours, {step}"] = ours(program, folder, "step", currents, np.zeros(3), step)
            for elements in (20, 40):
                after = lambda t: step_a if t >= STEP_S else np.zeros(3)
                their_time, their_tip = theirs(elements, after, np.zeros(3), 0.0, END_S)
                runs[f"theirs, {elements} elements"] = np.stack(
                    [np.interp(time, their_time, their_tip[:, k]) for k in range(3)], axis=1)
            first = next(iter(runs.values()))
            print(f"in motion {name}: the tip swings over {np.ptp(first, axis=0).max():.1f} mm in {END_S - STEP_S:.1f} s")
            inside = time <= their_time[-1]
            for (one, a), (other, b) in itertools.combinations(runs.items(), 2):
                off = np.linalg.norm(a - b, axis=1)[inside]
                print(f"  {one:<20} {other:<20} {np.sqrt(np.mean(off**2)):.2f} mm RMS, {off.max():.2f} mm at most apart")


if __name__ == "__main__":
    main()
