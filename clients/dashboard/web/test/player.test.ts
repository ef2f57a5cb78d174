// The player over a recording in memory, written with the official MCAP writer and read by our reader.
import { McapWriter, type McapWriterOptions } from "@mcap/core";
import { MessageWriter } from "@foxglove/omgidl-serialization";
import { parseIDL } from "@foxglove/omgidl-parser";
import { readFileSync } from "node:fs";
import { compress, decompress } from "lz4js";
import { expect, test } from "vitest";
import { BlobBytes, openRecording } from "../src/model/recording";
import { Player, Track } from "../src/player";

const idl = readFileSync(new URL("../../../../idl/secondskin_msgs.idl", import.meta.url), "utf8");
const definitions = parseIDL(idl);
const START = 1_700_000_000_000_000_000n;
const RATE = 50;

const vector = { x: 0, y: 0, z: 0 };
function header(i: number): object { return { frame: BigInt(i + 1), stamp_ns: time(i), publish_ns: time(i) }; }
function time(i: number): bigint { return START + BigInt(Math.round((i * 1e9) / RATE)); }

/// Ten seconds: a pose 50 times a second whose height is its frame, a repetition each two seconds.
async function file(finish = true, compressChunk?: McapWriterOptions["compressChunk"]): Promise<Blob> {
  const parts: Uint8Array[] = [];
  let size = 0n;
  const writable = { position: () => size, write: async (bytes: Uint8Array) => { parts.push(bytes.slice()); size += BigInt(bytes.length); } };
  const writer = new McapWriter({ writable, chunkSize: 4096, compressChunk });
  await writer.start({ profile: "", library: "test" });
  const channel = async (name: string, type: string): Promise<(i: number, message: object) => Promise<void>> => {
    const schemaName = `secondskin_msgs::msg::${type}`;
    const schemaId = await writer.registerSchema({ name: schemaName, encoding: "omgidl", data: new TextEncoder().encode(idl) });
    const channelId = await writer.registerChannel({ schemaId, topic: `/secondskin/test/${name}`, messageEncoding: "cdr", metadata: new Map() });
    const cdr = new MessageWriter(schemaName, definitions);
    return async (i, message) => writer.addMessage({ channelId, sequence: i, logTime: time(i), publishTime: time(i), data: cdr.writeMessage(message) });
  };
  const pose = await channel("pose", "SkeletonPose");
  const repetition = await channel("repetition", "RepetitionScore");
  for (let i = 0; i < 10 * RATE; i++) {
    await pose(i, { header: header(i), skeleton_id: 1, root_position: { ...vector, z: i }, orientations: [], confidences: [] });
    if (i % (2 * RATE) === 0 && i > 0) {
      await repetition(i, { header: header(i), repetition: i / (2 * RATE), start_ns: time(i - 50), end_ns: time(i), total: i, cues: 1, joints: [] });
    }
  }
  if (finish) await writer.end();
  return new Blob(parts as BlobPart[]);
}

async function open(blob: Blob): Promise<Player> { return new Player(await Track.open(await openRecording(new BlobBytes(blob)))); }

/// Frames until what is needed has been read.
async function settle(player: Player, now: number): Promise<void> {
  for (let i = 0; i < 200; i++) {
    if (!player.frame(now)) return;
    await new Promise((done) => setTimeout(done, 1));
  }
  throw new Error("it is never ready");
}

for (const [what, finish] of [["finished", true], ["unfinished", false]] as const) {
  test(`seeks in a ${what} file, forwards and backwards`, async () => {
    const blob = await file(finish);
    const player = await open(finish ? blob : blob.slice(0, blob.size - 100));
    const live = player.tracks[0]!.live;
    const told: number[] = [];
    player.tracks[0]!.onRewind = () => { told.length = 0; };
    live.on("repetition", (score) => told.push(score.repetition));
    expect(player.tracks[0]!.finished).toBe(finish);
    for (const [to, repetitions] of [[7.5, [1, 2, 3]], [3.01, [1]], [0, []], [4, [1, 2]]] as const) {
      player.seek(to);
      await settle(player, 0);
      expect(live.newest.pose?.root_position.z).toBe(Math.floor(to * RATE + 1e-6));
      expect(told).toEqual(repetitions);
    }
  });
}

for (const [what, finish] of [["finished", true], ["unfinished", false]] as const) {
  test(`plays lz4 chunks of a ${what} file`, async () => {
    let packed = 0;
    const blob = await file(finish, (chunk) => {
      packed++;
      return { compression: "lz4", compressedData: compress(chunk) };
    });
    expect(packed).toBeGreaterThan(5);
    const player = await open(finish ? blob : blob.slice(0, blob.size - 100));
    player.seek(7.5);
    await settle(player, 0);
    expect(player.tracks[0]!.live.newest.pose?.root_position.z).toBe(7.5 * RATE);
    expect(player.tracks[0]!.repetitions().map(({ total }) => total)).toEqual([100, 200, 300, 400]);
  });
}

// Blocks that refer to earlier ones, as C++ writers of MCAP make them: seq of (i*i)%97 with i below 50000, one a
// line, by lz4 1.9.4 with -BD -B4 --no-frame-crc.
test("lz4 frames of the original library are read", () => {
  const frame = Buffer.from(readFileSync(new URL("linked.lz4.txt", import.meta.url), "utf8"), "base64");
  const text = Array.from({ length: 50_000 }, (_, i) => `${(i * i) % 97}\n`).join("");
  expect(new TextDecoder().decode(decompress(frame, text.length))).toBe(text);
});

test("a damaged lz4 chunk is an error, not movement", async () => {
  const blob = await file(true, (chunk) => ({ compression: "lz4", compressedData: compress(chunk).fill(0x11, 60, 90) }));
  const failed = async (): Promise<void> => {
    const player = await open(blob);
    player.seek(5);
    for (let i = 0; i < 50 && !player.failure; i++) {
      player.frame(0);
      await new Promise((done) => setTimeout(done, 1));
    }
    if (player.failure) throw player.failure;
  };
  await expect(failed()).rejects.toThrow(/lz4|CRC|chunk/i);
});

test("plays on frame by frame and steps by one", async () => {
  const player = await open(await file());
  const live = player.tracks[0]!.live;
  await settle(player, 0);
  player.playback.toggle();
  for (let now = 0; now < 2.5; now += 0.02) await settle(player, now);
  expect(live.newest.pose!.root_position.z).toBeGreaterThan(100);
  expect(live.states.repetition?.repetition).toBe(1);
  player.playback.playing = false;
  player.seek(5);
  await settle(player, 3);
  player.step(1);
  await settle(player, 3);
  expect(live.newest.pose!.root_position.z).toBe(251);
  player.step(-1);
  await settle(player, 3);
  expect(live.newest.pose!.root_position.z).toBe(250);
});

test("what is older than the play head is not live", async () => {
  const player = await open(await file());
  player.seek(10);
  await settle(player, 0);
  expect(player.tracks[0]!.live.isLive("pose", 1e9, 1)).toBe(true);
  expect(player.tracks[0]!.live.isLive("tactors", 0, 1)).toBe(false);
});

test("a file that is no recording is named as that", async () => {
  await expect(openRecording(new BlobBytes(new Blob(["no recording at all"])))).rejects.toThrow(/no MCAP recording/);
  await expect(openRecording(new BlobBytes(new Blob([])))).rejects.toThrow();
});
