#!/usr/bin/env python3
"""A manifest in pieces, for many machines. Needs Python 3.8 and nothing else.

    shards.py split MANIFEST --into FOLDER [--size 100]   writes FOLDER/0000.tsv, FOLDER/0001.tsv, ...
    shards.py settle SHARD RUNS                           is all of a shard done, or worth no other attempt?
"""
import argparse
import csv
import io
import json
import os
import sys


class Wrong(Exception):
    """A mistake in what the user gave."""


def rows(manifest):
    """The header of a manifest, and its rows as dictionaries; paths are whole, every run has a name of its own."""
    try:
        with open(manifest, encoding="utf-8-sig", newline="") as file:
            text = file.read()
    except UnicodeDecodeError as error:
        with open(manifest, "rb") as file:
            line = 1 + file.read()[: error.start].count(b"\n")
        raise Wrong(f"{manifest}:{line}: is not text in UTF-8") from None
    first = text.split("\n", 1)[0]
    delimiter = "\t" if "\t" in first or "," not in first else ","
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    header = [cell.strip() for cell in next(reader, [])]
    if "recording" not in header:
        raise Wrong(f"{manifest}:1: no column `recording`; the first line names the columns")
    folder = os.path.dirname(os.path.abspath(manifest))
    seen, found = {}, []
    last = reader.line_num
    for cells in reader:
        line, last = last + 1, reader.line_num
        if any("\n" in cell or "\r" in cell for cell in cells):
            raise Wrong(f'{manifest}:{line}: a cell begins with a " that is not closed in this line')
        cells = [cell.strip() for cell in cells]
        if not any(cells):
            continue
        if len(cells) != len(header):
            raise Wrong(f"{manifest}:{line}: {len(cells)} cells, the first line names {len(header)} columns")
        row = dict(zip(header, cells))
        if not row["recording"]:
            raise Wrong(f"{manifest}:{line}: the recording is missing")
        for column in ("recording", "rig"):
            if row.get(column):
                row[column] = os.path.join(folder, row[column])
        if "name" not in header:
            name = os.path.basename(os.path.normpath(row["recording"]))
            row["name"] = name if os.path.isdir(row["recording"]) else os.path.splitext(name)[0]
        if not row["name"]:
            raise Wrong(f"{manifest}:{line}: the name is missing")
        if row["name"] in seen:
            raise Wrong(f"{manifest}:{line}: the name {row['name']!r} is that of line {seen[row['name']]} already")
        seen[row["name"]] = line
        found.append(row)
    if not found:
        raise Wrong(f"{manifest}:1: names no recording")
    return header if "name" in header else header + ["name"], found


def names(manifest, size):
    """Names of the shards: `0000`, `0001`, ..."""
    return [f"{k:04d}" for k in range((len(rows(manifest)[1]) + size - 1) // size)]


def rigs(manifest):
    """The rig files of a manifest that are there."""
    found = {row.get("rig") for row in rows(manifest)[1]}
    return sorted(rig for rig in found if rig and os.path.exists(rig))


def split(manifest, folder, size):
    """Writes the shards. One that would be the same is left as it is: what was made of it is not stale then."""
    header, found = rows(manifest)
    os.makedirs(folder, exist_ok=True)
    for k, name in enumerate(names(manifest, size)):
        path = os.path.join(folder, f"{name}.tsv")
        with open(path + ".new", "w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, header, delimiter="\t", lineterminator="\n")
            writer.writeheader()
            writer.writerows(found[k * size : (k + 1) * size])
        if os.path.exists(path) and open(path, "rb").read() == open(path + ".new", "rb").read():
            os.remove(path + ".new")
        else:
            os.replace(path + ".new", path)


def settle(shard, runs):
    """Runs of a shard that want another attempt, with the reason."""
    wanting = []
    for row in rows(shard)[1]:
        try:
            with open(os.path.join(runs, row["name"], "summary.json"), encoding="utf-8") as file:
                failure = json.load(file)["failure"]
        except (OSError, ValueError, KeyError) as error:
            wanting.append((row["name"], f"no summary ({error})"))
            continue
        if failure and failure["retryable"]:
            wanting.append((row["name"], failure["message"]))
    return wanting


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    verb = verbs.add_parser("split")
    verb.add_argument("manifest")
    verb.add_argument("--into", required=True)
    verb.add_argument("--size", type=int, default=100)
    verb = verbs.add_parser("settle")
    verb.add_argument("shard")
    verb.add_argument("runs")
    args = parser.parse_args()
    try:
        if args.verb == "split":
            split(args.manifest, args.into, args.size)
            print(len(names(args.manifest, args.size)))
            return 0
        wanting = settle(args.shard, args.runs)
        for name, why in wanting:
            print(f"{name}: {why}", file=sys.stderr)
        return 1 if wanting else 0
    except (Wrong, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
