"""Reads tables in Parquet and MAT 5 with independent libraries and compares them with the table of the same run.

    python read_tables.py TABLE.csv FILE.parquet|FILE.mat…

Parquet with `pyarrow` and with `polars`, MAT with `scipy`: every column of the table must be there with its numbers, to
the table's last digit; integers and words exactly; empty cells of the table must be missing. Prints one line of JSON;
exit code 1 and the first difference when something does not agree.
"""

import csv
import json
import math
import sys
from pathlib import Path

import polars
import pyarrow.parquet
import scipy.io

TOLERANCE = {"_mm": 0.5001e-6, "_deg": 0.5001e-6, "_s": 0.0}
WHOLE = {"seq", "stamp_ns", "gap"}


class Difference(Exception):
    pass


def parquet(path):
    """Columns of a file, read twice."""
    one = pyarrow.parquet.read_table(path).to_pydict()
    other = {name: column.to_list() for name, column in polars.read_parquet(path).to_dict().items()}
    if one != other:
        raise Difference(f"{path}: pyarrow and polars differ")
    return one


def mat(path):
    columns = {}
    for name, value in scipy.io.loadmat(path).items():
        if name.startswith("__"):
            continue
        if value.dtype.kind == "U":
            columns[name] = [line.rstrip() for line in value]
        else:
            columns[name] = [None if isinstance(v, float) and math.isnan(v) else v for v in value[:, 0].tolist()]
    return columns


def compare(path, columns, rows):
    for name in rows[0]:
        if name not in columns:
            raise Difference(f"{path}: has no column {name}")
        column = columns[name]
        if len(column) != len(rows):
            raise Difference(f"{path}: {len(column)} cells in {name}, {len(rows)} rows in the table")
        ending = next((e for e in TOLERANCE if name.endswith(e)), None)
        tolerance = TOLERANCE.get(ending, 0.5001e-7)
        for k, (row, found) in enumerate(zip(rows, column)):
            cell = row[name]
            if name.endswith("_status") or cell == "":
                right = (found or "") == cell
            elif name in WHOLE:
                right = isinstance(found, int) and found == int(cell)
            else:
                # Seconds are rounded to what a double can hold.
                expected = float(cell)
                right = found is not None and abs(found - expected) <= tolerance + (abs(expected) * 2**-52)
            if not right:
                raise Difference(f"{path}, {name}, row {k}: {found!r}, and {cell!r} in the table")


def main():
    table, *files = sys.argv[1:]
    with open(table, newline="") as file:
        rows = list(csv.DictReader(file))
    read = {}
    for path in files:
        columns = mat(path) if path.endswith(".mat") else parquet(path)
        if "seq" in columns:
            compare(path, columns, rows)
        else:
            # Currents: a time for each, exactly that of a frame and three nanoseconds.
            times = [int(row["stamp_ns"]) + 3 for row in rows]
            if columns["host_ns"] != times or columns["coil_1"] != [k / 3 for k in range(len(rows))]:
                raise Difference(f"{path}: times or currents differ")
        if "current_host_ns" in columns and columns["current_coil_1"] != [k / 3 for k in range(len(rows))]:
            raise Difference(f"{path}: currents differ")
        read[Path(path).name] = len(next(iter(columns.values())))
    print(json.dumps(read))


if __name__ == "__main__":
    try:
        main()
    except Difference as difference:
        sys.exit(str(difference))
