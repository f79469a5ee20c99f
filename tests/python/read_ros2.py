"""Reads a log of profile ros2 with two independent libraries, and compares it with the table of the same run.

    python read_ros2.py LOG.mcap TABLE.csv [--live]

Decodes EVERY message with `rosbags` and with `mcap-ros2-support` (both from PyPI): both must agree, the types must be
those of ROS 2 Jazzy (by their hashes), times must match the table to the nanosecond, and numbers to its last digit.
Prints one line of JSON; exit code 1 and the first difference when something does not agree.
"""

import argparse
import csv
import json
import math
import sys
from collections import Counter

import numpy
from compared import DEGREE, MM, UNIT, Difference, near, same
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ANY_ANGLE = math.pi**2 / 3
OURS = {"/catheter/estimate", "/coil/current", "/camera/windows", "/health"}


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


def plain(value):
    """A message as lists and numbers, so that those of the two libraries can be compared."""
    if isinstance(value, numpy.ndarray):
        return value.tolist()
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (bool, int, float, str)) or numpy.isscalar(value):
        return value.item() if isinstance(value, numpy.generic) else value
    names = getattr(value, "__slots__", None) or [name for name in vars(value)]
    # One of the libraries gives constants, too; their names are in capitals.
    return {name: plain(getattr(value, name)) for name in names if not name.startswith("_") and not name.isupper()}


def equal(a, b):
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(equal(a[key], b[key]) for key in a)
    if isinstance(a, list):
        return isinstance(b, list) and len(a) == len(b) and all(map(equal, a, b))
    return a == b or (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b))


def by_rosbags(path):
    """[(topic, log time, message)] in the order of the file, and the quality of service of each topic."""
    jazzy, own = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.EMPTY)
    found = []
    with Reader(path) as reader:
        for connection in reader.connections:
            own.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            name = connection.msgtype
            same(f"hash of {name}", own.hash_rihs01(name), jazzy.hash_rihs01(name))
            same(f"format of {connection.topic}", connection.ext.serialization_format, "cdr")
        for connection, time, data in reader.messages():
            found.append((connection.topic, time, own.deserialize_cdr(data, connection.msgtype)))
        qos = {c.topic: (c.ext.offered_qos_profiles[0].durability.name, c.ext.offered_qos_profiles[0].reliability.name)
               for c in reader.connections}
        types = {c.topic: c.msgtype for c in reader.connections}
        same("messages, against the summary", len(found), reader.message_count)
    return found, qos, types


def by_mcap(path):
    found = []
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        same("profile", reader.get_header().profile, "ros2")
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.append((channel.topic, message.log_time, message.publish_time, decoded))
    return found


def rotate(q, v):
    """The vector turned by the quaternion."""
    x, y, z, w = q
    cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    t = [2 * c for c in cross([x, y, z], v)]
    s = cross([x, y, z], t)
    return [v[i] + w * t[i] + s[i] for i in range(3)]


def cell(what, row, column, value, tolerance):
    if value is None or (isinstance(value, float) and math.isnan(value)):
        same(f"{what}, {column}", row[column], "")
    else:
        near(f"{what}, {column}", float(row[column]), value, tolerance)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("log")
    arguments.add_argument("table")
    arguments.add_argument("--live", action="store_true", help="log times are the host's")
    options = arguments.parse_args()

    found, qos, types = by_rosbags(options.log)
    again = by_mcap(options.log)
    same("messages", len(found), len(again))
    # The two libraries may give messages of the same time in another order, but each topic's in its own.
    topics, others = {}, {}
    for topic, time, message in found:
        topics.setdefault(topic, []).append((time, message))
    for topic, time, publish, message in again:
        others.setdefault(topic, []).append((time, publish, message))
    same("topics", sorted(topics), sorted(others))
    for topic in topics:
        for (time, message), (log, publish, other) in zip(topics[topic], others[topic], strict=True):
            same(f"log time on {topic}", time, log)
            if not equal(plain(message), plain(other)):
                one, two = (str(plain(m))[:500] for m in (message, other))
                raise Difference(f"{topic} at {time}: {one} for one library, {two} for the other")
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            if stamp is not None and topic != "/camera/time_reference":
                same(f"stamp on {topic}", max(nanoseconds(stamp), 1), publish)

    with open(options.table, newline="") as file:
        rows = list(csv.DictReader(file))
    stamps = [int(row["stamp_ns"]) for row in rows]
    each = topics["/catheter/deflection"]
    same("stamps of all frames", [nanoseconds(m.header.stamp) for _, m in each], stamps)
    if not options.live:
        same("log times of all frames", [time for time, _ in each], [max(ns, 1) for ns in stamps])
    same("frames of the project's own", len(topics["/catheter/estimate"]), len(rows))
    same("scenes", [nanoseconds(m.markers[0].header.stamp) for _, m in topics["/catheter/markers"]], stamps)

    at = {topic: {nanoseconds(m.header.stamp): m for _, m in topics[topic]} for topic in topics if topic.endswith("/pose")}
    moved = {}
    for _, message in topics.get("/tf", []):
        for t in message.transforms:
            moved[nanoseconds(t.header.stamp), t.child_frame_id] = t
    scenes = {nanoseconds(m.markers[0].header.stamp): m.markers for _, m in topics["/catheter/markers"]}
    names = [column.removesuffix("_status") for column in rows[0] if column.endswith("_status")]
    for row, (_, angles) in zip(rows, each, strict=True):
        what, ns = f"frame {row['seq']}", int(row["stamp_ns"])
        same(f"{what}, names", list(angles.name), ["theta", "theta_sd", "polar", "azimuth"])
        for name, value in zip(angles.name, angles.position, strict=True):
            cell(what, row, f"{name}_deg", math.degrees(value), DEGREE)
        for name in names:
            pose = at.get(f"/catheter/{name}/pose", {}).get(ns)
            same(f"{what}, {name} known", pose is not None, row[f"{name}_status"] == "ok")
            p = pose and pose.pose.pose.position
            for axis in "xyz":
                cell(what, row, f"{name}_{axis}_mm", p and 1e3 * getattr(p, axis), MM)
            covariance = pose is not None and numpy.array(pose.pose.covariance).reshape(6, 6)
            cell(what, row, f"{name}_sd_mm", pose and 1e3 * math.sqrt(numpy.trace(covariance[:3, :3]) / 3), MM)
            if pose is None:
                continue
            if not numpy.allclose(covariance, covariance.T, rtol=0, atol=1e-18):
                raise Difference(f"{what}, {name}: its covariance is not symmetric")
            if numpy.linalg.eigvalsh(covariance).min() < -1e-15:
                raise Difference(f"{what}, {name}: its covariance is negative in a direction")
            q = pose.pose.pose.orientation
            direction = rotate([q.x, q.y, q.z, q.w], [0, 0, 1])
            known = name == "coil" and row["tan_x"] != ""
            if known:
                for axis, value in zip("xyz", direction):
                    cell(what, row, f"tan_{axis}", value, UNIT)
                t, turned = numpy.array(direction), covariance[3:, 3:]
                near(f"{what}, turn about the tube", t @ turned @ t, ANY_ANGLE, 1e-9)
                across = math.degrees(math.sqrt((numpy.trace(turned) - ANY_ANGLE) / 2))
                near(f"{what}, tan_sd_deg", across, float(row["tan_sd_deg"]), DEGREE)
            else:
                same(f"{what}, {name}: nothing known of its turn", [covariance[k, k] for k in (3, 4, 5)], [ANY_ANGLE] * 3)
            band = moved.get((ns, f"catheter_{name}_band"))
            same(f"{what}, {name} on /tf", band is not None, known or name != "coil")
            if band is not None:
                same(f"{what}, {name} on /tf", plain(band.transform.translation), plain(p))
                same(f"{what}, frame of {name}", band.header.frame_id, pose.header.frame_id)
        drawn = [m.id for m in scenes[ns] if m.action == 0 and m.type in (2, 3)]
        same(f"{what}, bands drawn", drawn, [k + 1 for k, name in enumerate(names) if row[f"{name}_status"] == "ok"])

    # Totals: the last is of all frames.
    last = topics["/diagnostics"][-1][1]
    status = {s.name.removeprefix("catoptra: "): s for s in last.status}
    values = {v.key: v.value for v in status["frames"].values}
    same("frames counted", int(values["frames"]), len(rows))
    for name in names:
        missed = Counter(row[f"{name}_status"] for row in rows if row[f"{name}_status"] != "ok")
        same(f"misses of {name}", {v.key: int(v.value) for v in status[name].values}, dict(missed))

    ((_, static),) = topics["/tf_static"]
    chain = [(t.header.frame_id, t.child_frame_id) for t in static.transforms]
    asked = {"/tf": "RELIABLE", "/catheter/markers": "RELIABLE", "/diagnostics": "RELIABLE"}
    for topic, found in qos.items():
        expected = ("TRANSIENT_LOCAL", "RELIABLE") if topic == "/tf_static" else ("VOLATILE", asked.get(topic, "BEST_EFFORT"))
        same(f"quality of service of {topic}", found, expected)
    info = topics["/camera/camera_info"][0][1]
    same("size of the lens", (len(info.d) in (5, 8), len(info.k), len(info.r), len(info.p)), (True, 9, 9, 12))

    counts = {topic: len(messages) for topic, messages in sorted(topics.items())}
    print(json.dumps({"frames": len(rows), "messages": counts, "chain": chain, "types": dict(sorted(types.items()))}))


if __name__ == "__main__":
    try:
        main()
    except Difference as difference:
        sys.exit(str(difference))
