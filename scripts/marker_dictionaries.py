#!/usr/bin/env python3
"""Write the code words of OpenCV's predefined ArUco dictionaries as text: src/calibrate/board/charuco/dictionaries.txt.

A marker is a word: its cells in row-major order from the top left, the first being the highest bit, white 1. Smaller
dictionaries of a family (DICT_4X4_50 …) are the first words of the largest. Needs `pip install opencv-python-headless`,
4.7 or newer.

Example:
  scripts/marker_dictionaries.py > src/calibrate/board/charuco/dictionaries.txt
"""

import textwrap

import cv2

FAMILIES = ["4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL", "ARUCO_MIP_36h12"]
SIZES = [50, 100, 250]

HEAD = f"""\
# Code words of ArUco markers, from the predefined dictionaries of OpenCV (modules/objdetect/src/aruco), here as
# cv2 {cv2.__version__} has them. Copyright (C) OpenCV Foundation and contributors, Apache License 2.0.
# Made by scripts/marker_dictionaries.py, which says what the words mean. A family: its name, cells per side, words.
"""


def dictionary(name):
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def words(found):
    size = found.markerSize
    for row in found.bytesList:
        bits = cv2.aruco.Dictionary.getBitsFromByteList(row.reshape(1, *row.shape), size)
        yield "".join(str(int(bit)) for bit in bits.flat)


def main():
    print(HEAD, end="")
    for name in FAMILIES:
        largest = dictionary(name)
        own = list(words(largest))
        family = name.removesuffix("_1000")
        if family != name:
            for size in SIZES:
                assert own[:size] == list(words(dictionary(f"{family}_{size}"))), f"{family}_{size} is no part of {name}"
        print(f"\nfamily {family} {largest.markerSize}")
        digits = (largest.markerSize**2 + 3) // 4
        print(textwrap.fill(" ".join(f"{int(word, 2):0{digits}x}" for word in own), 120))


if __name__ == "__main__":
    main()
