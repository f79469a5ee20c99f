#!/usr/bin/env python3
"""Make calibration/good_and_bad.jpg: good and bad pictures of a board, each with catoptra's message about it.

The pictures are those of calibration/dev_tank, degraded here; the messages come from running catoptra on them. Needs
Pillow and NumPy.

Example:
  scripts/board_pictures.py --catoptra target/release/catoptra -o calibration/good_and_bad.jpg
"""

import argparse
import pathlib
import subprocess
import tempfile
import textwrap

import numpy
from PIL import Image, ImageDraw, ImageFilter, ImageFont

ROOT = pathlib.Path(__file__).resolve().parent.parent / "calibration" / "dev_tank"
BOARD = ["--board", "9x6:12mm"]
GOOD, BAD = (38, 128, 62), (178, 40, 40)
PANEL, PICTURE, GAP = (430, 428), (430, 315), 14


def picture(name):
    return Image.open(ROOT / name).convert("L")


def shifted(image, right, down):
    """The board elsewhere in the picture, the wall behind it as grey as at its edge."""
    moved = Image.new("L", image.size, image.getpixel((image.width - 1, 0)))
    moved.paste(image, (right, down))
    return moved


def faced(image, corners, box):
    """The board as if it faced the camera: the corners of its paper (from the top left, clockwise) put into a box."""
    left, top, right, bottom = box
    places = [(left, top), (right, top), (right, bottom), (left, bottom)]
    rows, values = [], []
    for (x, y), (u, v) in zip(places, corners):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        values += [u, v]
    back = numpy.linalg.solve(numpy.array(rows, float), numpy.array(values, float))
    return image.transform(image.size, Image.Transform.PERSPECTIVE, back, Image.Resampling.BICUBIC, fillcolor=image.getpixel((image.width - 1, 0)))


def with_glare(image, box):
    """A lamp that the board's foil mirrors."""
    light = Image.new("L", image.size, 0)
    ImageDraw.Draw(light).ellipse(box, fill=255)
    light = light.filter(ImageFilter.GaussianBlur(25))
    return Image.composite(Image.new("L", image.size, 255), image, light)


def with_narrow_mirror(image):
    """The mirror's right edge, and what is beside it, further left."""
    beside = image.crop((1060, 0, 1280, 1024))
    image.paste(beside, (930, 0))
    image.paste(beside.crop((90, 0, 220, 1024)), (1150, 0))
    return image


class Program:
    """catoptra, in a folder with a lens."""

    def __init__(self, path, folder):
        self.path, self.folder = path, folder
        self.run("camera", ROOT / "intrinsics", "--out", "lens.toml")

    def run(self, verb, *args):
        command = [self.path, "calibrate", verb, *BOARD, *map(str, args)]
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True)
        return done.stdout + done.stderr

    def says(self, verb, images, about):
        """Its line about a picture, or about them all."""
        folder = pathlib.Path(tempfile.mkdtemp(dir=self.folder))
        for name, image in images.items():
            image.save(folder / name)
        args = ["--rig", "lens.toml", "--glass", "5mm", "--out", "rig.toml"] if verb == "rig" else ["--out", "rig.toml"]
        told = self.run(verb, folder, *args)
        line = next((line for line in told.splitlines() if about in line), None)
        if line is None:
            raise SystemExit(f"catoptra calibrate {verb} says nothing of {about}:\n{told}")
        return " ".join(line.split()).removeprefix("error: ")


def panels(program):
    others = {f"{i:02}.png": picture(f"mirror/{i:02}.png") for i in (0, 2, 4, 6, 8, 10)}
    tank, near = (110, 190, 1130, 937), (0, 0, 1280, 1024)

    good = picture("mirror/01.png")
    told = program.says("rig", others | {"good.png": good}, "good.png").split()
    said = f"{told[1]} corners, RMS {told[2]} px, largest {told[3]} px"
    yield "Tilted, whole in both views, sharp, evenly lit", said, good.crop(tank), GOOD

    # The paper's corners, read off the picture; 12 columns and 9 rows of squares with its rim.
    flat = faced(picture("intrinsics/08.png"), [(238, 532), (1047, 510), (986, 975), (260, 1014)], (60, 60, 660, 510))
    places = [(0, 0), (500, 40), (40, 420), (520, 440), (260, 230)]
    said = program.says("camera", {f"{i}.png": shifted(flat, *to) for i, to in enumerate(places)}, "parallel")
    yield "Always parallel to the wall (five like this)", said, shifted(flat, 260, 230).crop(near), BAD

    cut = shifted(picture("intrinsics/13.png"), 500, 60)
    said = program.says("camera", {"cut.png": cut}, "cut.png")
    yield "Cut off at the picture's edge", said, cut.crop(near), BAD

    blurred = picture("mirror/06.png").filter(ImageFilter.GaussianBlur(4))
    said = program.says("rig", {"blurred.png": blurred}, "blurred.png")
    yield "Blurred: moved, or out of focus", said, blurred.crop(tank), BAD

    glare = with_glare(picture("intrinsics/13.png"), (520, 300, 900, 640))
    said = program.says("camera", {"glare.png": glare}, "glare.png")
    yield "A lamp is mirrored in it: matt paper, light from the side", said, glare.crop(near), BAD

    narrow = with_narrow_mirror(picture("mirror/01.png"))
    said = program.says("rig", {"edge.png": narrow}, "edge.png")
    yield "Cut by the mirror's edge", said, narrow.crop(tank), BAD


def drawn(title, said, image, colour):
    panel = Image.new("RGB", PANEL, "white")
    image = image.convert("RGB").resize(PICTURE, Image.Resampling.LANCZOS)
    panel.paste(image, (0, 0))
    draw = ImageDraw.Draw(panel)
    draw.rectangle((0, 0, PICTURE[0] - 1, PICTURE[1] - 1), outline=colour, width=5)
    draw.text((2, PICTURE[1] + 6), title, fill=colour, font=ImageFont.load_default(size=17))
    text = "\n".join(textwrap.wrap(said, 62)[:5])
    draw.multiline_text((2, PICTURE[1] + 30), text, fill=(40, 40, 40), font=ImageFont.load_default(size=14), spacing=3)
    return panel


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--catoptra", default="catoptra", help="the program [catoptra]")
    parser.add_argument("-o", "--out", type=pathlib.Path, required=True)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(args.catoptra)
        path = str(path.resolve()) if path.exists() else args.catoptra
        drawings = [drawn(*panel) for panel in panels(Program(path, folder))]
    width, height = PANEL[0] + GAP, PANEL[1] + GAP
    sheet = Image.new("RGB", (3 * width + GAP, 2 * height + GAP), "white")
    for i, panel in enumerate(drawings):
        sheet.paste(panel, (GAP + width * (i % 3), GAP + height * (i // 3)))
    sheet.save(args.out, quality=82, optimize=True)


if __name__ == "__main__":
    main()
