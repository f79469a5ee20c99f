"""Listens to the topics of `catoptra live --ros2` with another implementation of DDS, Eclipse Cyclone DDS.

    python ros2_listen.py DEFINITIONS.mcap DOMAIN [--send-currents]

The types are made from the definitions in a log of profile ros2. Uses the loopback interface only. Prints `matched`
when every topic has its publisher; ends when its standard input does, and then prints one line of JSON: the messages of
each topic in order of arrival. With --send-currents it publishes currents on /amplifier/joint_states, as soon as every
topic but theirs has been heard: a publisher drops what it has before it knows a subscriber, and when it does only its
messages tell.
"""

import json
import os
import select
import sys
import time

DOMAIN = int(sys.argv[2])
# Before the library is loaded.
os.environ["CYCLONEDDS_URI"] = """<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import annotations, make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from mcap.reader import make_reader

BASE = {"bool": bool, "byte": types.byte, "uint8": types.uint8, "int32": types.int32, "uint32": types.uint32,
        "float32": types.float32, "float64": types.float64, "string": str}
RULE = "=" * 80 + "\n"
KEPT = "/tf_static"
CURRENTS = "/coil/joint_states"
ASKED = {"/tf", "/catheter/markers", "/diagnostics", KEPT}


def types_of(name, text, known):
    """The type of a schema, from its whole text."""
    own, *others = text.split(RULE)
    texts = {name.replace("/msg/", "/"): own}
    for other in others:
        head, body = other.split("\n", 1)
        texts[head.removeprefix("MSG: ")] = body

    def made(of):
        if of in BASE:
            return BASE[of]
        if of not in known:
            fields = {}
            for line in texts[of].splitlines():
                kind, field = line.split()
                if "=" in field:
                    continue
                inner, _, count = kind.rstrip("]").partition("[")
                fields[field] = made(inner)
                if "[" in kind:
                    fields[field] = types.array[made(inner), int(count)] if count else types.sequence[made(inner)]
            package, short = of.split("/")
            struct = make_idl_struct(short, f"{package}::msg::dds_::{short}_", fields)
            known[of] = annotations.final(struct)
        return known[of]

    return made(name.replace("/msg/", "/"))


def plain(value):
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if hasattr(value, "__dict__"):
        return {key: plain(item) for key, item in vars(value).items() if key != "sample_info"}
    # NaN has no place in JSON.
    return None if isinstance(value, float) and value != value else value


def main():
    with open(sys.argv[1], "rb") as file:
        summary = make_reader(file).get_summary()
    schemas = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
    participant = DomainParticipant(DOMAIN)
    known, readers, received = {}, {}, {}
    for topic, schema in schemas.items():
        # Pictures are not taken live, and nothing is wrapped there.
        if schema.name.endswith(("UInt8MultiArray", "CompressedImage")):
            continue
        struct = types_of(schema.name, schema.data.decode(), known)
        reliability = Policy.Reliability.Reliable(duration(seconds=1)) if topic in ASKED else Policy.Reliability.BestEffort
        durability = Policy.Durability.TransientLocal if topic == KEPT else Policy.Durability.Volatile
        qos = Qos(reliability, durability, Policy.History.KeepLast(10000))
        readers[topic] = DataReader(participant, Topic(participant, f"rt{topic}", struct, qos=qos), qos=qos)
        received[topic] = []
    writer = None
    if "--send-currents" in sys.argv:
        struct = known["sensor_msgs/JointState"]
        qos = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(10))
        writer = DataWriter(participant, Topic(participant, "rt/amplifier/joint_states", struct, qos=qos), qos=qos)

    def take():
        for topic, reader in readers.items():
            # That a publisher has gone is told by a sample without data.
            received[topic].extend(plain(sample) for sample in reader.take(N=1000) if sample.sample_info.valid_data)

    def matched(entity, publisher):
        ids = entity.get_matched_subscriptions() if publisher else entity.get_matched_publications()
        return len(ids) > 0

    told, sends, count, last = False, False, 0, 0.0
    while True:
        if not told and all(matched(reader, False) for reader in readers.values()) \
                and (writer is None or matched(writer, True)):
            print("matched", flush=True)
            told = True
        take()
        sends = sends or all(got for topic, got in received.items() if topic != CURRENTS)
        if writer is not None and sends and time.monotonic() - last > 0.05:
            last = time.monotonic()
            ns = time.time_ns()
            stamp = known["builtin_interfaces/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header = known["std_msgs/Header"](stamp=stamp, frame_id="")
            writer.write(known["sensor_msgs/JointState"](header=header, name=["a", "b"], position=[], velocity=[],
                                                         effort=[count % 64 / 8, -0.5]))
            count += 1
        if select.select([sys.stdin], [], [], 0.002)[0] and not sys.stdin.read(1):
            break
    time.sleep(0.3)
    take()
    print(json.dumps({"sent": count, "received": received}))


if __name__ == "__main__":
    main()
