// A body in 3D: capsules that hang on joints, so that a pose only turns and places the joints.
import {
  AxesHelper, CapsuleGeometry, Color, Group, Mesh, MeshLambertMaterial, Quaternion, SphereGeometry, Vector3,
} from "three";
import { Body, type Placed } from "../model/kinematics";
import { COLOURS, THICKNESS, type Grade } from "../model/error";
import type { SkeletonPose } from "../messages";

// Half thickness of a limb [m], by joint or by joint>child.
const RADIUS: Record<string, number> = {
  "pelvis>left_hip": 0.085, "pelvis>right_hip": 0.085, "pelvis>spine_lower": 0.1,
  spine_lower: 0.095, spine_middle: 0.105, "spine_upper>neck": 0.07,
  "spine_upper>left_clavicle": 0.075, "spine_upper>right_clavicle": 0.075,
  clavicle: 0.06, neck: 0.045, head: 0.085, shoulder: 0.047, elbow: 0.038, wrist: 0.032,
  hip: 0.072, knee: 0.052, ankle: 0.04, toes: 0.034,
};
const THINNEST = 0.03;

function radiusOf(joint: string, end: string): number {
  return RADIUS[`${joint}>${end}`] ?? RADIUS[joint] ?? RADIUS[joint.replace(/^(left|right)_/, "")] ?? THINNEST;
}

export interface Look { colour: string; opacity: number }

export class Figure {
  readonly group = new Group();
  readonly placed: Placed;
  private readonly joints: Group[] = [];
  private readonly limbs: Mesh[][] = [];          // by joint
  private readonly materials: MeshLambertMaterial[] = [];
  private readonly grades: Grade[] = [];
  private readonly axes: AxesHelper[] = [];

  constructor(readonly body: Body, private readonly look: Look) {
    this.placed = body.empty();
    for (const name of body.names) {
      const joint = new Group();
      const material = new MeshLambertMaterial({
        color: look.colour, transparent: look.opacity < 1, opacity: look.opacity, depthWrite: look.opacity >= 1,
      });
      this.joints.push(joint);
      this.materials.push(material);
      this.limbs.push([]);
      this.grades.push("none");
      if (name === "head") joint.add(this.nose(material));
      this.group.add(joint);
    }
    for (const { joint, to, end } of body.bones) {
      const limb = new Mesh(
        new CapsuleGeometry(radiusOf(body.names[joint]!, end), to.length(), 5, 14), this.materials[joint]);
      limb.position.copy(to).multiplyScalar(0.5);
      limb.quaternion.copy(new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), to.clone().normalize()));
      this.limbs[joint]!.push(limb);
      this.joints[joint]!.add(limb);
    }
    this.group.visible = false;
  }

  /// @returns whether the pose was of this body; if not, nothing changes.
  pose(pose: SkeletonPose): boolean {
    if (!this.body.place(pose, this.placed)) return false;
    this.joints.forEach((joint, i) => {
      joint.position.copy(this.placed.position[i]!);
      joint.quaternion.copy(this.placed.rotation[i]!);
    });
    this.group.visible = true;
    return true;
  }

  paint(joint: number, grade: Grade): void {
    if (this.grades[joint] === grade) return;
    this.grades[joint] = grade;
    const material = this.materials[joint];
    if (material == undefined) return;
    material.color = new Color(grade === "none" ? this.look.colour : COLOURS[grade]);
    const thick = THICKNESS[grade];
    for (const limb of this.limbs[joint]!) limb.scale.set(thick, 1, thick);
  }

  grade(joint: number): Grade { return this.grades[joint] ?? "none"; }

  showAxes(shown: boolean): void {
    if (shown && this.axes.length === 0) {
      for (const joint of this.joints) {
        const axes = new AxesHelper(0.14);
        axes.renderOrder = 2;
        (axes.material as { depthTest: boolean }).depthTest = false;
        this.axes.push(axes);
        joint.add(axes);
      }
    }
    for (const axes of this.axes) axes.visible = shown;
  }

  dispose(): void {
    this.group.removeFromParent();
    this.group.traverse((object) => { if (object instanceof Mesh) object.geometry.dispose(); });
    for (const material of this.materials) material.dispose();
    for (const axes of this.axes) axes.dispose();
  }

  // Says which way the head looks: forward is x.
  private nose(material: MeshLambertMaterial): Mesh {
    const nose = new Mesh(new SphereGeometry(0.022, 8, 6), material);
    nose.position.set(0.1, 0, 0.09);
    return nose;
  }
}
