import { Quaternion, Vector3 } from "three";
import { expect, test } from "vitest";
import type { SkeletonDefinition, SkeletonPose } from "../src/messages";
import { Body } from "../src/model/kinematics";

const zero = { x: 0, y: 0, z: 0 };
const arm: SkeletonDefinition = {
  skeleton_id: 7, source: "test", rate_hz: 60,
  joints: [
    { name: "pelvis", parent: -1, offset: zero, end: { x: 0, y: 0, z: 0.2 } },
    { name: "shoulder", parent: 0, offset: { x: 0, y: 0.2, z: 0.5 }, end: zero },
    { name: "elbow", parent: 1, offset: { x: 0, y: 0, z: -0.3 }, end: { x: 0, y: 0, z: -0.25 } },
  ],
};
const pose = (orientations: Quaternion[], id = 7): SkeletonPose => ({
  header: { frame: 1n, stamp_ns: 0n, publish_ns: 0n }, skeleton_id: id, root_position: { x: 1, y: 2, z: 1 },
  orientations, confidences: [1, 1, 1],
});
const still = new Quaternion();

test("at rest each joint stands where its offsets say", () => {
  const body = new Body(arm);
  const placed = body.empty();
  expect(body.place(pose([still, still, still]), placed)).toBe(true);
  expect(placed.position[2]!.distanceTo(new Vector3(1, 2.2, 1.2))).toBeLessThan(1e-12);
});

test("a turned parent carries its children and their rotations", () => {
  const body = new Body(arm);
  const placed = body.empty();
  // The shoulder lifts the arm forward: -90 degrees about y brings -z to +x.
  const lift = new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), -Math.PI / 2);
  body.place(pose([still, lift, still]), placed);
  expect(placed.position[2]!.distanceTo(new Vector3(1.3, 2.2, 1.5))).toBeLessThan(1e-12);
  expect(placed.rotation[2]!.angleTo(lift)).toBeLessThan(1e-7);
});

test("segment lengths stay whatever the pose", () => {
  const body = new Body(arm);
  const placed = body.empty();
  let seed = 1;
  const draw = (): number => ((seed = (seed * 16807) % 2147483647) / 2147483647) - 0.5;
  for (let i = 0; i < 200; i++) {
    const turns = [0, 1, 2].map(() => new Quaternion(draw(), draw(), draw(), draw()).normalize());
    body.place(pose(turns), placed);
    expect(placed.position[1]!.distanceTo(placed.position[2]!)).toBeCloseTo(0.3, 10);
  }
});

test("a pose of another body is refused and changes nothing", () => {
  const body = new Body(arm);
  const placed = body.empty();
  expect(body.place(pose([still, still, still], 8), placed)).toBe(false);
  expect(body.place(pose([still, still]), placed)).toBe(false);
  expect(placed.position[0]!.length()).toBe(0);
});

test("a bone shows the error of the joint that moves it", () => {
  const bones = new Body(arm).bones.map(({ joint, end }) => [joint, end]);
  expect(bones).toEqual([[0, "shoulder"], [1, "elbow"], [2, ""]]);
});

test("a joint before its parent is named", () => {
  const wrong = { ...arm, joints: [{ ...arm.joints[0]!, parent: 1 }, arm.joints[1]!] };
  expect(() => new Body(wrong)).toThrow("joint pelvis: parent 1, expected an earlier joint");
});
