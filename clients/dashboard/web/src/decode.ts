// CDR payloads to objects, by the schema that the channel brings.
import { parseIDL } from "@foxglove/omgidl-parser";
import { MessageReader } from "@foxglove/omgidl-serialization";

/// What of a channel is needed to read its messages.
export interface Schema { schemaName: string; schema: string; schemaEncoding?: string }

const parsed = new Map<string, ReturnType<typeof parseIDL>>();
const readers = new Map<string, MessageReader>();

// An IDL type as DDS calls it (pkg::msg::dds_::Type_) or ROS 2 (pkg/msg/Type), as the IDL says it.
export function idlName(name: string): string {
  return name.replaceAll("/", "::").replace(/::dds_::(\w+)_$/, "::$1");
}

/// Throws when the schema is none, or the bytes are not a message of it.
export function decode(channel: Schema, data: ArrayBufferView): unknown {
  const key = channel.schemaName + "\n" + channel.schema;
  let reader = readers.get(key);
  if (reader == undefined) {
    let definitions = parsed.get(channel.schema);
    if (definitions == undefined) parsed.set(channel.schema, (definitions = parseIDL(channel.schema)));
    readers.set(key, (reader = new MessageReader(idlName(channel.schemaName), definitions)));
  }
  return reader.readMessage(data);
}
