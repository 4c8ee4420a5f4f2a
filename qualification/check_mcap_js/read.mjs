// Reads MCAP files through their index and prints, as JSON, what each topic holds: bytes as a hash, every message decoded.
import { createHash } from "node:crypto";
import { open } from "node:fs/promises";

import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

// JSON knows neither big integers nor typed arrays nor NaN
function plain(value) {
  if (typeof value === "bigint") return value.toString();
  if (typeof value === "number") return Number.isFinite(value) ? value : String(value);
  if (ArrayBuffer.isView(value) || Array.isArray(value)) return Array.from(value, plain);
  if (value !== null && typeof value === "object") {
    return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, plain(inner)]));
  }
  return value;
}

const decompressHandlers = await loadDecompressHandlers();
const topics = {};
const result = { topics, metadata: {}, attachments: {}, profiles: [] };
for (const path of process.argv.slice(2)) {
  const handle = await open(path, "r");
  const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(handle), decompressHandlers });
  result.profiles.push(reader.header.profile);
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const channel = reader.channelsById.get(message.channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    const topic = (topics[channel.topic] ??= {
      type: schema.name,
      schema_encoding: schema.encoding,
      message_encoding: channel.messageEncoding,
      metadata: Object.fromEntries(channel.metadata),
      reader: new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })),
      hash: createHash("sha256"),
      decoded: [],
    });
    topic.hash.update(`${message.logTime} ${message.publishTime} ${message.sequence} ${message.data.byteLength}\n`);
    topic.hash.update(message.data);
    topic.decoded.push(plain(topic.reader.readMessage(message.data)));
  }
  for await (const record of reader.readMetadata()) result.metadata[record.name] = Object.fromEntries(record.metadata);
  for await (const file of reader.readAttachments()) result.attachments[file.name] = file.data.byteLength;
  await handle.close();
}
for (const topic of Object.values(topics)) {
  topic.hash = topic.hash.digest("hex");
  delete topic.reader;
}
console.log(JSON.stringify(result));
