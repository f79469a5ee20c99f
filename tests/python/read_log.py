"""Reads a log with independent code and compares it with the table of the same run.

    python read_log.py LOG.mcap TABLE.csv [--frame base|camera]

Decodes EVERY message (packages `mcap` and `mcap-protobuf-support` from PyPI), checks that the topics agree with each other
and that the numbers are those of the table, to the table's last digit. Prints one line of JSON; exit code 1 and the first
difference when something does not agree.
"""

import argparse
import csv
import json
import math
import sys
from collections import Counter
from decimal import Decimal

from compared import DEGREE, MM, UNIT, Difference, near, same
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def cell(what, row, column, value, tolerance):
    """The table's cell holds `value`, or is empty where that is None."""
    if value is None:
        same(f"{what}, {column}", row[column], "")
    else:
        near(f"{what}, {column}", float(row[column]), value, tolerance)


def xyz(v):
    return [v.x, v.y, v.z]


def rotate(q, v):
    """The vector turned by the quaternion."""
    u = xyz(q)
    cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    t = [2 * c for c in cross(u, v)]
    s = cross(u, t)
    return [v[i] + q.w * t[i] + s[i] for i in range(3)]


def read(path):
    """All messages, decoded, by topic: [(sequence, publish_time, message)]."""
    topics, total = {}, 0
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            same(f"type of a message on {channel.topic}", decoded.DESCRIPTOR.full_name, schema.name)
            # Live, the log time is the host's; what has one of its own must say the same.
            if channel.topic == "/catheter/estimate":
                live = decoded.HasField("arrival_ns")
                expected = decoded.arrival_ns if live else message.publish_time
                same(f"log time on {channel.topic}", message.log_time, expected)
            if message.publish_time == 0:
                raise Difference(f"a message on {channel.topic} has time 0")
            topics.setdefault(channel.topic, []).append((message.sequence, message.publish_time, decoded))
            total += 1
        same("messages, against the summary", total, summary.statistics.message_count)
        text = lambda a: a.data.decode() if a.name.endswith(".toml") else a.data
        attachments = {a.name: text(a) for a in reader.iter_attachments()}
        metadata = {m.name: dict(m.metadata) for m in reader.iter_metadata()}
    return topics, attachments, metadata


def compare_row(row, e, frame):
    what = f"frame {e.seq}"
    same(f"{what}, seq", int(row["seq"]), e.seq)
    same(f"{what}, stamp_ns", int(row["stamp_ns"]), e.stamp_ns)
    same(f"{what}, t_s", Decimal(row["t_s"]), Decimal(e.stamp_ns).scaleb(-9))
    same(f"{what}, gap", int(row["gap"]), e.gap)
    angles = e.deflection if e.HasField("deflection") else None
    for name in ("theta", "theta_sd", "polar", "azimuth"):
        value = None if angles is None else math.degrees(getattr(angles, f"{name}_rad"))
        cell(what, row, f"{name}_deg", value, DEGREE)
    for m in e.markers:
        place = m.position if m.HasField("position") else None
        same(f"{what}, {m.name}_status", row[f"{m.name}_status"], m.status.word)
        same(f"{what}, {m.name} known", m.status.word == "ok", place is not None)
        for axis in "xyz":
            value = None if place is None else 1e3 * getattr(getattr(place, f"in_{frame}_m"), axis)
            cell(what, row, f"{m.name}_{axis}_mm", value, MM)
        cell(what, row, f"{m.name}_sd_mm", None if place is None else 1e3 * place.sd_m, MM)
    tangent = e.tangent if e.HasField("tangent") else None
    for axis in "xyz":
        value = None if tangent is None else getattr(getattr(tangent, f"in_{frame}"), axis)
        cell(what, row, f"tan_{axis}", value, UNIT)
    cell(what, row, "tan_sd_deg", None if tangent is None else math.degrees(tangent.sd_rad), DEGREE)


def check_deflection(e, d):
    what = f"/catheter/deflection of frame {e.seq}"
    same(what, (d.seq, d.stamp_ns, d.status), (e.seq, e.stamp_ns, e.deflection_status.word))
    if e.HasField("deflection"):
        same(what, (d.theta_rad, d.theta_sd_rad), (e.deflection.theta_rad, e.deflection.theta_sd_rad))
    elif not (math.isnan(d.theta_rad) and math.isnan(d.theta_sd_rad)):
        raise Difference(f"{what}: a number where nothing was measured")


def check_base(e, tf):
    """The two frames of reference agree through /tf."""
    pairs = [(m.position.in_camera_m, m.position.in_base_m, 1) for m in e.markers if m.HasField("position")]
    if e.HasField("tangent"):
        pairs.append((e.tangent.in_camera, e.tangent.in_base, 0))
    for camera, base, moved in pairs:
        turned = rotate(tf.rotation, xyz(camera))
        for found, expected, offset in zip(xyz(base), turned, xyz(tf.translation)):
            near(f"frame {e.seq} in the base frame", found, expected + moved * offset, 1e-12)


def check_scene(e, scene, frame):
    (entity,) = scene.entities
    same("frame of the scene", entity.frame_id, frame)
    places = [xyz(getattr(m.position, f"in_{frame}_m")) for m in e.markers if m.HasField("position")]
    same(f"tube of frame {e.seq}", [xyz(p) for p in entity.lines[0].points], places)
    bands = [xyz(p.pose.position) for p in [*entity.spheres, *entity.cylinders]]
    same(f"bands of frame {e.seq}", sorted(bands), sorted(places))


def check_annotations(e, annotations):
    seen = [v.band.centre_px for m in e.markers for v in m.views if v.HasField("band")]
    centres = [(c.position.x, c.position.y) for c in annotations.circles]
    same(f"centres of frame {e.seq}", centres, [(p.x + 0.5, p.y + 0.5) for p in seen])
    same(f"outlines of frame {e.seq}", len(annotations.points), len(seen))


def check_health(estimates, health):
    misses = Counter()
    for e in estimates:
        for m in e.markers:
            misses[m.name, m.status.word] += 1
        misses["tangent", e.tangent_status.word] += 1
        misses["deflection", e.deflection_status.word] += 1
    expected = {key: n for key, n in misses.items() if key[1] != "ok"}
    same("misses", {(m.what, m.reason): m.frames for m in health.misses}, expected)
    same("frames", health.frames, len(estimates))
    same("lost frames", health.lost_frames, sum(e.gap for e in estimates))
    same("gaps", health.gaps, sum(e.gap > 0 for e in estimates))
    same("deflections", health.deflections, sum(e.HasField("deflection") for e in estimates))


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("log")
    arguments.add_argument("table")
    arguments.add_argument("--frame", choices=["base", "camera"], default="base")
    options = arguments.parse_args()

    topics, attachments, metadata = read(options.log)
    with open(options.table, newline="") as file:
        rows = list(csv.DictReader(file))
    estimates = topics["/catheter/estimate"]
    same("frames, against rows", len(estimates), len(rows))
    each = ("/catheter/deflection", "/scene", "/camera/annotations")
    for topic in each:
        same(f"messages on {topic}", [t[:2] for t in topics[topic]], [t[:2] for t in estimates])
    tf = topics["/tf"][0][2] if "/tf" in topics else None
    for row, (sequence, time, e), *others in zip(rows, estimates, *(topics[t] for t in each)):
        deflection, scene, annotations = (message for _, _, message in others)
        same(f"sequence of frame {e.seq}", sequence, e.seq % 2**32)
        same(f"time of frame {e.seq}", time, max(e.stamp_ns, 1))
        compare_row(row, e, options.frame)
        check_deflection(e, deflection)
        if tf is not None:
            check_base(e, tf)
        check_scene(e, scene, "camera" if tf is None else "base")
        check_annotations(e, annotations)
    check_health([e for _, _, e in estimates], topics["/health"][-1][2])
    (calibration,) = topics["/camera/calibration"]
    same("numbers of the lens", (len(calibration[2].D), len(calibration[2].K), len(calibration[2].P)), (5, 9, 12))

    counts = {topic: len(messages) for topic, messages in sorted(topics.items())}
    print(json.dumps({"frames": len(rows), "messages": counts, "attachments": sorted(attachments), **metadata}))


if __name__ == "__main__":
    try:
        main()
    except Difference as difference:
        sys.exit(str(difference))
