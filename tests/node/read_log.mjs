// Read every topic of a log as Foxglove does, and print topic to [count, first log time, last message] as JSON.
import { readFile } from "node:fs/promises";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { decompress } from "fzstd";

const bytes = await readFile(process.argv[2]);
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, length) => bytes.subarray(Number(offset), Number(offset + length)),
};
const log = await McapIndexedReader.Initialize({ readable, decompressHandlers: { zstd: (data) => decompress(data) } });
const readers = new Map();
const found = {};
for await (const message of log.readMessages()) {
  const channel = log.channelsById.get(message.channelId);
  const schema = log.schemasById.get(channel.schemaId);
  if (!readers.has(channel.id)) {
    readers.set(channel.id, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
    found[channel.topic] = [0, String(message.logTime), null];
  }
  found[channel.topic][0] += 1;
  found[channel.topic][2] = readers.get(channel.id).readMessage(message.data);
}
console.log(JSON.stringify(found, (_, value) => {
  if (typeof value === "bigint") return Number(value);
  return ArrayBuffer.isView(value) ? [...value] : value;
}));
