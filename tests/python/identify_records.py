"""Simulated records for identify.py, as tables: several orders, delays and rates, noise on and off, with and without header."""

import json

import numpy as np
from scipy import signal


def poly(*poles):
    """Monic polynomial of real poles and of (modulus, angle) pairs."""
    out = np.ones(1)
    for pole in poles:
        out = np.convolve(out, [1, -2 * pole[0] * np.cos(pole[1]), pole[0] ** 2] if isinstance(pole, tuple) else [1, -pole])
    return out


def slow_plant(u, rate_hz):
    """The paper's Eq. 7 with its input held."""
    num, den, _ = signal.cont2discrete(([17610.0, 6344.0], [1, 4.59, 1.136]), 1 / rate_hz)
    return signal.lfilter(num[0], den, u)


def chirp(n, rate_hz, low, high):
    t = np.arange(n) / rate_hz
    return signal.chirp(t, low, t[-1], high)


def prbs(random, n, hold):
    return np.repeat(random.choice([-1.0, 1.0], n // hold + 1), hold)[:n]


def cases():
    """Name, u, y, period and arguments of each."""
    def random(name):
        return np.random.default_rng(list(name.encode()))

    def arx(name, a, b, nk, u, sd):
        b = np.concatenate([np.zeros(nk), b])
        return signal.lfilter(b, a, u) + signal.lfilter([1.0], a, sd * random(name + "e").normal(size=len(u)))

    def case(name, u, y, period, *args):
        return {"name": name, "u": u, "y": y, "period": period, "args": [str(a) for a in args]}

    # A flexible arm: two lightly damped modes at 500 Hz, half of it kept to judge by.
    u = chirp(1024, 500, 1, 200) + 0.1 * random("arm").normal(size=1024)
    y = arx("arm", poly((0.97, 0.5), (0.95, 1.3)), [0.3, -0.2, 0.1, 0.05], 1, u, 0.02)
    yield case("arm", u, y, 0.002, "--na", 4, "--nb", 4, "--nk", 1, "--train", "0:512", "--test", "512:1024", "--reduce", 4)
    yield case("arm_dc", u, y, 0.002, "--na", 6, "--nb", 5, "--nk", 1, "--reduce", 4, "--match-dc", "--start", "estimated")
    # A heating system: slow, off centre, two samples of delay, every 2 s.
    u = 5 + 2 * prbs(random("heater"), 801, 20)
    y = 60 + arx("heater", poly(0.97, 0.8), [0.02, 0.015], 2, u - 5, 0.05)
    yield case("heater", u, y, 2.0, "--na", 2, "--nb", 2, "--nk", 2, "--detrend", "mean", "--train", "0:500", "--test", "500:801")
    # Input acts at once; 12 Hz.
    u = random("direct").normal(size=4000)
    y = arx("direct", poly(0.6, (0.8, 1.0)), [0.5, 0.2, 0.3, -0.4], 0, u, 0.3)
    yield case("direct", u, y, 1 / 12, "--na", 3, "--nb", 4, "--nk", 0, "--detrend", "linear")
    # Short and noisy.
    u = prbs(random("short"), 300, 3)
    y = arx("short", poly((0.9, 0.3)), [1.0, 0.5], 1, u, 0.4)
    yield case("short", u, y, 0.02, "--na", 3, "--nb", 3, "--nk", 1, "--start", "estimated")
    # No noise: the system itself.
    u = random("exact").normal(size=500)
    y = arx("exact", poly(0.9, 0.5, -0.3, (0.85, 0.7)), [1.0, 0.3, -0.2, 0.4, 0.1], 1, u, 0.0)
    yield case("exact", u, y, 0.01, "--na", 5, "--nb", 5, "--nk", 1, "--reduce", 3)
    # Only a moving sum, late.
    u = random("fir").normal(size=600)
    y = arx("fir", [1.0], [0.1, 0.5, 1.0, 0.6, 0.3, 0.1, -0.2, 0.05], 3, u, 0.05)
    yield case("fir", u, y, 0.05, "--na", 0, "--nb", 8, "--nk", 3, "--reduce", 6)
    # More inputs than outputs, five samples late.
    u = random("late").normal(size=1500)
    y = arx("late", poly((0.9, 0.4)), [0.2, 0.6, 0.4, 0.1, -0.1], 5, u, 0.1)
    yield case("late", u, y, 0.01, "--na", 2, "--nb", 5, "--nk", 5, "--reduce", 3)
    # Hardly damped.
    u = random("ringing").normal(size=4000)
    y = arx("ringing", poly((0.999, 0.2), (0.997, 0.9)), [0.01, 0.02, -0.01, 0.005], 1, u, 0.01)
    yield case("ringing", u, y, 0.005, "--na", 4, "--nb", 4, "--nk", 1)
    # The paper's: order 15 of a slow plant, seen with noise.
    u = 0.1 * chirp(18000, 60, 0.5, 8)
    y = slow_plant(u, 60)
    y = y + 1e-4 * np.std(y) * random("paper").normal(size=len(y))
    yield case("paper", u, y, 1 / 60, "--order", 15, "--nk", 1)
    # The same of order 15 with next to no noise: regressors that nearly depend on each other.
    y = slow_plant(u, 60)
    y = y + 1e-7 * np.std(y) * random("nearly").normal(size=len(y))
    yield case("nearly", u, y, 1 / 60, "--na", 6, "--nb", 6, "--nk", 1)
    # Searched; the table has a header and times.
    u = random("search").normal(size=2000)
    y = arx("search", poly(0.7, (0.9, 0.8)), [0.4, 0.2, 0.1], 2, u, 0.2)
    yield case("search", u, y, 0.04, "--order", "1:6", "--nk", "0:3", "--train", "0:1200", "--test", "1200:2000")
    # Noise on the output, refined.
    u = prbs(random("noisy"), 3000, 5)
    y = signal.lfilter([0, 0.05, 0.04], poly(0.95, 0.7), u)
    y = y + 0.05 * np.std(y) * random("noisy e").normal(size=len(y))
    yield case("noisy", u, y, 1 / 60, "--na", 2, "--nb", 2, "--nk", 1, "--estimator", "oe")


HEADERS = {"search", "late", "arm_dc"}


def make(folder):
    folder.mkdir(parents=True, exist_ok=True)
    told = []
    for case in cases():
        table = folder / f"{case['name']}.csv"
        header = case["name"] in HEADERS
        with open(table, "w") as file:
            if header:
                file.write("t,u,y\n")
            for k, (u, y) in enumerate(zip(case["u"], case["y"])):
                t = repr(float(k * case["period"]))
                file.write((f"{t},{u!r},{y!r}\n" if header else f"{u!r} {y!r}\n").replace("np.float64(", "").replace(")", ""))
        columns = ["--input", "u", "--output", "y", "--time", "t"] if header else ["--input", "1", "--output", "2", "--period", repr(case["period"])]
        told.append({"name": case["name"], "args": [table.name, *columns, *case["args"], "--all-frequencies", "--bootstrap", "0", "-o", case["name"]]})
    (folder / "cases.json").write_text(json.dumps(told))
