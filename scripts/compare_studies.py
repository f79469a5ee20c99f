#!/usr/bin/env python3
"""Compares two output folders of the workflow, byte for byte except for times of day, and their tables with the runs'
own.

    compare_studies.py ONE OTHER        needs pyarrow and polars
"""
import csv
import json
import pathlib
import re
import sys

import polars
import pyarrow.parquet

MADE = re.compile(rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC")


def without_times(path):
    data = path.read_bytes()
    if path.name == "summary.json":
        summary = json.loads(data)
        del summary["finished"], summary["elapsed_s"]
        return json.dumps(summary)
    return MADE.sub(b"", data) if path.name == "report.html" else data


def files(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def main():
    one, other = map(pathlib.Path, sys.argv[1:])
    for part in ("runs", "study"):
        names = files(one / part)
        assert names == files(other / part), names ^ files(other / part)
        differing = [name for name in sorted(names) if without_times(one / part / name) != without_times(other / part / name)]
        # The page of the study names the folder in no other place than its title.
        assert not differing, differing
        print(f"{part}: {len(names)} files are the same")

    frames = pyarrow.parquet.read_table(one / "study/frames.parquet")
    assert polars.read_parquet(one / "study/frames.parquet").equals(polars.from_arrow(frames))
    by_run = {}
    for row in frames.to_pylist():
        by_run.setdefault(row["run"], []).append(row)
    cells = 0
    for folder in sorted((one / "runs").iterdir()):
        table = folder / "track.csv"
        expected = list(csv.DictReader(table.open(newline=""))) if table.exists() else []
        found = by_run.get(folder.name, [])
        assert len(found) == len(expected), folder
        for got, want in zip(found, expected):
            for name, text in want.items():
                value = got[name]
                same = value is None if text == "" else value == (text if isinstance(value, str) else type(value)(text))
                assert same, (folder, name, text, value)
                cells += 1
    runs = pyarrow.parquet.read_table(one / "study/runs.parquet").to_pylist()
    assert polars.read_parquet(one / "study/runs.parquet").height == len(runs)
    for run in runs:
        summary = json.loads((one / "runs" / run["run"] / "summary.json").read_text())
        measured = summary["measured"] or {"frames": None, "theta": {"sd_deg": None}}
        assert run["frames"] == measured["frames"] and run["theta_sd_deg"] == measured["theta"]["sd_deg"], run
        assert all(run[name] == value for name, value in summary["manifest"].items()), run
    print(f"tables: {len(frames)} frames, {cells} cells as in track.csv; {len(runs)} runs as in summary.json")
    for run in runs:
        if run["outcome"] != "tracked" or run["ends_early"]:
            print(f"  {run['run']}: {run['outcome']}, retryable {run['retryable']}: {run['failure'] or run['ends_early']}")


if __name__ == "__main__":
    main()
