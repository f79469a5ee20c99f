"""Compares numbers of a log with those of its table."""

MM, DEGREE, UNIT = 0.5001e-6, 0.5001e-6, 0.5001e-7  # half of the last digit


class Difference(Exception):
    pass


def same(what, found, expected):
    if found != expected:
        raise Difference(f"{what}: {found!r} in one place, {expected!r} in the other")


def near(what, found, expected, tolerance):
    if not abs(found - expected) <= tolerance:  # NaN is a difference
        raise Difference(f"{what}: {found!r} in one place, {expected!r} in the other (tolerance {tolerance})")
