#!/usr/bin/env python3
"""Subscribes to every topic of a running `catoptra live --publish`, decodes all messages with the schemas that the server
sends, and prints one JSON object: messages by topic, and θ of each frame as (seq, radians or null).

Uses independent libraries: `websockets` and `protobuf`.
"""

import argparse
import asyncio
import base64
import json
import math
import struct

import websockets
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory


def message_class(channel):
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


async def connect(url):
    for _ in range(200):
        try:
            return await websockets.connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None)
        except OSError:
            await asyncio.sleep(0.05)
    raise SystemExit(f"nobody answers at {url}")


async def main(url):
    counts, angles, classes = {}, [], {}
    async with await connect(url) as socket:
        try:
            async for said in socket:
                if isinstance(said, str):
                    said = json.loads(said)
                    if said["op"] == "advertise":
                        for channel in said["channels"]:
                            classes[channel["id"]] = (channel["topic"], message_class(channel))
                        wanted = [{"id": c["id"], "channelId": c["id"]} for c in said["channels"]]
                        await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                elif said[0] == 1:
                    subscription, time_ns = struct.unpack_from("<IQ", said, 1)
                    topic, message = classes[subscription]
                    decoded = message.FromString(bytes(said[13:]))
                    assert time_ns > 1_600_000_000_000_000_000, f"{topic} is stamped {time_ns}"
                    counts[topic] = counts.get(topic, 0) + 1
                    if topic == "/catheter/deflection":
                        theta = decoded.theta_rad
                        angles.append((decoded.seq, None if math.isnan(theta) else theta))
        except websockets.ConnectionClosed:
            pass
    print(json.dumps({"counts": counts, "angles": angles}))


arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
arguments.add_argument("url")
asyncio.run(main(arguments.parse_args().url))
