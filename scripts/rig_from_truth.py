#!/usr/bin/env python3
"""Make a rig.toml from a renderer's exact truth.

The truth is a rig.json (camera, mirror and, unless in air, tank; camera frame, mm) and a CSV of the catheter at rest,
whose base marker is the origin of the base frame. Needs Python's standard library only.

Example:
  scripts/rig_from_truth.py sample_frames/truth/rig.json sample_frames/truth/rest.csv -o rig.toml \\
      --region direct:138,237,670,237,670,802,138,802
"""

import argparse
import csv
import hashlib
import json
import math
import pathlib
import sys


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def scaled(a, s):
    return [x * s for x in a]


def minus(a, b):
    return [x - y for x, y in zip(a, b)]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def unit(a):
    return scaled(a, 1 / math.sqrt(dot(a, a)))


def number(value, decimals):
    """As short as it can be, always with a point."""
    text = f"{value:.{decimals}f}".rstrip("0")
    text += "0" if text.endswith(".") else ""
    return "0.0" if text == "-0.0" else text


def numbers(values, decimals):
    return "[" + ", ".join(number(v, decimals) for v in values) + "]"


def plane(normal, offset_mm):
    # The truth's normals are unit to rounding; twelve decimals of the exactly unit one are written.
    return f"normal = {numbers(unit(normal), 12)}\noffset_mm = {number(offset_mm, 9)}\n"


def camera(rig):
    k = rig["K"]
    distortion = list(rig.get("dist", [])) + [0.0] * (5 - len(rig.get("dist", [])))
    return (
        "# The camera and its lens: one for all views. distortion = k1, k2, p1, p2, k3 as OpenCV orders them.\n"
        f"[camera]\nwidth_px = {rig['image_size'][0]}\nheight_px = {rig['image_size'][1]}\n"
        f"focal_px = {numbers([k[0][0], k[1][1]], 9)}\nprincipal_point_px = {numbers([k[0][2], k[1][2]], 9)}\n"
        f"distortion = {numbers(distortion, 12)}\n"
    )


def surfaces(rig):
    """Sections of all surfaces, and the two views' paths."""
    head = (
        "# Planes normal·X = offset_mm. A mirror's normal points to the side it reflects on, a wall's outwards;\n"
        "# a wall's plane is its outer face.\n"
    )
    mirror = '[surfaces.side_mirror]\nkind = "mirror"\n' + plane(rig["mirror"]["n"], rig["mirror"]["d"])
    tank = rig.get("tank")
    if tank is None:
        return [head + mirror], {"direct": [], "mirror": ["side_mirror"]}
    sections = []
    for name, truth in (("front_wall", "front"), ("side_wall", "mirror_side")):
        sections.append(
            f'[surfaces.{name}]\nkind = "wall"\n'
            + plane(tank[truth]["n"], tank[truth]["d_outer"])
            + f"thickness_mm = {number(tank['glass_mm'], 9)}\nindex_outside = {number(tank['n_air'], 9)}\n"
            + f"index_wall = {number(tank['n_glass'], 9)}\nindex_inside = {number(tank['n_water'], 9)}\n"
        )
    sections[0] = head + sections[0]
    return sections + [mirror], {"direct": ["front_wall"], "mirror": ["side_mirror", "side_wall"]}


def views(paths, regions):
    head = "# Views: the surfaces a camera ray meets, in order, and where in the picture.\n"
    sections = []
    for name, path in paths.items():
        text = f'{head}[[view]]\nname = "{name}"\npath = {json.dumps(path)}\n'
        if name in regions:
            text += "region_px = [" + ", ".join(numbers(corner, 9) for corner in regions[name]) + "]\n"
        sections.append(text)
        head = ""
    return sections


def markers(rig):
    head = "# Bands, from the clamp to the tip; centre_mm is the middle of the band along the tube from the clamp.\n"
    tube = rig["tube"]
    bands = sorted(tube["bands_mm_along"].items(), key=lambda band: band[1])
    sections = []
    for name, (start, end) in bands:
        sections.append(
            f'{head}[[marker]]\nname = "{name}"\nlength_mm = {number(end - start, 9)}\n'
            f"centre_mm = {number((start + end) / 2, 9)}\n"
        )
        head = ""
    last_name, (_, last_end) = bands[-1]
    catheter = (
        "# The tube: which band is the coil, and which one ends the tube.\n"
        f"[catheter]\ndiameter_mm = {number(2 * tube['radius'], 9)}\ncoil = \"coil\"\n"
    )
    if math.isclose(last_end, tube["length"], abs_tol=1e-6):
        catheter += f'end = "{last_name}"\n'
    if "straight_coil" in tube:
        start, end = tube["straight_coil"]
        catheter += f"rigid_mm = {number(end - start, 9)}\n"
    return sections + [catheter]


def base(rig, origin_mm):
    """z along the tube at rest, x along B0 made orthogonal to it, y = z × x."""
    z = unit(rig["rest_tangent"])
    x = unit(minus(rig["B0"], scaled(z, dot(rig["B0"], z))))
    y = cross(z, x)
    rows = "".join(f"    {numbers(axis, 12)},\n" for axis in (x, y, z))
    return (
        "# The base frame: origin at the base marker at rest, z along the tube at rest, x along b0, y = z × x.\n"
        f"[base]\nb0 = {numbers(unit(rig['B0']), 12)}\ngravity = {numbers(unit(rig['gravity']), 12)}\n\n"
        "# X_base = rotation · X_camera + translation; the rows are the axes x, y, z of the base in the camera frame.\n"
        f"[base.base_from_camera]\nrotation = [\n{rows}]\n"
        f"translation_mm = {numbers([-dot(axis, origin_mm) for axis in (x, y, z)], 9)}\n"
    )


def provenance(rig, files):
    text = (
        "# Where the numbers come from.\n[provenance]\n"
        "source = \"made from the renderer's truth: nothing was measured or calibrated\"\n"
        f"rig = {json.dumps(rig.get('name', 'unnamed'))}\nmade_by = \"scripts/rig_from_truth.py\"\n"
        "\n[provenance.inputs_sha256]\n"
    )
    for path in files:
        text += f'"{path.name}" = "{hashlib.sha256(path.read_bytes()).hexdigest()}"\n'
    return text


def base_at_rest(path):
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        sys.exit(f"{path}: no row; the first one gives the base marker at rest")
    return [float(rows[0][f"base_{axis}"]) for axis in "xyz"]


def region(text):
    """NAME:x,y,x,y,..."""
    name, _, corners = text.partition(":")
    values = [float(v) for v in corners.split(",")]
    if len(values) < 6 or len(values) % 2:
        raise argparse.ArgumentTypeError(f"{text}: expected NAME:x,y,x,y,x,y with three corners or more")
    return name, list(zip(values[::2], values[1::2]))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rig", type=pathlib.Path, help="the truth's rig.json")
    parser.add_argument("rest", type=pathlib.Path, help="the truth's CSV of a recording at rest")
    parser.add_argument("-o", "--out", type=pathlib.Path, help="file to write (default: stdout)")
    parser.add_argument("--region", type=region, action="append", default=[], metavar="NAME:x,y,...", help="a view's polygon, px")
    arguments = parser.parse_args()
    rig = json.loads(arguments.rig.read_text())
    sections, paths = surfaces(rig)
    regions = dict(arguments.region)
    for name in regions.keys() - paths.keys():
        parser.error(f"--region {name}: the views are {', '.join(paths)}")
    text = "\n".join(
        [
            "# A Catoptra rig. Lengths are mm, pixels count from the centre of the top-left one, directions are unit\n"
            "# vectors in the camera frame (x right, y down, z forward). Every key: calibration/README.md.\n",
            camera(rig),
            *sections,
            *views(paths, regions),
            *markers(rig),
            base(rig, base_at_rest(arguments.rest)),
            provenance(rig, [arguments.rig, arguments.rest]),
        ]
    )
    if arguments.out:
        arguments.out.write_text(text)
    else:
        sys.stdout.write(text)


if __name__ == "__main__":
    main()
