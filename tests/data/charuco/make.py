#!/usr/bin/env python3
"""Make the pictures of this folder with OpenCV's own ChArUco boards: `pip install opencv-python-headless`, then run it here.

Boards are `cv2.aruco.CharucoBoard.generateImage`, a cell of a marker a pixel. Photographs are those boards through
`cv2.projectPoints` (pinhole, distortion), blurred, with noise, as JPEG; corners.csv has where OpenCV projects each of
`getChessboardCorners`: pixel (0, 0) is the centre of the top-left one.
"""

import csv
import pathlib

import cv2
import numpy as np

HERE = pathlib.Path(__file__).parent
SIZE = (720, 540)
CAMERA = np.array([[905.0, 0, 366.0], [0, 902.0, 262.0], [0, 0, 1]])
LENS = np.array([-0.18, 0.12, 8e-4, -6e-4, 0.0])
FINE = 5


def board(columns, rows, dictionary, legacy=False):
    """Squares of 32 mm; markers with one cell of light around them."""
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    cells = words.markerSize + 4
    made = cv2.aruco.CharucoBoard((columns, rows), 32.0, 32.0 * (cells - 2) / cells, words)
    made.setLegacyPattern(legacy)
    # Drawn large and taken apart again: exact cells.
    large = made.generateImage((columns * cells * 10, rows * cells * 10))
    return made, large[5::10, 5::10], cells


def texture(name, *what):
    cv2.imwrite(str(HERE / name), board(*what)[1])


def draw(picture, made, drawn, cells, turn, shift, mirrored):
    """Into a picture of light; truth of the corners."""
    columns, rows = made.getChessboardSize()
    flip = np.diag([-1.0 if mirrored else 1.0, 1, 1])
    turn = cv2.Rodrigues(np.radians(turn))[0]
    middle = np.array([columns * 16.0, rows * 16.0, 0])
    shift = flip @ np.array(shift) - turn @ middle

    def seen(points):
        points = (flip @ (turn @ points.T + shift[:, None])).T
        return cv2.projectPoints(points, np.zeros(3), np.zeros(3), CAMERA, LENS)[0][:, 0]

    # All fine places of the picture, back onto the board's plane.
    axis = [(np.arange(n * FINE) + 0.5) / FINE - 0.5 for n in SIZE]
    places = np.stack(np.meshgrid(*axis), -1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(places, CAMERA, LENS)[:, 0]
    rays = np.c_[rays, np.ones(len(rays))] @ flip
    normal = turn[:, 2]
    points = rays * (normal @ shift / (rays @ normal))[:, None] - shift
    across = (points @ turn)[:, :2] / 32.0
    paper = np.all((across > -0.4) & (across < np.array([columns, rows]) + 0.4), axis=1)
    cell = np.floor(across * cells).astype(int)
    on = np.all((cell >= 0) & (cell < np.array([columns, rows]) * cells), axis=1)
    grey = np.full(len(across), 205.0)
    grey[on] = np.where(drawn[cell[on, 1], cell[on, 0]] > 0, 205.0, 40.0)
    picture[paper] = grey[paper]
    return seen(made.getChessboardCorners().astype(float))


def photograph(name, made, boards, hidden, rows):
    picture = np.full(SIZE[0] * SIZE[1] * FINE * FINE, 120.0)
    for number, (turn, shift, mirrored) in enumerate(boards):
        truth = draw(picture, *made, turn, shift, mirrored)
        rows += [(name, number, int(mirrored), i, f"{x:.4f}", f"{y:.4f}") for i, (x, y) in enumerate(truth)]
    picture = picture.reshape(SIZE[1], FINE, SIZE[0], FINE).mean((1, 3))
    for x, y, width, height in hidden:
        picture[y : y + height, x : x + width] = 150.0
    picture = cv2.GaussianBlur(picture, (0, 0), 0.7) + np.random.default_rng(7).normal(0, 2, picture.shape)
    picture = np.clip(picture.round(), 0, 255).astype(np.uint8)
    cv2.imwrite(str(HERE / name), picture, [cv2.IMWRITE_JPEG_QUALITY, 88])


def main():
    texture("5x7_4x4_50.png", 5, 7, "DICT_4X4_50")
    texture("6x6_5x5_100.png", 6, 6, "DICT_5X5_100")
    texture("6x6_5x5_100_legacy.png", 6, 6, "DICT_5X5_100", True)
    texture("8x5_6x6_250.png", 8, 5, "DICT_6X6_250")
    texture("4x5_7x7_1000.png", 4, 5, "DICT_7X7_1000")

    rows = []
    five = board(5, 7, "DICT_4X4_50")
    photograph("direct.jpg", five, [((20, -28, 12), (5, -4, 520), False)], [], rows)
    two = [((10, -15, 5), (-95, 10, 560), False), ((12, 35, -8), (120, -5, 720), True)]
    photograph("mirror.jpg", five, two, [], rows)
    photograph("part.jpg", five, [((-25, 15, 160), (105, 40, 400), True)], [(545, 220, 85, 110)], rows)
    legacy = board(5, 6, "DICT_6X6_250", True)
    photograph("legacy.jpg", legacy, [((-15, 20, -30), (-10, 8, 560), False)], [], rows)
    with open(HERE / "corners.csv", "w", newline="") as file:
        csv.writer(file).writerows([("picture", "image", "mirrored", "index", "x_px", "y_px"), *rows])


if __name__ == "__main__":
    main()
