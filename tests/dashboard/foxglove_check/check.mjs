// Listens to a bridge with the official Foxglove client and says on standard output, as JSON, what it got.
//
//   node check.mjs URL TOPIC=COUNT...    until each topic gave so many messages, or 20 s are over
//   node check.mjs URL --publish TOPIC JSON TOPIC=COUNT...    publishes first
//
// CDR is decoded by the omgidl schema that the channel came with; JSON is checked against the official schema
// of @foxglove/schemas, not the one that the bridge sent. Whole numbers of 64 bits are written as strings.
import omgidl from "@foxglove/omgidl-parser";
import serialization from "@foxglove/omgidl-serialization";
import * as schemas from "@foxglove/schemas/jsonschema";
import protocol from "@foxglove/ws-protocol";
import Ajv from "ajv";
import WebSocket from "ws";

const [url, ...rest] = process.argv.slice(2);
const publish = rest[0] === "--publish" ? { topic: rest[1], json: rest[2] } : undefined;
const wanted = new Map(
  rest.slice(publish ? 3 : 0).map((word) => [word.split("=")[0], Number(word.split("=")[1])]),
);
if (url == undefined || wanted.size === 0) {
  console.error("usage: check.mjs URL [--publish TOPIC JSON] TOPIC=COUNT...");
  process.exit(2);
}

const official = schemas.default ?? schemas;
const found = { server: null, channels: {}, messages: {}, statuses: [] };
const decoders = new Map();
const ajv = new Ajv({ strict: false, validateFormats: false });
const { FoxgloveClient } = protocol;
const client = new FoxgloveClient({ ws: new WebSocket(url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });

function decoderOf(channel) {
  if (channel.encoding === "cdr") {
    const reader = new serialization.MessageReader(channel.schemaName, omgidl.parseIDL(channel.schema));
    return (data) => reader.readMessage(data);
  }
  const valid = ajv.compile(official[channel.schemaName.replace("foxglove.", "")]);
  return (data) => {
    const value = JSON.parse(new TextDecoder().decode(data));
    if (!valid(value)) throw new Error(`${channel.topic}: ${ajv.errorsText(valid.errors)}`);
    return value;
  };
}

function end(code) {
  const plain = (_, value) => {
    if (typeof value === "bigint") return value.toString();
    if (ArrayBuffer.isView(value)) return Array.from(value);
    return value;
  };
  console.log(JSON.stringify(found, plain));
  process.exit(code);
}

client.on("error", (error) => { console.error(error.message); process.exit(1); });
client.on("serverInfo", (info) => { found.server = info; });
client.on("status", (status) => found.statuses.push(status));
client.on("advertise", (channels) => {
  for (const channel of channels) {
    found.channels[channel.topic] = {
      encoding: channel.encoding, schemaName: channel.schemaName, schemaEncoding: channel.schemaEncoding,
    };
    if (!wanted.has(channel.topic)) continue;
    found.messages[channel.topic] = [];
    decoders.set(client.subscribe(channel.id), { topic: channel.topic, decode: decoderOf(channel) });
  }
  if (publish) {
    const id = client.advertise({ topic: publish.topic, encoding: "json", schemaName: "" });
    client.sendMessage(id, new TextEncoder().encode(publish.json));
  }
});
client.on("message", (event) => {
  const { topic, decode } = decoders.get(event.subscriptionId);
  try {
    found.messages[topic].push({ time: event.timestamp, value: decode(event.data) });
  } catch (error) {
    console.error(error.message);
    process.exit(1);
  }
  if ([...wanted].every(([name, count]) => (found.messages[name] ?? []).length >= count)) end(0);
});
setTimeout(() => end(3), 20000);
