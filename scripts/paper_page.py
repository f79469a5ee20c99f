"""The page of `scripts/paper.py`: Tables I and II and Figs. 8 to 13 of the paper from the simulated experiment, beside what
the paper has, with the reason for each difference. Style and plotting library are those of the pages of `catoptra`, taken
from one that the experiment has written.
"""

import csv
import html
import json
import math
import re

POINTS = 200  # of a path
INK, QUIET, GRID, CURVE, PAPER = "#24292f", "#6b7280", "#e8eaed", "rgb(0,92,148)", "rgb(196,78,20)"
BANDS = {"base": "rgb(176,132,0)", "coil": "rgb(24,128,56)", "tip": "rgb(26,82,204)"}


# ---- the page ---------------------------------------------------------------------------------------------------------

def shell(page):
    """What is before and behind the body of a page of `catoptra`."""
    text = page.read_text()
    begin, end = text.index("<main>\n") + len("<main>\n"), text.index("<noscript>")
    head = re.sub(r"<title>.*?</title>", "<title>The paper's experiment, simulated</title>", text[:begin], flags=re.S)
    return head, text[end:]


def axis(title, **more):
    font = {"size": 13, "color": QUIET}
    own = {"title": {"text": title, "font": font}, "tickfont": {"size": 12, "color": QUIET}, "gridcolor": GRID}
    return {**own, "zerolinecolor": "#b6bbc2", "zerolinewidth": 1, **more}


def figure(name, traces, height=420, **layout):
    """A plot as the pages of `catoptra` have them."""
    look = {
        "autosize": True,
        "font": {"size": 13, "color": INK},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "margin": {"l": 64, "r": 16, "t": 28, "b": 44},
        "hovermode": "closest",
        "legend": {"orientation": "h", "x": 0.0, "y": 1.02, "yanchor": "bottom"},
        **layout,
    }
    config = {"responsive": True, "displaylogo": False, "displayModeBar": "hover"}
    data = json.dumps({"data": traces, "layout": look, "config": config}).replace("</", "<\\/")
    script = f'<script type="text/javascript">{{const p = {data}; Plotly.newPlot("{name}", p);}}</script>'
    return f'<div class="plot" style="height:{height}px"><div id="{name}" class="plotly-graph-div" style="height:100%; width:100%;"></div>{script}</div>\n'


def table(head, rows, words=1):
    row = lambda tag, cells: "".join(
        f'<{tag}{" class=" + chr(34) + "text" + chr(34) if k < words else ""}>{html.escape(str(cell))}</{tag}>' for k, cell in enumerate(cells)
    )
    body = "".join(f"<tr>{row('td', cells)}</tr>\n" for cells in rows)
    return f'<div class="scroll"><table>\n<thead><tr>{row("th", head)}</tr></thead>\n<tbody>\n{body}</tbody></table></div>\n'


def words(*paragraphs):
    return "".join(f"<p>{html.escape(text)}</p>\n" for text in paragraphs)


# ---- what the experiment has written ------------------------------------------------------------------------------------

def columns(path, *names):
    """Columns of a table as numbers, None where there is none; rows without any of them are left out."""
    found = [[] for _ in names]
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            values = [float(row[name]) if row.get(name) else None for name in names]
            for column, value in zip(found, values):
                column.append(value)
    return found


def rounded(values, digits=3):
    return [None if value is None else round(value, digits) for value in values]


def scatter(x, y, name, colour, mode="lines", **more):
    own = {"type": "scatter", "x": rounded(x, 4), "y": rounded(y, 4), "name": name, "mode": mode}
    return {**own, "line": {"color": colour, "width": 1.6}, "marker": {"color": colour, "size": 6}, **more}


def space(points, name, colour, mode="markers", size=2):
    x, y, z = (rounded(axis) for axis in points)
    own = {"type": "scatter3d", "x": x, "y": y, "z": z, "name": name, "mode": mode}
    return {**own, "marker": {"color": colour, "size": size}, "line": {"color": colour, "width": 4}}


def cube(titles, away):
    """Axes of equal scale, seen from `away` times the usual distance."""
    titled = {f"{name}axis": axis(title) for name, title in zip("xyz", titles)}
    eye = {name: 1.25 * away for name in "xyz"}
    return {"scene": {**titled, "aspectmode": "data", "camera": {"up": {"x": 0, "y": 0, "z": -1}, "eye": eye}}}


def marker(path, name):
    return columns(path, *(f"{name}_{axis}_mm" for axis in "xyz"))


# ---- planes and circles, as section IV.C of the paper has them ------------------------------------------------------------

def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def plane(points):
    """Mean and two directions of the plane nearest to the points: the directions in which they spread most."""
    mean = [sum(p[k] for p in points) / len(points) for k in range(3)]
    off = [[p[k] - mean[k] for k in range(3)] for p in points]
    matrix = [[sum(o[i] * o[j] for o in off) for j in range(3)] for i in range(3)]
    directions = []
    for begin in ([1.0, 0.3, 0.1], [0.2, 1.0, 0.4]):
        for _ in range(500):
            for known in directions:
                part = dot(begin, known)
                begin = [b - part * k for b, k in zip(begin, known)]
            begin = [dot(row, begin) for row in matrix]
            length = math.sqrt(dot(begin, begin))
            begin = [b / length for b in begin]
        directions.append(begin)
    return mean, directions


def circle(points):
    """Centre and radius of the circle nearest to points of a plane, by Newton's steps from their mean."""
    x, y = (sum(p[k] for p in points) / len(points) for k in range(2))
    for _ in range(100):
        away = [(math.hypot(p[0] - x, p[1] - y), p) for p in points]
        radius = sum(d for d, _ in away) / len(away)
        x += sum((d - radius) * (p[0] - x) / d for d, p in away if d > 0) * 2 / len(away)
        y += sum((d - radius) * (p[1] - y) / d for d, p in away if d > 0) * 2 / len(away)
    return (x, y), radius


# ---- figures ----------------------------------------------------------------------------------------------------------

def figure_8(out, tracked):
    """A tracked picture, as the report of the run shows it."""
    text = (
        "The paper shows a picture of its camera with the bands that were found. Here the bench of docs/rigs/paper_bench.toml is "
        "rendered and tracked: the direct view on the left, along B0, and the mirror's, in which the deflection shows. The scanner, "
        "the clamp of bricks and the tank's edges are not rendered; outlines are drawn by the tracker, the paper's green curves are not."
    )
    body = words(text)
    report = out / tracked / "report.html" if tracked else None
    found = report and re.search(r'<img alt="[^"]*" src="(data:image/jpeg;base64,[^"]*)"', report.read_text())
    if not found:
        return body + words("Left out here: this run has no pictures (make paper has).")
    return body + f'<figure><img alt="A tracked picture" src="{found.group(1)}"><figcaption>A frame of the circle, rendered and tracked</figcaption></figure>\n'


def figure_9(out):
    run, desired = out / "circle_100ms.csv", marker_of_path(out / "circle" / "desired.csv")
    traces = [space(marker(run, name), name, colour) for name, colour in BANDS.items()]
    traces.append(space(desired, "desired", PAPER, "lines"))
    titles = ("x (mm)", "y (mm)", "z (mm)")
    points = points_of(out, "circle", 100)
    aligned = [space([points[f"aligned_{a}_mm"] for a in "xyz"], "tip, aligned", BANDS["tip"])]
    aligned.append(space([points[f"desired_{a}_mm"] for a in "xyz"], "desired", PAPER, "markers", 3))
    text = (
        "Circle at 100 ms per point: base, coil and tip in the base frame with the desired path of the tip (9a), and the tip after the "
        "rigid alignment (9b). In the paper the tip's circle lies some millimetres beside the desired one before the alignment, "
        "because its model and its catheter differ; here the currents come from the model that also moves, so it lies on it."
    )
    return words(text) + figure("figure-9a", traces, 620, **cube(titles, 2.2)) + figure("figure-9b", aligned, 420, **cube(titles, 1.2))


def marker_of_path(path):
    return columns(path, "x_mm", "y_mm", "z_mm")


def points_of(out, shape, pause):
    """The points of a run as `validate` has written them."""
    with (out / f"{shape}-validation" / f"points_{pause}ms.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [float(row[name]) if row[name] else None for row in rows] for name in rows[0]}


def figure_10(out, pause=5):
    points = points_of(out, "circle", pause)
    traces, told = [], []
    for of, name, colour in (("desired", "desired", PAPER), ("observed", "observed", BANDS["tip"])):
        there = [p for p in zip(*(points[f"{of}_{a}_mm"] for a in "xyz")) if None not in p]
        mean, (u, v) = plane(there)
        if of == "desired":
            frame = (mean, u, v)
        mean, u, v = frame
        flat = [(dot([a - b for a, b in zip(p, mean)], u), dot([a - b for a, b in zip(p, mean)], v)) for p in there]
        (x, y), radius = circle(flat)
        angles = [2 * math.pi * k / 120 for k in range(121)]
        ring = [[x + radius * math.cos(t) for t in angles], [y + radius * math.sin(t) for t in angles]]
        traces.append(scatter(*zip(*flat), name, colour, "markers", marker={"color": colour, "size": 4}))
        traces.append(scatter(*ring, f"its circle, radius {radius:.2f} mm", colour))
        told.append(radius)
    text = (
        f"How the magnitude is found, at {pause} ms: points on the plane of the desired path and the circle through each, "
        f"20 log({told[1]:.3f} / {told[0]:.3f}) = {20 * math.log10(told[1] / told[0]):.2f} dB (Eq. 8)."
    )
    flat = {"xaxis": axis("in the plane (mm)"), "yaxis": axis("in the plane (mm)", scaleanchor="x")}
    return words(text) + figure("figure-10", traces, 460, **flat)


def figure_11(runs, model):
    """Magnitude and phase of the circles by frequency, and the models'."""
    frequency = [run["frequency_hz"] for run in runs]
    error = lambda name: {"type": "data", "array": [run.get(name) for run in runs], "visible": True}
    parts = []
    for key, sd, title in (("magnitude_db", "magnitude_sd_db", "magnitude (dB)"), ("phase_deg", "phase_sd_deg", "phase (°)")):
        more = {"error_y": error(sd)} if runs[0].get(sd) is not None else {}
        traces = [scatter(frequency, [run[key] for run in runs], "circles", BANDS["tip"], "markers", **more)]
        for name, colour, dash, rows in model:
            traces.append(scatter([r[0] for r in rows], [r[1 if key == "magnitude_db" else 2] for r in rows], name, colour, line={"color": colour, "width": 1.6, "dash": dash}))
        parts.append(figure(f"figure-11-{key[:5]}", traces, 320, xaxis=axis("frequency (Hz)", type="log"), yaxis=axis(title)))
    return parts


def figure_12(out, shapes, pauses):
    body = ""
    for letter, shape in zip("ac", shapes):
        tips, directions = [], []
        desired = marker_of_path(out / shape / "desired.csv")
        for k, pause in enumerate(pauses):
            shade = f"hsl({210 - 200 * k // max(len(pauses) - 1, 1)},70%,42%)"
            run = out / f"{shape}_{pause}ms.csv"
            # The last period alone: what came before is on its way there.
            times = points_of(out, shape, pause)["t_s"][-POINTS:]
            read = zip(*columns(run, "t_s", "tip_x_mm", "tip_y_mm", "tan_x", "tan_y"))
            rows = [row for row in read if times[0] <= row[0] <= times[-1]]
            tips.append(scatter([row[1] for row in rows], [row[2] for row in rows], f"{pause} ms", shade))
            directions.append(scatter([row[3] for row in rows], [row[4] for row in rows], f"{pause} ms", shade))
        tips.append(scatter(desired[0], desired[1], "desired", INK, line={"color": INK, "width": 1.4, "dash": "dot"}))
        across = {"xaxis": axis("tip x, along B0 (mm)"), "yaxis": axis("tip y (mm)", scaleanchor="x")}
        along = {"xaxis": axis("tangent x"), "yaxis": axis("tangent y", scaleanchor="x")}
        body += f"<h3>{shape.capitalize()}: the tip (12{letter}) and the coil's tangent (12{chr(ord(letter) + 1)}) in the last period</h3>\n"
        body += figure(f"figure-12{letter}", tips, 440, **across) + figure(f"figure-12{chr(ord(letter) + 1)}", directions, 440, **along)
    return body


def figure_13(found, published, pauses):
    traces = []
    for shape, dash in zip(found, ("solid", "dash")):
        paper = {"color": PAPER, "width": 1.6, "dash": dash}
        here = {"color": CURVE, "width": 1.6, "dash": dash}
        traces.append(scatter(pauses, published[shape], f"{shape}, paper", PAPER, "lines+markers", line=paper))
        traces.append(scatter(pauses, [run["rms_aligned_mm"] for run in found[shape]], f"{shape}, here", CURVE, "lines+markers", line=here))
    return figure("figure-13", traces, 400, xaxis=axis("pause (ms)", type="log"), yaxis=axis("RMS distance after alignment (mm)"))


def models(out):
    """Lines of Fig. 11: the identified model and the paper's Eq. 7, both from the torque to θ, by what they are at rest;
    and what the linearised rod does to the circle, where `catheter follow` has told."""
    frequencies = [10 ** (math.log10(0.02) + k / 60 * math.log10(8 / 0.02)) for k in range(61)]
    lines = []
    def of(name, colour, dash, numerator, denominator):
        at = lambda coefficients, s: sum(c * s**n for n, c in enumerate(reversed(coefficients)))
        h = [at(numerator, 2j * math.pi * f) / at(denominator, 2j * math.pi * f) for f in frequencies]
        still = numerator[-1] / denominator[-1]
        phase = lambda v: math.degrees(math.atan2(v.imag, v.real))
        rows = [(f, 20 * math.log10(abs(v / still)), phase(v / still)) for f, v in zip(frequencies, h)]
        lines.append((name, colour, dash, rows))
    of("Eq. 7 of the paper", PAPER, "dash", [1.761e4, 6344.0], [1.0, 4.59, 1.136])
    saved = out / "dynamics" / "model.json"
    continuous = json.loads(saved.read_text()).get("continuous")
    if continuous:
        of("identified here, order 2", CURVE, "solid", continuous["num"], continuous["den"])
    response = out / "circle" / "response.csv"
    if response.exists():
        rows = list(zip(*columns(response, "frequency_hz", "magnitude_db", "phase_deg")))
        lines.append(("the rod, linearised at the circle's middle", INK, "dot", sorted(rows)))
    return lines
