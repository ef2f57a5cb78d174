// Recordings (MCAP) as the player reads them: by their index, a few chunks at a time, from the bridge by
// ranges or from a file of the user's disk. docs/players.md
import { McapIndexedReader, McapStreamReader, type McapTypes } from "@mcap/core";
import { decompress as unzstd } from "fzstd";
import { decompress as unlz4 } from "lz4js";
import type { Schema } from "../decode";

export interface Recorded { name: string; schema: Schema; time: bigint; data: Uint8Array }

/// What can be read in pieces: a part of the MCAP library's own interface.
export interface Bytes { size(): Promise<bigint>; read(offset: bigint, size: bigint): Promise<Uint8Array> }

const BLOCK = 512 * 1024;
const BLOCKS = 48;
const WHOLE = 256 * 1024 * 1024;  // a file without index is held in memory up to here [bytes]
const LONG = 16 * 1024 * 1024;    // from here on its states are read from the bridge's extract [bytes]
const POLL = 400;                 // [ms]
const SLICE = 4 * 1024 * 1024;

const decompressHandlers: McapTypes.DecompressHandlers = {
  zstd: (packed, size) => unzstd(packed, new Uint8Array(Number(size))),
  lz4: (packed, size) => {
    const out = unlz4(packed, Number(size));
    if (out.length !== Number(size)) throw new Error(`lz4: expected a chunk of ${size} bytes`);
    return out;
  },
};

export class BlobBytes implements Bytes {
  constructor(private readonly blob: Blob) {}
  async size(): Promise<bigint> { return BigInt(this.blob.size); }
  async read(offset: bigint, size: bigint): Promise<Uint8Array> {
    if (offset + size > BigInt(this.blob.size)) throw new Error(`the file ends before byte ${offset + size}`);
    return new Uint8Array(await this.blob.slice(Number(offset), Number(offset + size)).arrayBuffer());
  }
}

/// A file of the bridge, in blocks of which the last used are kept.
export class HttpBytes implements Bytes {
  private readonly blocks = new Map<number, Promise<Uint8Array>>();
  private length: bigint | null = null;
  private tag = "";

  constructor(private readonly url: string) {}

  async size(): Promise<bigint> {
    if (this.length == null) {
      const answer = await fetch(this.url, { headers: { range: "bytes=0-0" }, cache: "no-store" });
      if (!answer.ok) throw new Error(await reason(answer));
      const whole = /\/(\d+)$/.exec(answer.headers.get("content-range") ?? "");
      if (answer.status !== 206 || !whole) throw new Error("the bridge sends no part of the file");
      this.length = BigInt(whole[1]!);
      this.tag = answer.headers.get("etag") ?? "";
    }
    return this.length;
  }

  async read(offset: bigint, size: bigint): Promise<Uint8Array> {
    const end = Number(offset + size);
    if (BigInt(end) > await this.size()) throw new Error(`the file ends before byte ${end}`);
    const out = new Uint8Array(Number(size));
    const first = Math.floor(Number(offset) / BLOCK);
    const last = Math.floor(Math.max(end - 1, Number(offset)) / BLOCK);
    const blocks = await Promise.all(Array.from({ length: last - first + 1 }, (_, i) => this.block(first + i)));
    blocks.forEach((block, i) => {
      const at = (first + i) * BLOCK - Number(offset);
      const from = Math.max(0, -at);
      out.set(block.subarray(from, Math.min(block.length, end - (first + i) * BLOCK)), at + from);
    });
    return out;
  }

  private block(i: number): Promise<Uint8Array> {
    const known = this.blocks.get(i);
    this.blocks.delete(i);
    const block = known ?? this.fetch(i);
    this.blocks.set(i, block);  // the last used stands last
    if (this.blocks.size > BLOCKS) this.blocks.delete(this.blocks.keys().next().value!);
    block.catch(() => this.blocks.delete(i));
    return block;
  }

  private async fetch(i: number): Promise<Uint8Array> {
    const end = Math.min((i + 1) * BLOCK, Number(this.length)) - 1;
    const answer = await fetch(this.url, { headers: { range: `bytes=${i * BLOCK}-${end}`, "if-range": this.tag }, cache: "no-store" });
    if (answer.status === 200) throw new Error("the file has changed; open it again");
    if (!answer.ok) throw new Error(await reason(answer));
    return new Uint8Array(await answer.arrayBuffer());
  }
}

async function reason(answer: Response): Promise<string> {
  const { error } = await answer.json().catch(() => ({})) as { error?: string };
  return error ?? `${answer.status} ${answer.statusText}`;
}

/// Waits until the bridge has made a file.
export async function made(url: string, wanted: () => boolean = () => true, progress: (share: number) => void = () => {}): Promise<void> {
  while (wanted()) {
    const answer = await fetch(url, { headers: { range: "bytes=0-0" }, cache: "no-store" });
    if (answer.status === 206) return;
    const body = await answer.json() as { error?: string; progress?: number };
    if (answer.status !== 202) throw new Error(body.error ?? `${answer.status}`);
    progress(body.progress ?? 0);
    await new Promise((done) => setTimeout(done, POLL));
  }
}

function nameOf(topic: string): string { return topic.slice(topic.lastIndexOf("/") + 1); }

function recorded(message: McapTypes.TypedMcapRecords["Message"], channels: ReadonlyMap<number, McapTypes.TypedMcapRecords["Channel"]>,
                  schemas: ReadonlyMap<number, McapTypes.TypedMcapRecords["Schema"]>, texts: Map<number, Schema>): Recorded | null {
  const channel = channels.get(message.channelId);
  const schema = channel && schemas.get(channel.schemaId);
  if (!channel || !schema || channel.messageEncoding !== "cdr") return null;
  let text = texts.get(schema.id);
  if (!text) texts.set(schema.id, (text = { schemaName: schema.name, schema: new TextDecoder().decode(schema.data), schemaEncoding: schema.encoding }));
  // A copy: the chunk around it is not kept.
  return { name: nameOf(channel.topic), schema: text, time: message.logTime, data: message.data.slice() };
}

export interface Recording {
  readonly start: bigint;
  readonly end: bigint;
  readonly finished: boolean;
  has(name: string): boolean;
  /// All messages of these channels, in the order of time.
  all(names: readonly string[]): Promise<Recorded[]>;
  /// From a time on, before another.
  between(names: readonly string[], from: bigint, to: bigint): Promise<Recorded[]>;
}

class Indexed implements Recording {
  readonly start: bigint;
  readonly end: bigint;
  readonly finished = true;
  private readonly texts = new Map<number, Schema>();

  constructor(private readonly reader: McapIndexedReader) {
    const known = reader.statistics;
    this.start = known?.messageStartTime ?? 0n;
    this.end = known?.messageEndTime ?? 0n;
  }

  has(name: string): boolean { return this.topics([name]).length > 0; }
  all(names: readonly string[]): Promise<Recorded[]> { return this.between(names, this.start, this.end + 1n); }

  async between(names: readonly string[], from: bigint, to: bigint): Promise<Recorded[]> {
    const topics = this.topics(names);
    const out: Recorded[] = [];
    if (topics.length === 0) return out;
    for await (const message of this.reader.readMessages({ topics, startTime: from, endTime: to - 1n })) {
      const one = recorded(message, this.reader.channelsById, this.reader.schemasById, this.texts);
      if (one) out.push(one);
    }
    return out;
  }

  private topics(names: readonly string[]): string[] {
    return [...this.reader.channelsById.values()].map(({ topic }) => topic).filter((topic) => names.includes(nameOf(topic)));
  }
}

class InMemory implements Recording {
  readonly finished = false;
  constructor(private readonly messages: Recorded[]) { messages.sort((a, b) => (a.time < b.time ? -1 : a.time > b.time ? 1 : 0)); }
  get start(): bigint { return this.messages[0]!.time; }
  get end(): bigint { return this.messages.at(-1)!.time; }
  has(name: string): boolean { return this.messages.some((message) => message.name === name); }
  async all(names: readonly string[]): Promise<Recorded[]> { return this.messages.filter(({ name }) => names.includes(name)); }
  async between(names: readonly string[], from: bigint, to: bigint): Promise<Recorded[]> {
    return this.messages.filter(({ name, time }) => time >= from && time < to && names.includes(name));
  }
}

// Everything up to the first record that is not whole.
async function scan(bytes: Bytes): Promise<Recorded[]> {
  const size = await bytes.size();
  const reader = new McapStreamReader({ decompressHandlers });
  const channels = new Map<number, McapTypes.TypedMcapRecords["Channel"]>();
  const schemas = new Map<number, McapTypes.TypedMcapRecords["Schema"]>();
  const texts = new Map<number, Schema>();
  const out: Recorded[] = [];
  try {
    for (let at = 0n; at < size; at += BigInt(SLICE)) {
      reader.append(await bytes.read(at, size - at < BigInt(SLICE) ? size - at : BigInt(SLICE)));
      for (let record; (record = reader.nextRecord());) {
        if (record.type === "Channel") channels.set(record.id, record);
        else if (record.type === "Schema") schemas.set(record.id, record);
        else if (record.type === "Message") {
          const one = recorded(record, channels, schemas, texts);
          if (one) out.push(one);
        }
      }
    }
  } catch (error) {
    if (out.length === 0) throw error;
  }
  return out;
}

/// Throws when it is no recording, or too large to be read without an index.
export async function openRecording(bytes: Bytes): Promise<Recording> {
  let why: Error;
  try {
    const readable = bytes as McapTypes.IReadable;
    const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers, messageIndexCacheSizeBytes: 8 << 20 });
    if (reader.chunkIndexes.length > 0) return new Indexed(reader);
    why = new Error("it holds no messages");
  } catch (error) {
    why = error as Error;
  }
  if (await bytes.size() > BigInt(WHOLE)) throw new Error(`it has no index; repair it with "secondskin doctor --repair" (${why.message})`);
  const messages = await scan(bytes).catch((error: Error) => { throw new Error(`it is no MCAP recording: ${error.message}`); });
  if (messages.length === 0) throw new Error(`it holds no whole message (${why.message})`);
  return new InMemory(messages);
}

/// The states of a long recording of the bridge, which extracts them once; null: they are in the recording itself.
export async function openStates(bytes: HttpBytes, url: string, wanted?: () => boolean, progress?: (share: number) => void): Promise<Recording | null> {
  if (await bytes.size() < BigInt(LONG)) return null;
  try {
    await made(url, wanted, progress);
    return await openRecording(new HttpBytes(url));
  } catch {
    return null;  // slower, but all is there
  }
}
