// How far a joint is off, against its tolerance, and how that is shown: by colour and by thickness, so
// that nobody needs to tell the colours apart (Okabe & Ito's set).
import type { Correction, Vec3 } from "../messages";

export type Grade = "none" | "inside" | "outside" | "far";

export const COLOURS: Record<Grade, string> = {
  none: "#8b97a5", inside: "#56b4e9", outside: "#f0c33c", far: "#e8662a",
};
/// Times the limb's own radius.
export const THICKNESS: Record<Grade, number> = { none: 1, inside: 1, outside: 1.22, far: 1.5 };

const FAR = 2;      // times the tolerance
const LEAVE = 0.9;  // a grade is left downwards only below this share of where it begins: no flicker

export function norm(v: Vec3): number { return Math.hypot(v.x, v.y, v.z); }
export function degrees(radians: number): number { return (radians * 180) / Math.PI; }

export function gradeOf(error: number, tolerance: number, before: Grade = "none"): Grade {
  if (!(tolerance > 0) || !Number.isFinite(error)) return "none";
  const ratio = error / tolerance;
  if (ratio > FAR || (before === "far" && ratio > FAR * LEAVE)) return "far";
  if (ratio > 1 || ((before === "outside" || before === "far") && ratio > LEAVE)) return "outside";
  return "inside";
}

export interface JointError { joint: string; error: number; tolerance: number; ratio: number }

/// Joints outside their tolerance, worst first; joints that hardly count for the exercise are left out.
export function worst(correction: Correction, weights: ReadonlyMap<string, number>, most: number): JointError[] {
  return correction.joints
    .map(({ joint, error, tolerance }) => {
      const size = norm(error);
      return { joint, error: size, tolerance, ratio: tolerance > 0 ? size / tolerance : 0 };
    })
    .filter(({ joint, ratio }) => ratio > 1 && (weights.get(joint) ?? 1) >= 0.3)
    .sort((a, b) => b.ratio * (weights.get(b.joint) ?? 1) - a.ratio * (weights.get(a.joint) ?? 1))
    .slice(0, most);
}
