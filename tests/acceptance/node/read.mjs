// Prints one JSON line for each message of the MCAP files named, read with the TypeScript library.
// Sealed files are read through their index, unfinished ones as a stream.

import { open, readFile } from "node:fs/promises";

import { loadDecompressHandlers } from "@mcap/support";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";

const decompressHandlers = await loadDecompressHandlers();

function typeOf(schema) {
  const set = descriptor.FileDescriptorSet.decode(schema.data);
  return protobuf.Root.fromDescriptor(set).lookupType(schema.name);
}

function print(path, channels, schemas, message) {
  const channel = channels.get(message.channelId);
  const type = typeOf(schemas.get(channel.schemaId));
  const value = type.toObject(type.decode(message.data), {
    longs: String,
    bytes: String,
    enums: String,
    defaults: true,
  });
  const logTime = String(message.logTime);
  console.log(JSON.stringify({ path, topic: channel.topic, logTime, value }));
}

async function readIndexed(path) {
  const file = await open(path);
  try {
    const readable = new FileHandleReadable(file);
    const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
    for await (const message of reader.readMessages()) {
      print(path, reader.channelsById, reader.schemasById, message);
    }
  } finally {
    await file.close();
  }
}

async function readStream(path) {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  const schemas = new Map();
  const channels = new Map();
  reader.append(await readFile(path));
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Schema") schemas.set(record.id, record);
    if (record.type === "Channel") channels.set(record.id, record);
    if (record.type === "Message") print(path, channels, schemas, record);
  }
}

for (const path of process.argv.slice(2)) {
  await (path.includes("/hot/") ? readStream(path) : readIndexed(path));
}
