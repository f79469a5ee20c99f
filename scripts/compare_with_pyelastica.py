#!/usr/bin/env python3
"""The catheter in motion beside PyElastica's Cosserat rod: one case at rest, one in motion.

    python3 -m venv venv && venv/bin/pip install pyelastica
    venv/bin/python scripts/compare_with_pyelastica.py target/release/catoptra

A solid rod, 100 mm long, 3 mm thick, in air without weight, with a coil set at its end in a field of 3 T. PyElastica's rod also
stretches and shears, by some ten-thousandths here; ours does not. Not part of the tests: it takes a minute or two.
"""

import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import elastica as ea
import numpy as np

LENGTH, RADIUS, DENSITY, YOUNG, SHEAR = 0.1, 1.5e-3, 1100.0, 5.0e6, 1.8e6
MOMENT = np.array([0.0, 0.0, 1.125e-3])  # A m² for 1 A in coil z
FIELD = np.array([3.0, 0.0, 0.0])
STEP_A, STEP_S, END_S = 0.05, 0.1, 0.6
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
moment_per_ampere_mm2 = [[0.0, 0.0, 0.0], [0.0, {MOMENT[1] * 1e6}, 0.0], [0.0, 0.0, {MOMENT[2] * 1e6}]]
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


def ours(program, folder, name, currents, tip_n):
    """Times and places of the tip."""
    (folder / "catheter.toml").write_text(CATHETER)
    (folder / f"{name}.csv").write_text(currents)
    force = ",".join(str(v * 1e3) for v in tip_n)
    command = [program, "catheter", "run", f"{name}.csv", "--catheter", "catheter.toml", "--rate", "200", "--step", "0.5ms",
               "--duration", f"{END_S}s", f"--tip-force-mn={force}", "-o", f"{name}_run.csv"]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    with open(folder / f"{name}_run.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    time = np.array([float(row["t_s"]) for row in rows])
    tip = np.array([[float(row[f"tip_{axis}_mm"]) for axis in "xyz"] for row in rows])
    return time, tip


class Coils(ea.NoForces):
    """The couple of the coils, in the last element, from a time on."""

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
            _, their_tip = theirs(elements, lambda _: 0.0, TIP_N, 20.0, 2.0)
            off = np.linalg.norm(their_tip[-1] - tip[-1])
            still = np.linalg.norm(their_tip[-1] - their_tip[-20])
            print(f"at rest, {elements} elements: tip {tip[-1].round(4)} mm, theirs {their_tip[-1].round(4)} mm, "
                  f"{off:.4f} mm apart (theirs moves by {still:.1e} mm)")
        # 2. a step of the axial coil's current, without losses, in a plane
        time, tip = ours(program, folder, "step", f"t_s,x_a,y_a,z_a\n{STEP_S},0,0,{STEP_A}\n", np.zeros(3))
        for elements in (20, 40):
            their_time, their_tip = theirs(elements, lambda t: STEP_A if t >= STEP_S else 0.0, np.zeros(3), 0.0, END_S)
            there = np.stack([np.interp(time, their_time, their_tip[:, k]) for k in range(3)], axis=1)
            size = np.ptp(tip, axis=0).max()
            inside = time <= their_time[-1]
            off = np.linalg.norm(tip - there, axis=1)[inside]
            rms = np.sqrt(np.mean(off ** 2))
            print(f"in motion, {elements} elements: the tip swings over {size:.2f} mm; apart by {rms:.3f} mm RMS, "
                  f"{off.max():.3f} mm at most, over {END_S - STEP_S:.1f} s")


if __name__ == "__main__":
    main()
