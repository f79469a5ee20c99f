"""Checks the results of `catoptra identify` with numpy and scipy, and with python-control and slycot if installed.

    identify.py make DIR       writes a table of a simulated record for every case, and cases.json: name and arguments of each
    identify.py check DIR      compares DIR/<name> with independent results; prints the largest difference of each kind

The independent computations share no method with the program: coefficients and covariance by Householder QR with 64
bits of mantissa on the whole regression matrix; Hankel singular values and balanced truncation by the singular value
decomposition of the Hankel matrix of the impulse response (whose balanced realisation is Ho and Kalman's); simulations
by scipy.signal.lfilter; H(s) by scipy.linalg.logm.
"""

import csv
import json
import sys
from pathlib import Path

import numpy as np
from identify_records import cases, make
from scipy import linalg, optimize, signal

try:
    import control
    import slycot
except ImportError as error:
    control = slycot = None
    print(f"SKIPPED: the comparison with python-control and slycot ({error})", file=sys.stderr)

DB3 = 10 ** (-3 / 20)


class Differences:
    """The largest difference of each kind, as a part of what is allowed."""

    def __init__(self):
        self.all = {}
        self.failed = []

    def put(self, case, kind, found, allowed):
        found = float(found)
        if not found <= allowed:
            self.failed.append(f"{case}, {kind}: {found:.3g} where {allowed:.3g} is allowed")
        if not found <= self.all.get(kind, (-1,))[0]:
            self.all[kind] = (found, case, allowed)


def close(found, true, floor=0.0):
    """The largest relative difference; values below `floor` times the largest count as that."""
    found, true = np.asarray(found, dtype=float), np.asarray(true, dtype=float)
    if found.shape != true.shape:
        return np.inf
    scale = np.maximum(np.abs(true), floor * np.max(np.abs(true), initial=0.0))
    return np.max(np.abs(found - true) / np.where(scale > 0, scale, 1.0), initial=0.0)


def householder(matrix):
    """The upper triangle of a matrix, at 64 bits of mantissa."""
    r = np.array(matrix, dtype=np.longdouble)
    n = r.shape[1]
    for k in range(n):
        v = r[k:, k].copy()
        v[0] += np.copysign(np.sqrt(v @ v), v[0])
        v /= np.sqrt(v @ v)
        r[k:, k:] -= 2 * np.outer(v, v @ r[k:, k:])
    return np.triu(r[:n])


def regression(u, y, na, nb, nk, first):
    rows = np.arange(first, len(y))
    past = [-y[rows - i] for i in range(1, na + 1)] + [u[rows - nk - j] for j in range(nb)]
    return np.stack([*past, y[rows]], axis=1)


def least_squares(u, y, na, nb, nk, first=None):
    """Coefficients, a factor of their covariance, variance of the residual, sum of squares, rows, and numpy's coefficients."""
    first = max(na, nb + nk - 1) if first is None else first
    matrix = regression(u, y, na, nb, nk, first)
    r = householder(matrix)
    p = na + nb
    inverse = np.zeros((p, p), dtype=np.longdouble)
    for column in range(p):
        for row in range(p - 1, -1, -1):
            unit = np.longdouble(row == column)
            inverse[row, column] = (unit - r[row, row + 1 : p] @ inverse[row + 1 :, column]) / r[row, row]
    squares = r[p, p] ** 2
    variance = squares / (len(matrix) - p)
    double = np.linalg.lstsq(matrix[:, :p], matrix[:, p], rcond=None)[0]
    return inverse @ r[:p, p], inverse * np.sqrt(variance), variance, squares, len(matrix), double


def numerator(model):
    return np.concatenate([np.zeros(model["nk"]), model["b"]])


def start_fitted(b, a, u, y, most=None):
    """Simulation whose state at the beginning is that which fits best."""
    n = max(len(a), len(b)) - 1
    rest = signal.lfilter(b, a, u)
    if n == 0:
        return rest
    # Seen with the outputs of every state alone; scipy's states are those of the transposed direct form.
    free = np.stack([signal.lfilter(b, a, np.zeros(len(u)), zi=z)[0] for z in np.eye(n)], axis=1)
    reach = len(y) if most is None else min(most, len(y))
    state = np.linalg.lstsq(free[:reach], (y - rest)[:reach], rcond=1e-12)[0]
    return rest + free @ state


def error_percent(y, modelled):
    return 100 * np.sum((y - modelled) ** 2) / np.sum(y**2)


def fit_percent(y, modelled):
    return 100 * (1 - np.linalg.norm(y - modelled) / np.linalg.norm(y - y.mean()))


def balanced(b, a):
    """Balanced realisation by the Hankel matrix of the impulse response: A, b, c, d, singular values. None when it rings too long."""
    poles = np.roots(a) if len(a) > 1 else np.zeros(0)
    largest = np.max(np.abs(poles), initial=0.0)
    length = 40 if largest == 0 else int(np.ceil(np.log(1e-14) / np.log(largest))) + 40 if largest < 1 else None
    if length is None or length > 2600:
        return None
    impulse = signal.lfilter(b, a, np.eye(1, 2 * length + 1)[0])
    hankel = linalg.hankel(impulse[1 : length + 1], impulse[length : 2 * length])
    shifted = linalg.hankel(impulse[2 : length + 2], impulse[length + 1 : 2 * length + 1])
    u, s, v = np.linalg.svd(hankel)
    n = max(len(a), len(b)) - 1
    n = int(np.sum(s[:n] > 1e-11 * s[0]))
    left, right, root = u[:, :n], v[:n], np.sqrt(s[:n])
    state = left.T @ shifted @ right.T / np.outer(root, root)
    return state, root * right[:, 0], left[0] * root, impulse[0], s[:n]


def reduced(realisation, order, match_dc):
    a, b, c, d, _ = realisation
    keep, gone = slice(0, order), slice(order, len(b))
    if not match_dc:
        return a[keep, keep], b[keep], c[keep], d
    settled = np.linalg.inv(np.eye(len(b) - order) - a[gone, gone])
    return (
        a[keep, keep] + a[keep, gone] @ settled @ a[gone, keep],
        b[keep] + a[keep, gone] @ settled @ b[gone],
        c[keep] + c[gone] @ settled @ a[gone, keep],
        d + c[gone] @ settled @ b[gone],
    )


def response(system, z):
    a, b, c, d = system
    return np.array([c @ np.linalg.solve(p * np.eye(len(b)) - a, b) + d for p in z])


def companion(num, den):
    """Controllable companion form of polynomials of the same length."""
    n = len(den) - 1
    a = np.zeros((n, n))
    a[0] = -np.asarray(den[1:])
    a[1:, :-1] += np.eye(n - 1)
    b = np.zeros(n)
    b[0] = 1
    return a, b, np.asarray(num[1:]) - num[0] * np.asarray(den[1:]), num[0]


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def column(rows, name):
    return np.array([float(row[name] or "nan") for row in rows])


def detrended(u, y, how, period, train):
    t = np.arange(len(u)) * period
    if how == "none":
        return u, y
    degree = {"mean": 0, "linear": 1}[how]
    out = []
    for v in (u, y):
        line = np.polynomial.Polynomial.fit(t[train], v[train], degree)
        out.append(v - line(t))
    return out


def check_least_squares(case, model, u, y, put):
    arx = model["arx"]
    na, nb, nk = arx["na"], arx["nb"], arx["nk"]
    true, factor, variance, _, rows, double = least_squares(u, y, na, nb, nk)
    covariance = factor @ factor.T
    found = np.array(arx["a"][1:] + arx["b"])
    exact = variance < 1e-20 * np.mean(y**2)
    if arx["condition"] < 1e6:
        put("ARX coefficients", close(found, true), 1e-6)
        put("ARX coefficients, numpy.linalg.lstsq", close(found, double), 1e-6)
    else:
        # No method with 53 bits has more digits than the condition leaves; normal equations, which square it, would have none.
        put("ARX coefficients, of what a condition above 1e6 leaves", close(found, true) / (2.2e-16 * arx["condition"]), 10)
        put("the same, of the largest coefficient", np.max(np.abs(found - true)) / np.max(np.abs(true)), 1e-6)
    put("samples", abs(arx["samples"] - rows), 0)
    if not exact:
        put("ARX covariance", close(arx["covariance"], covariance, 1e-6), 1e-6)
        put("standard errors", close(arx["standard_errors"], np.sqrt(np.diag(covariance).astype(float))), 1e-6)
        put("noise variance", close(arx["noise_variance"], variance), 1e-6)


def check_fits(case, model, records, put):
    models = {"full": model["full"] or model["arx"], "reduced": model["reduced"], "refined": model["refined"]}
    for fit in model["fits"]:
        u, y = records[fit["role"]]
        which = models[fit["model"]]
        if "num_z" in which:
            b, a = np.array(which["num_z"]), np.array(which["den_z"])
        else:
            b, a = numerator(which), np.array(which["a"])
        if fit["kind"] == "prediction":
            memory = max(len(a), len(b)) - 1
            # A y = B u + e.
            modelled = (signal.lfilter(b, [1.0], u) - signal.lfilter(a, [1.0], y) + y)[memory:]
            y = y[memory:]
        elif fit["kind"] == "simulation":
            modelled = signal.lfilter(b, a, u)
            if control is not None and len(y) <= 1024:
                n = max(len(a), len(b))
                pad = [np.concatenate([v, np.zeros(n - len(v))]) for v in (b, a)]
                states = companion(*pad)
                other = control.forced_response(control.ss(states[0], states[1][:, None], states[2][None, :], states[3], True), U=u).outputs
                put("simulation, python-control", abs(error_percent(y, other) - fit["error_percent"]), 0.01)
        else:
            modelled = start_fitted(b, a, u, y, 1024)
        put(f"{fit['kind']} error, points", abs(error_percent(y, modelled) - fit["error_percent"]), 0.01)
        put(f"{fit['kind']} fit, points", abs(fit_percent(y, modelled) - fit["fit_percent"]), 0.01)
        put("rms", close(fit["rms"], np.sqrt(np.mean((y - modelled) ** 2)), 0) if np.std(y - modelled) > 1e-9 * np.std(y) else 0, 1e-4)


def check_reduction(case, model, match_dc, put):
    full = model["full"] or model["arx"]
    # Samples of delay beyond the first are no states.
    late = max(full["nk"] - 1, 0)
    b, a = numerator({**full, "nk": full["nk"] - late}), np.array(full["a"])
    n = max(len(a), len(b))
    b, a = (np.concatenate([v, np.zeros(n - len(v))]) for v in (b, a))
    found = model["reduced"]
    z = np.exp(1j * np.linspace(0, np.pi, 200))
    ours = np.polyval(found["num_z"], z) / np.polyval(found["den_z"], z) * z**late
    realisation = balanced(b, a)
    values = np.array(model["hankel_singular_values"])
    put("number of Hankel singular values", abs(len(values) - (n - 1)), 0)
    peak = np.max(np.abs(np.polyval(b, z) / np.polyval(a, z)))
    if realisation is not None:
        # The decomposition of a large matrix has errors of 1e-15 of the largest value.
        sure = realisation[4][: n - 1] > 1e-8 * realisation[4][0]
        put("Hankel singular values", close(values[: len(sure)][sure], realisation[4][sure]), 1e-6)
        if np.all(sure[: found["order"]]):
            true = response(reduced(realisation, found["order"], match_dc), z)
            put("reduced model, of its peak", np.max(np.abs(ours - true)) / peak, 1e-6)
    # slycot 0.7.1 crashes where there are poles at 0.
    if slycot is not None and a[-1] != 0:
        system = companion(b, a)
        args = (system[0], system[1][:, None], system[2][None, :])
        for job in "BN":
            order, *kept, hsv = slycot.ab09ad("D", job, "N", n - 1, 1, 1, *args, nr=found["order"])
            sure = hsv > 1e-8 * hsv[0]
            put("Hankel singular values, slycot", close(values[sure], hsv[sure]), 1e-6)
            if not match_dc and order == found["order"]:
                true = response((kept[0][:order, :order], kept[1][:order, 0], kept[2][0, :order], system[3]), z)
                put("reduced model, slycot", np.max(np.abs(ours - true)) / peak, 1e-6)
        if match_dc:
            # Its own routine for this, ab09bd, crashes in 0.7.1: balanced by slycot, the rest by hand.
            order, *kept, hsv = slycot.ab09ad("D", "B", "N", n - 1, 1, 1, *args, nr=n - 1)
            whole = (kept[0][:order, :order], kept[1][:order, 0], kept[2][0, :order], system[3], hsv)
            true = response(reduced(whole, found["order"], True), z)
            put("reduced model with the gain kept, slycot", np.max(np.abs(ours - true)) / peak, 1e-6)
    if match_dc:
        put("gain kept", abs(ours[0] / (np.sum(b) / np.sum(a)) - 1), 1e-9)


def check_continuous(case, which, found, period, put):
    """H(s) by the matrix logarithm of someone else."""
    num, den = np.array(which["num_z"]), np.array(which["den_z"])
    if found is None:
        return
    extra = int(round(found["delay_s"] / period))
    # Whole samples of delay beyond the first are no states: they are leading zeros of the numerator, roots at 0 of the denominator.
    if extra and not np.all(den[-extra:] == 0):
        raise SystemExit(f"{case}: a delay of {extra} samples that the model does not have")
    if extra:
        num, den = num[extra:], den[:-extra]
    a, b, c, d = companion(num, den)
    n = len(b)
    omega = np.geomspace(1e-3, 1, 60) * np.pi / period
    ours = np.polyval(found["num"], 1j * omega) / np.polyval(found["den"], 1j * omega)
    poles = np.linalg.eigvals(a)
    held = not np.any((np.abs(poles.imag) <= 1e-12) & (poles.real <= 0))
    put("how it was made continuous", found["conversion"] != ("zero_order_hold" if held else "tustin"), 0)
    if held:
        step = np.eye(n + 1)
        step[:n, :n], step[:n, n] = a, b
        generator = linalg.logm(step).real / period
        true = response((generator[:n, :n], generator[:n, n], c, d), 1j * omega)
        put("denominator of H(s)", close(found["den"], np.poly(generator[:n, :n]).real, 1e-9), 1e-6)
        if control is not None and extra == 0:
            top = found["num"]
            back = control.sample_system(control.tf(top, found["den"]), period, "zoh")
            z = np.exp(1j * omega[:-1] * period)
            at = np.polyval(num, z) / np.polyval(den, z)
            put("H(s) sampled by python-control", np.max(np.abs(back(z) - at)) / np.max(np.abs(at)), 1e-6)
    else:
        z = (2 / period + 1j * omega) / (2 / period - 1j * omega)
        true = np.polyval(num, z) / np.polyval(den, z)
    put("H(s), of its largest", np.max(np.abs(ours - true)) / np.max(np.abs(true)), 1e-6)


def check_bandwidths(case, model, put):
    for estimate in model["bandwidths"]:
        if estimate["definition"] != "minus_3db_re_dc" or estimate["model"] == "full" or estimate["frequency_hz"] is None:
            continue
        h = model[estimate["model"]]["continuous"]
        if h is None or h["conversion"] == "tustin":
            continue
        gain = lambda w: abs(np.polyval(h["num"], 1j * w) / np.polyval(h["den"], 1j * w)) / abs(h["num"][-1] / h["den"][-1])
        grid = np.geomspace(1e-6, 1, 200_000) * 2 * np.pi * model["nyquist_hz"]
        first = np.argmax(gain(grid) < DB3)
        true = optimize.brentq(lambda w: gain(w) - DB3, grid[first - 1], grid[first], xtol=1e-15, rtol=1e-12)
        put("bandwidth", close(estimate["frequency_hz"], true / (2 * np.pi)), 1e-6)
        if control is not None:
            theirs = control.bandwidth(control.tf(h["num"], h["den"])) / (2 * np.pi)
            put("bandwidth, python-control", close(estimate["frequency_hz"], theirs), 1e-4)


def check_spectrum(case, folder, model, u, y, put):
    rows = read(folder / "frequency_response.csv")
    f = column(rows, "frequency_hz")
    rate = 1 / model["period_s"]
    length = 2 * len(f)
    how = {"fs": rate, "window": "hann", "nperseg": length, "noverlap": length // 2, "detrend": "constant"}
    freq, cross = signal.csd(u, y, **how)
    _, power = signal.welch(u, **how)
    _, coherence = signal.coherence(u, y, **how)
    true = (cross / power)[1:]
    put("frequencies of the spectrum", close(f, freq[1:]), 1e-9)
    put("response without a model", close(column(rows, "magnitude"), np.abs(true), 1e-6), 1e-6)
    phase = np.exp(1j * np.deg2rad(column(rows, "phase_deg")))
    put("its phase, radians", np.max(np.abs(phase - true / np.abs(true))), 1e-6)
    put("coherence", np.max(np.abs(column(rows, "coherence") - coherence[1:])), 1e-6)


def check_curves(case, folder, model, u, y, put):
    full = model["full"] or model["arx"]
    rows = [row for row in read(folder / "bode.csv") if row["model"] == "full"]
    f = column(rows, "frequency_hz")
    _, h = signal.freqz(numerator(full), full["a"], worN=f, fs=1 / model["period_s"], include_nyquist=True)
    put("Bode magnitude", close(column(rows, "magnitude"), np.abs(h)), 1e-6)
    phase = np.exp(1j * np.deg2rad(column(rows, "phase_deg")))
    put("Bode phase, radians", np.max(np.abs(phase - h / np.abs(h))), 1e-6)
    # σ of ln|B/A| and of the phase to first order, from the derivatives by hand.
    if model["arx"]["noise_variance"] < 1e-20 or model["full"] is not None:
        return
    z = np.exp(-2j * np.pi * f * model["period_s"]).astype(np.clongdouble)
    na, nb, nk = full["na"], full["nb"], full["nk"]
    a, b = (sum(c * z**k for k, c in enumerate(full[name])) for name in "ab")
    slope = np.stack([-(z ** (i + 1)) / a for i in range(na)] + [z**j / b for j in range(nb)], axis=1)
    # By the factor: in the covariance itself nothing is left of what is known best.
    moved = slope @ least_squares(u, y, na, nb, nk)[1]
    for name, part, unit in (("magnitude_db_sd", moved.real, 20 / np.log(10)), ("phase_deg_sd", moved.imag, 180 / np.pi)):
        sd = np.sqrt(np.sum(part**2, axis=1)).astype(float)
        linear = (np.sqrt(np.sum(np.abs(moved) ** 2, axis=1)) < 0.1) & (sd > 1e-9)
        put(f"σ of the Bode plot, {name}", close(column(rows, name)[linear] / unit, sd[linear]), 2e-2)


def check_residuals(case, folder, model, u, y, put):
    full = model["full"] or model["arx"]
    b, a = numerator(full), np.array(full["a"])
    memory = max(len(a), len(b)) - 1
    # Of a model with noise at the output, what its simulation leaves.
    simulated = y - signal.lfilter(b, a, u)
    e = simulated[memory:] if model["full"] else (signal.lfilter(a, [1.0], y) - signal.lfilter(b, [1.0], u))[memory:]
    if np.std(e) < 1e-9 * np.std(y):
        return
    rows = read(folder / "residuals.csv")
    lags = column(rows, "lag").astype(int)
    u = u[memory:] - u[memory:].mean()
    cross = np.correlate(e, u, "full")[lags + len(u) - 1] / np.sqrt(np.sum(e**2) * np.sum(u**2))
    auto = np.correlate(e, e, "full")[len(e) - 1 :][lags[lags >= 0]] / np.sum(e**2)
    put("residual correlations", np.max(np.abs(column(rows, "autocorrelation")[lags >= 0] - auto)), 1e-6)
    put("input-residual correlations", np.max(np.abs(column(rows, "input_correlation") - cross)), 1e-6)


def check_orders(case, folder, model, records, put):
    rows = read(folder / "orders.csv")
    u, y = records["training"]
    largest = max(max(int(r["na"]), int(r["nb"]) + int(r["nk"]) - 1) for r in rows)
    put("models searched", abs(len(rows) - model["search"]["models"]), 0)
    test_u, test_y = records["validation"]
    for row in rows:
        na, nb, nk = (int(row[k]) for k in ("na", "nb", "nk"))
        found, _, _, squares, n, _ = least_squares(u, y, na, nb, nk, largest)
        loss = float(squares) / n
        put("loss of the models searched", close(float(row["loss"]), loss), 1e-9)
        put("AIC", abs(float(row["aic"]) - (np.log(loss) + 2 * (na + nb) / n)), 1e-9)
        put("MDL", abs(float(row["mdl"]) - (np.log(loss) + (na + nb) * np.log(n) / n)), 1e-9)
        a, b = np.concatenate([[1.0], found[:na].astype(float)]), np.concatenate([np.zeros(nk), found[na:].astype(float)])
        put("largest pole", close(float(row["largest_pole"]), np.max(np.abs(np.roots(a)))), 1e-6)
        memory = max(na, nb + nk - 1)
        predicted = (signal.lfilter(b, [1.0], test_u) - signal.lfilter(a, [1.0], test_y) + test_y)[memory:]
        put("prediction of the models searched, points", abs(float(row["prediction_error_percent"]) - error_percent(test_y[memory:], predicted)), 0.01)


def check_output_error(case, model, u, y, put):
    """Nothing nearer to the output lies where scipy goes from there."""
    found = model["refined"] if model["full"] is None else model["full"]
    if "num_z" in found:
        b, a = np.array(found["num_z"]), np.array(found["den_z"])
        nk = int(np.argmax(b != 0))
        nb, na = len(np.trim_zeros(b[nk:], "b")), len(np.trim_zeros(a[1:], "b"))
        start = np.concatenate([a[1 : na + 1], b[nk : nk + nb]])
    else:
        na, nb, nk = found["na"], found["nb"], found["nk"]
        start = np.array(found["a"][1:] + found["b"])
    scale = np.maximum(np.abs(start), 1e-3 * np.max(np.abs(start)))

    def left(p):
        p = p * scale
        return y - signal.lfilter(np.concatenate([np.zeros(nk), p[na:]]), np.concatenate([[1.0], p[:na]]), u)

    best = optimize.least_squares(left, start / scale, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    mine = np.sum(left(start / scale) ** 2)
    put("sum of squares of output error above scipy's", mine / (2 * best.cost) - 1, 1e-9)
    if found is model["full"]:
        variance = mine / (len(y) - na - nb)
        covariance = variance * np.linalg.inv(best.jac.T @ best.jac) * np.outer(scale, scale)
        put("covariance of output error", close(found["covariance"], covariance, 1e-3), 1e-3)


def check(folder):
    found = Differences()
    made = {case["name"]: case for case in cases()}
    for told in json.loads((folder / "cases.json").read_text()):
        name, case = told["name"], made[told["name"]]
        put = lambda kind, value, allowed: found.put(name, kind, value, allowed)
        model = json.loads((folder / name / "model.json").read_text())
        args = case["args"]
        option = lambda key, default: args[args.index(key) + 1] if key in args else default
        part = lambda key: slice(*map(int, option(key, f"0:{len(case['u'])}").split(":")))
        u, y = detrended(case["u"], case["y"], option("--detrend", "none"), case["period"], part("--train"))
        records = {"training": (u[part("--train")], y[part("--train")]), "validation": (u[part("--test")], y[part("--test")])}
        put("period", close(model["period_s"], case["period"]), 1e-9)
        check_least_squares(name, model, *records["training"], put)
        check_fits(name, model, records, put)
        check_reduction(name, model, "--match-dc" in args, put)
        check_continuous(name, model["reduced"], model["reduced"]["continuous"], case["period"], put)
        check_continuous(name, model["refined"], model["refined"]["continuous"], case["period"], put)
        check_bandwidths(name, model, put)
        check_spectrum(name, folder / name, model, *records["training"], put)
        check_curves(name, folder / name, model, *records["training"], put)
        check_residuals(name, folder / name, model, *records["training"], put)
        if model["search"] is not None:
            check_orders(name, folder / name, model, records, put)
        if option("--estimator", "arx") == "oe":
            check_output_error(name, model, *records["training"], put)
    for kind, (value, name, allowed) in found.all.items():
        print(f"{kind:<58} {value:9.2e} ({name}; {allowed:g} allowed)")
    if found.failed:
        raise SystemExit("\n".join(found.failed))


if __name__ == "__main__":
    {"make": make, "check": check}[sys.argv[1]](Path(sys.argv[2]))
