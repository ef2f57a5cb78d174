import { expect, test } from "vitest";
import { Live } from "../src/live";
import type { SkeletonPose } from "../src/messages";

const pose = (frame: number): SkeletonPose => ({ skeleton_id: frame }) as SkeletonPose;

test("of many messages in a frame only the newest is decoded", () => {
  const live = new Live();
  let decoded = 0;
  for (let i = 1; i <= 5; i++) live.offer("pose", () => (decoded++, pose(i)), i);
  live.frame();
  expect(decoded).toBe(1);
  expect(live.newest.pose!.skeleton_id).toBe(5);
  expect(live.isFresh("pose")).toBe(true);
  live.frame();
  expect(live.isFresh("pose")).toBe(false);
});

test("nothing is live when it is old, or when the connection is gone", () => {
  const live = new Live();
  live.connected = true;
  live.offer("pose", () => pose(1), 10);
  live.frame();
  expect(live.isLive("pose", 10.5, 1)).toBe(true);
  expect(live.isLive("pose", 11.5, 1)).toBe(false);
  live.disconnect();
  expect(live.newest.pose).toBeUndefined();
  expect(live.isLive("pose", 10.5, 1)).toBe(false);
});

test("each message of a state reaches who listens", () => {
  const live = new Live();
  const heard: boolean[] = [];
  live.on("stop", ({ active }) => heard.push(active));
  for (const active of [true, false, true]) live.take("stop", { publish_ns: 0n, active, reason: "" });
  expect(heard).toEqual([true, false, true]);
});
