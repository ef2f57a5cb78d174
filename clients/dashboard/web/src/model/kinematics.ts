// From SkeletonDefinition and SkeletonPose to places in the world: X_WB = X_WP * [q_PB, p_PB].
import { Quaternion, Vector3 } from "three";
import type { SkeletonDefinition, SkeletonPose } from "../messages";

export interface Bone {
  joint: number;    // it moves with, and whose error it shows
  to: Vector3;      // its other end in the joint's frame [m]
  end: string;      // the child joint's name, or "" at the end of a limb
}

export interface Placed {
  position: Vector3[];     // of each joint in the world [m]
  rotation: Quaternion[];
}

export class Body {
  readonly names: string[];
  readonly bones: Bone[] = [];
  private readonly parents: number[];
  private readonly offsets: Vector3[];

  /// Throws when a joint stands before its parent.
  constructor(readonly definition: SkeletonDefinition) {
    const joints = definition.joints;
    this.names = joints.map((joint) => joint.name);
    this.parents = joints.map((joint) => joint.parent);
    this.offsets = joints.map(({ offset }) => new Vector3(offset.x, offset.y, offset.z));
    const hasChild = new Set(this.parents);
    joints.forEach((joint, i) => {
      if (joint.parent >= i) {
        throw new Error(`skeleton: joint ${joint.name}: parent ${joint.parent}, expected an earlier joint`);
      }
      if (joint.parent >= 0) this.add(joint.parent, this.offsets[i]!, joint.name);
      if (!hasChild.has(i)) this.add(i, new Vector3(joint.end.x, joint.end.y, joint.end.z), "");
    });
  }

  get id(): number { return this.definition.skeleton_id; }

  empty(): Placed {
    return { position: this.names.map(() => new Vector3()), rotation: this.names.map(() => new Quaternion()) };
  }

  /// False, and nothing written, when the pose is not of this body.
  place(pose: SkeletonPose, out: Placed): boolean {
    if (pose.skeleton_id !== this.id || pose.orientations.length !== this.names.length) return false;
    for (let i = 0; i < this.names.length; i++) {
      const q = pose.orientations[i]!;
      const parent = this.parents[i]!;
      const rotation = out.rotation[i]!.set(q.x, q.y, q.z, q.w);
      const position = out.position[i]!;
      if (parent < 0) {
        position.set(pose.root_position.x, pose.root_position.y, pose.root_position.z);
      } else {
        position.copy(this.offsets[i]!).applyQuaternion(out.rotation[parent]!).add(out.position[parent]!);
        rotation.premultiply(out.rotation[parent]!);
      }
    }
    return true;
  }

  private add(joint: number, to: Vector3, end: string): void {
    if (to.length() > 1e-3) this.bones.push({ joint, to, end });
  }
}
