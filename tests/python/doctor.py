"""Examines a log by the rules of `mcap doctor` and of the format's specification, byte by byte and without its library.

    python doctor.py LOG.mcap

Errors: what a reader may stumble over. Warnings: what `mcap doctor` warns of, with `strict` order the times as well. Prints one
line of JSON; exit code 1 and all errors when there are any. Schemas are parsed by `google.protobuf`.
"""

import argparse
import collections
import json
import struct
import sys
import zlib

import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
SUMMARY_ORDER = (SCHEMA, CHANNEL, STATISTICS, CHUNK_INDEX, ATTACHMENT_INDEX, METADATA_INDEX)


class Fields:
    """Little-endian fields, one after the other."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, form):
        size = struct.calcsize("<" + form)
        values = struct.unpack("<" + form, self.raw(size))
        return values[0] if len(values) == 1 else values

    def raw(self, size):
        if self.at + size > len(self.data):
            raise ValueError(f"a field of {size} bytes goes beyond its record")
        self.at += size
        return self.data[self.at - size:self.at]

    def text(self):
        return self.raw(self.take("I")).decode()

    def blob(self, form="I"):
        return self.raw(self.take(form))

    def pairs(self, read_key, read_value):
        inner = Fields(self.blob())
        pairs = []
        while inner.at < len(inner.data):
            pairs.append((read_key(inner), read_value(inner)))
        return pairs


def records(data, start, end, errors, where):
    """(offset, opcode, content) of the records between two offsets."""
    at = start
    while at < end:
        if at + 9 > end:
            errors.append(f"{where}: {end - at} bytes after the last record")
            return
        opcode, length = struct.unpack_from("<BQ", data, at)
        if at + 9 + length > end:
            errors.append(f"{where}: record {opcode} at {at} goes beyond the end")
            return
        yield at, opcode, data[at + 9:at + 9 + length]
        at += 9 + length


class Doctor:
    def __init__(self, data):
        self.data, self.errors, self.warnings = data, [], []
        self.schemas, self.channels = {}, {}
        self.counts, self.latest, self.earliest = collections.Counter(), 0, None
        self.chunks, self.attachments, self.metadata = {}, {}, {}

    def error(self, text):
        self.errors.append(text)

    def schema(self, content, summary):
        f = Fields(content)
        number, name, encoding, data = f.take("H"), f.text(), f.text(), f.blob()
        if number == 0:
            self.error("schema 0 is reserved")
        if encoding != "protobuf" or not data:
            self.error(f"schema {name}: encoding {encoding!r}, {len(data)} bytes")
        known = self.schemas.get(number)
        if summary and known is None:
            self.error(f"schema {number} is in the summary only")
        if known is not None and known != (name, encoding, data):
            self.error(f"two schemas with number {number}")
        if known is not None and not summary:
            self.warnings.append(f"schema {number} is written twice")
        self.schemas[number] = (name, encoding, data)
        if known is None:
            try:
                pool = descriptor_pool.DescriptorPool()
                for file in descriptor_pb2.FileDescriptorSet.FromString(data).file:
                    pool.Add(file)
                pool.FindMessageTypeByName(name)
            except Exception as refused:
                self.error(f"schema {name}: {refused}")

    def channel(self, content, summary):
        f = Fields(content)
        number, schema, topic, encoding = f.take("H"), f.take("H"), f.text(), f.text()
        metadata = f.pairs(Fields.text, Fields.text)
        known = self.channels.get(number)
        if schema == 0 or schema not in self.schemas:
            self.error(f"channel {topic}: schema {schema} is not there before it")
        if encoding != "protobuf":
            self.error(f"channel {topic}: message encoding {encoding!r}")
        if summary and known is None:
            self.error(f"channel {number} is in the summary only")
        if known is not None and known != (schema, topic, encoding, metadata):
            self.error(f"two channels with number {number}")
        if known is not None and not summary:
            self.warnings.append(f"channel {number} is written twice")
        self.channels[number] = (schema, topic, encoding, metadata)

    def chunk(self, offset, content, indexes):
        f = Fields(content)
        start, end, size, crc = f.take("Q"), f.take("Q"), f.take("Q"), f.take("I")
        compression, inner = f.text(), f.blob("Q")
        where = f"chunk at {offset}"
        stored = len(inner)
        if compression == "zstd":
            inner = zstandard.ZstdDecompressor().decompress(inner, max_output_size=size)
        elif compression:
            return self.error(f"{where}: compressed by {compression}")
        if len(inner) != size:
            self.error(f"{where}: {len(inner)} bytes, says {size}")
        if crc == 0 or zlib.crc32(inner) != crc:
            self.error(f"{where}: checksum {zlib.crc32(inner):08x}, says {crc:08x}")
        times, found = [], collections.defaultdict(list)
        for at, opcode, data in records(inner, 0, len(inner), self.errors, where):
            if opcode == SCHEMA:
                self.schema(data, False)
            elif opcode == CHANNEL:
                self.channel(data, False)
            elif opcode == MESSAGE:
                channel, _, log_time, publish_time = struct.unpack_from("<HIQQ", data)
                if channel not in self.channels:
                    self.error(f"{where}: message of channel {channel}, which is not there before it")
                    continue
                if log_time == 0 or publish_time == 0:
                    self.error(f"{where}: a message of {self.channels[channel][1]} has time 0")
                if log_time < self.latest:
                    self.warnings.append(f"{self.channels[channel][1]}: {log_time} after {self.latest}")
                self.latest = max(self.latest, log_time)
                times.append(log_time)
                found[channel].append((log_time, at))
                self.counts[channel] += 1
            else:
                self.error(f"{where}: record {opcode} inside")
        if times:
            if (start, end) != (min(times), max(times)):
                self.error(f"{where}: times {min(times)} to {max(times)}, says {start} to {end}")
            self.earliest = min(times) if self.earliest is None else min(self.earliest, min(times))
        if {c: sorted(e) for c, e in indexes.items() if e} != {c: sorted(e) for c, e in found.items()}:
            self.error(f"{where}: its message indexes are not those of its messages")
        return start, end, len(content) + 9, size, stored, compression

    def examine(self):
        data = self.data
        if data[:8] != MAGIC or data[-8:] != MAGIC:
            return self.error("no magic at the beginning or the end")
        footer_at = len(data) - 8 - 9 - 20
        if struct.unpack_from("<BQ", data, footer_at) != (FOOTER, 20):
            return self.error("no footer before the last magic")
        summary, offsets, summary_crc = struct.unpack_from("<QQI", data, footer_at + 9)
        # The data section.
        pending, data_end = None, None
        for at, opcode, content in records(data, 8, summary or footer_at, self.errors, "data"):
            if at == 8 and opcode != HEADER:
                self.error("the first record is no header")
            if data_end is not None:
                self.error(f"record {opcode} after the end of the data")
            if opcode != MESSAGE_INDEX and pending:
                self.close(pending)
                pending = None
            f = Fields(content)
            if opcode == HEADER:
                profile, library = f.text(), f.text()
                if at != 8 or profile or not library.startswith("catoptra/"):
                    self.error(f"header at {at}: profile {profile!r}, library {library!r}")
            elif opcode == SCHEMA:
                self.schema(content, False)
            elif opcode == CHANNEL:
                self.channel(content, False)
            elif opcode == CHUNK:
                pending = (at, content, {}, {})
            elif opcode == MESSAGE_INDEX:
                if pending is None:
                    self.error(f"message index at {at} without a chunk")
                    continue
                channel = f.take("H")
                if channel in pending[2]:
                    self.warnings.append(f"two message indexes of channel {channel} for one chunk")
                pending[2][channel] = f.pairs(lambda x: x.take("Q"), lambda x: x.take("Q"))
                pending[3][channel] = (at, at + 9 + len(content))
            elif opcode == ATTACHMENT:
                log, create, name, media, body, crc = f.take("Q"), f.take("Q"), f.text(), f.text(), f.blob("Q"), f.take("I")
                if crc == 0 or zlib.crc32(content[:-4]) != crc:
                    self.error(f"attachment {name}: checksum {zlib.crc32(content[:-4]):08x}, says {crc:08x}")
                self.attachments[at] = (len(content) + 9, log, create, len(body), name, media)
            elif opcode == METADATA:
                self.metadata[at] = (len(content) + 9, f.text())
            elif opcode == DATA_END:
                data_end = f.take("I")
                if data_end and zlib.crc32(data[:at]) != data_end:
                    self.error("the checksum of the data is wrong")
            else:
                self.error(f"record {opcode} at {at} among the data")
        if pending:
            self.close(pending)
        if data_end is None:
            self.error("the data have no end record")
        if not summary:
            return self.error("there is no summary")
        self.summary(summary, offsets, footer_at, summary_crc)

    def close(self, pending):
        at, content, indexes, places = pending
        checked = self.chunk(at, content, indexes)
        if checked:
            self.chunks[at] = (*checked, places)

    def summary(self, start, offsets, end, crc):
        data = self.data
        if crc == 0 or zlib.crc32(data[start:end + 9 + 16]) != crc:
            self.error("the checksum of the summary is wrong")
        groups, seen = {}, collections.defaultdict(set)
        for at, opcode, content in records(data, start, offsets or end, self.errors, "summary"):
            f = Fields(content)
            first, length = groups.get(opcode, (at, 0))
            if opcode not in SUMMARY_ORDER or (length and first + length != at):
                self.error(f"record {opcode} at {at} in the summary, not beside those of its kind")
            groups[opcode] = (first, length + 9 + len(content))
            if opcode == SCHEMA:
                self.schema(content, True)
                seen[SCHEMA].add(Fields(content).take("H"))
            elif opcode == CHANNEL:
                self.channel(content, True)
                seen[CHANNEL].add(Fields(content).take("H"))
            elif opcode == CHUNK_INDEX:
                begin, finish, offset, size = f.take("Q"), f.take("Q"), f.take("Q"), f.take("Q")
                places = dict(f.pairs(lambda x: x.take("H"), lambda x: x.take("Q")))
                index_size, compression = f.take("Q"), f.text()
                compressed, uncompressed = f.take("Q"), f.take("Q")
                chunk = self.chunks.get(offset)
                if chunk is None or offset in seen[opcode]:
                    self.error(f"chunk index of {offset}: no such chunk, or the second one")
                    continue
                seen[opcode].add(offset)
                own = {channel: place[0] for channel, place in chunk[6].items()}
                if (begin, finish, size, uncompressed, compressed, compression) != chunk[:6]:
                    self.error(f"chunk index of {offset} is not that of its chunk")
                if places != own or index_size != sum(b - a for a, b in chunk[6].values()):
                    self.error(f"chunk index of {offset}: its message indexes are elsewhere")
            elif opcode == ATTACHMENT_INDEX:
                offset = f.take("Q")
                found = (f.take("Q"), f.take("Q"), f.take("Q"), f.take("Q"), f.text(), f.text())
                seen[opcode].add(offset)
                if self.attachments.get(offset) != found:
                    self.error(f"attachment index of {offset}: {found} instead of {self.attachments.get(offset)}")
            elif opcode == METADATA_INDEX:
                offset, found = f.take("Q"), (f.take("Q"), f.text())
                seen[opcode].add(offset)
                if self.metadata.get(offset) != found:
                    self.error(f"metadata index of {offset}: {found} instead of {self.metadata.get(offset)}")
            elif opcode == STATISTICS:
                if seen[opcode]:
                    self.error("two statistics")
                seen[opcode].add(0)
                found = f.take("QHIIIIQQ")
                counts = dict(f.pairs(lambda x: x.take("H"), lambda x: x.take("Q")))
                own = (sum(self.counts.values()), len(self.schemas), len(self.channels), len(self.attachments),
                       len(self.metadata), len(self.chunks), self.earliest or 0, self.latest)
                if found != own:
                    self.error(f"statistics {found}, found {own}")
                if {c: n for c, n in counts.items() if n} != dict(self.counts):
                    self.error(f"statistics of channels {counts}, found {dict(self.counts)}")
        for kind, own in [(SCHEMA, self.schemas), (CHANNEL, self.channels), (CHUNK_INDEX, self.chunks),
                          (ATTACHMENT_INDEX, self.attachments), (METADATA_INDEX, self.metadata), (STATISTICS, {0: 0})]:
            if set(own) != seen[kind]:
                self.error(f"records of kind {kind} in the summary: {sorted(seen[kind])}, in the data: {sorted(own)}")
        for at, opcode, content in records(data, offsets or end, end, self.errors, "summary offsets"):
            if opcode != SUMMARY_OFFSET:
                self.error(f"record {opcode} among the summary offsets")
                continue
            kind, first, length = Fields(content).take("BQQ")
            if groups.pop(kind, None) != (first, length):
                self.error(f"summary offset of kind {kind} is wrong")
        if offsets and groups:
            self.error(f"kinds {sorted(groups)} have no summary offset")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log")
    with open(parser.parse_args().log, "rb") as file:
        doctor = Doctor(file.read())
    try:
        doctor.examine()
    except (ValueError, struct.error, UnicodeDecodeError) as broken:
        doctor.error(f"cannot be read: {broken}")
    for error in doctor.errors:
        print(error, file=sys.stderr)
    topics = {topic: doctor.counts[number] for number, (_, topic, _, _) in sorted(doctor.channels.items())}
    told = {"chunks": len(doctor.chunks), "messages": sum(doctor.counts.values()), "topics": topics,
            "out_of_order": len([w for w in doctor.warnings if " after " in w]), "warnings": doctor.warnings[:5]}
    print(json.dumps(told))
    return 1 if doctor.errors else 0


if __name__ == "__main__":
    sys.exit(main())
