// Reads a recording with the official MCAP reader and says on standard output, as JSON, what it found.
//
//   node check.mjs FILE                  by index; every CRC checked, that of the data section included
//   node check.mjs FILE --stream         from the beginning, as far as it goes: for files cut short
//   node check.mjs FILE --decode TOPIC   by index, and the messages of one topic (or of those that end with it),
//                                        decoded with the file's own omgidl schema
//
// The CRC of a topic is over sequence, log time and publish time (64 bits each) and data of its messages.
// Whole numbers of 64 bits are written as strings. Ends with 1 and a reason when the file is not sound.
import { readFileSync } from "node:fs";
import { crc32, crc32Final, crc32Init, crc32Update } from "@foxglove/crc";
import zstd from "@foxglove/wasm-zstd";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { parseIDL } from "@foxglove/omgidl-parser";
import { MessageReader } from "@foxglove/omgidl-serialization";

const [file, mode, wanted] = process.argv.slice(2);
if (file == undefined || ![undefined, "--stream", "--decode"].includes(mode) ||
    (mode === "--decode") !== (wanted != undefined)) {
  console.error("usage: check.mjs FILE [--stream | --decode TOPIC]");
  process.exit(2);
}

await zstd.isLoaded;
const decompressHandlers = {
  zstd: (data, size) => new Uint8Array(zstd.decompress(data, Number(size))),
};

const bytes = new Uint8Array(readFileSync(file));
const schemas = new Map();
const channels = new Map();
const found = {
  finished: false, messages: 0, first: null, last: null, ordered: true,
  topics: {}, metadata: {}, attachments: [],
};
if (mode === "--decode") found.decoded = [];
const readers = new Map();

// An IDL type as DDS calls it (pkg::msg::dds_::Type_) or ROS 2 (pkg/msg/Type), as the IDL says it.
function idlName(name) {
  return name.replaceAll("/", "::").replace(/::dds_::(\w+)_$/, "::$1");
}

function readerFor(channel) {
  let reader = readers.get(channel.id);
  if (reader == undefined) {
    const schema = schemas.get(channel.schemaId);
    if (schema?.encoding !== "omgidl") {
      throw new Error(`${channel.topic}: found schema encoding ${schema?.encoding}, expected omgidl`);
    }
    reader = new MessageReader(idlName(schema.name), parseIDL(new TextDecoder().decode(schema.data)));
    readers.set(channel.id, reader);
  }
  return reader;
}

function topicOf(channel) {
  const schema = schemas.get(channel.schemaId);
  found.topics[channel.topic] ??= {
    messages: 0, message_encoding: channel.messageEncoding,
    schema_name: schema?.name, schema_encoding: schema?.encoding,
    schema_text: schema == undefined ? undefined : new TextDecoder().decode(schema.data),
    first: null, last: null, crc: crc32Init(),
  };
  return found.topics[channel.topic];
}

function takeMessage(message) {
  const channel = channels.get(message.channelId);
  const topic = topicOf(channel);
  topic.messages++;
  topic.first ??= message.logTime;
  topic.last = message.logTime;
  const times = BigUint64Array.of(BigInt(message.sequence), message.logTime, message.publishTime);
  topic.crc = crc32Update(crc32Update(topic.crc, new Uint8Array(times.buffer)), message.data);
  found.messages++;
  if (found.last != null && message.logTime < found.last) found.ordered = false;
  if (found.first == null || message.logTime < found.first) found.first = message.logTime;
  if (found.last == null || message.logTime > found.last) found.last = message.logTime;
  if (wanted != undefined && channel.topic.endsWith(wanted)) {
    found.decoded.push({
      topic: channel.topic, sequence: message.sequence, log_time: message.logTime,
      publish_time: message.publishTime, value: readerFor(channel).readMessage(message.data),
    });
  }
}

function takeMetadata(record) {
  found.metadata[record.name] = Object.fromEntries(record.metadata);
}

function takeAttachment(record) {
  found.attachments.push({
    name: record.name, media_type: record.mediaType, log_time: record.logTime,
    size: record.data.byteLength, crc: crc32(record.data),
  });
}

async function byIndex() {
  const readable = {
    size: async () => BigInt(bytes.byteLength),
    read: async (offset, size) => {
      if (offset + size > bytes.byteLength) throw new Error(`read of ${size} at ${offset}: past the end`);
      return bytes.subarray(Number(offset), Number(offset + size));
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  for (const [id, schema] of reader.schemasById) schemas.set(id, schema);
  for (const [id, channel] of reader.channelsById) {
    channels.set(id, channel);
    topicOf(channel);
  }
  const dataCrc = crc32(bytes.subarray(0, Number(reader.dataEndOffset)));
  if (reader.dataSectionCrc !== dataCrc) {
    throw new Error(`data section: found CRC ${dataCrc}, expected ${reader.dataSectionCrc}`);
  }
  if (reader.footer.summaryCrc === 0) throw new Error("the summary has no CRC");
  for await (const message of reader.readMessages({ validateCrcs: true })) takeMessage(message);
  for await (const record of reader.readMetadata()) takeMetadata(record);
  for await (const record of reader.readAttachments({ validateCrcs: true })) takeAttachment(record);

  const statistics = reader.statistics;
  const counted = (what, is, says) => {
    if (BigInt(is) !== BigInt(says)) throw new Error(`statistics: ${what}: found ${is}, it says ${says}`);
  };
  counted("messages", found.messages, statistics.messageCount);
  counted("schemas", schemas.size, statistics.schemaCount);
  counted("channels", channels.size, statistics.channelCount);
  counted("chunks", reader.chunkIndexes.length, statistics.chunkCount);
  counted("attachments", found.attachments.length, statistics.attachmentCount);
  counted("metadata", reader.metadataIndexes.length, statistics.metadataCount);
  counted("first time", found.first ?? 0n, statistics.messageStartTime);
  counted("last time", found.last ?? 0n, statistics.messageEndTime);
  for (const channel of channels.values()) {
    counted(channel.topic, found.topics[channel.topic].messages,
            statistics.channelMessageCounts.get(channel.id) ?? 0n);
  }
  for (const [opcode, offset] of reader.summaryOffsetsByOpcode) {
    const at = Number(offset.groupStart);
    if (bytes[at] !== opcode) throw new Error(`summary offset of ${opcode}: found ${bytes[at]} at ${at}`);
  }
  found.library = reader.header.library;
  found.profile = reader.header.profile;
  found.chunks = reader.chunkIndexes.length;
  found.compressions = [...new Set(reader.chunkIndexes.map((chunk) => chunk.compression))];
  found.summary_offsets = [...reader.summaryOffsetsByOpcode.keys()].sort((a, b) => a - b);
  found.finished = true;
}

function fromTheBeginning() {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  reader.append(bytes);
  for (let record; (record = reader.nextRecord()) != undefined; ) {
    if (record.type === "Schema") schemas.set(record.id, record);
    if (record.type === "Channel") channels.set(record.id, record);
    if (record.type === "Message") takeMessage(record);
    if (record.type === "Metadata") takeMetadata(record);
    if (record.type === "Attachment") takeAttachment(record);
  }
  found.finished = reader.done();
}

try {
  if (mode === "--stream") fromTheBeginning();
  else await byIndex();
} catch (error) {
  console.error(`${file}: ${error.message}`);
  process.exit(1);
}
for (const topic of Object.values(found.topics)) topic.crc = crc32Final(topic.crc);
const plain = (_, value) => {
  if (typeof value === "bigint") return value.toString();
  if (ArrayBuffer.isView(value)) return Array.from(value);
  return value;
};
console.log(JSON.stringify(found, plain));
