// A recording as long as an hour's, of one of a few seconds: the same messages after a large attachment.
import { readFileSync, writeFileSync } from "node:fs";
import { McapStreamReader, McapWriter } from "@mcap/core";
import { decompress } from "fzstd";

export async function lengthen(file: string, to: string, bytes: number): Promise<void> {
  const reader = new McapStreamReader({
    validateCrcs: true, decompressHandlers: { zstd: (packed, size) => decompress(packed, new Uint8Array(Number(size))) },
  });
  reader.append(readFileSync(file));
  const parts: Uint8Array[] = [];
  let length = 0n;
  const writer = new McapWriter({
    writable: {
      position: () => length,
      write: async (part) => { parts.push(part.slice()); length += BigInt(part.byteLength); },
    },
  });
  const schemas = new Map<number, number>();
  const channels = new Map<number, number>();
  for (let record = reader.nextRecord(); record; record = reader.nextRecord()) {
    if (record.type === "Header") {
      await writer.start(record);
      await writer.addAttachment({ logTime: 0n, createTime: 0n, name: "notes.bin", mediaType: "application/octet-stream", data: new Uint8Array(bytes) });
    } else if (record.type === "Schema" && !schemas.has(record.id)) {
      schemas.set(record.id, await writer.registerSchema(record));
    } else if (record.type === "Channel" && !channels.has(record.id)) {
      channels.set(record.id, await writer.registerChannel({ ...record, schemaId: schemas.get(record.schemaId)! }));
    } else if (record.type === "Message") {
      await writer.addMessage({ ...record, channelId: channels.get(record.channelId)! });
    }
  }
  await writer.end();
  writeFileSync(to, Buffer.concat(parts));
}
