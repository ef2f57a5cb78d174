// Bodies over each other on a floor: the takes of a movement, or who is measured now.
import {
  AmbientLight, BufferAttribute, BufferGeometry, DirectionalLight, LineBasicMaterial, LineSegments, PerspectiveCamera,
  Quaternion, Scene, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { DrawnMotion } from "../api";
import { el } from "../dom";
import type { SkeletonDefinition, SkeletonPose } from "../messages";
import { Body } from "../model/kinematics";
import { texts } from "../texts";
import { Figure } from "./figure";

const DISTANCE = 3.6;  // of the camera [m]
const TURN = 0.12;     // a press of an arrow key [rad]

/// A motion that can be drawn at any time.
export class Performance {
  readonly body: Body;
  readonly duration: number;
  private readonly drawn: SkeletonPose;
  private readonly next = new Quaternion();
  private readonly here = new Quaternion();

  constructor(readonly motion: DrawnMotion, id: number) {
    const at = ([x, y, z]: number[]): { x: number; y: number; z: number } => ({ x: x!, y: y!, z: z! });
    const definition: SkeletonDefinition = {
      skeleton_id: id, source: "", rate_hz: motion.rate_hz,
      joints: motion.skeleton.map(({ name, parent, offset, end }) => ({ name, parent, offset: at(offset), end: at(end) })),
    };
    this.body = new Body(definition);
    this.duration = (motion.poses.length - 1) / motion.rate_hz;
    this.drawn = {
      header: { frame: 0n, stamp_ns: 0n, publish_ns: 0n }, skeleton_id: id, root_position: { x: 0, y: 0, z: 0 },
      orientations: motion.skeleton.map(() => ({ x: 0, y: 0, z: 0, w: 1 })), confidences: [],
    };
  }

  at(seconds: number): SkeletonPose {
    const { poses, rate_hz } = this.motion;
    const place = Math.min(Math.max(seconds * rate_hz, 0), poses.length - 1);
    const a = poses[Math.floor(place)]!;
    const b = poses[Math.min(Math.floor(place) + 1, poses.length - 1)]!;
    const u = place - Math.floor(place);
    const mix = (i: number): number => a[i]! + u * (b[i]! - a[i]!);
    this.drawn.root_position = { x: mix(0), y: mix(1), z: mix(2) };
    this.drawn.orientations.forEach((q, j) => {
      const i = 3 + 4 * j;
      this.here.set(a[i]!, a[i + 1]!, a[i + 2]!, a[i + 3]!);
      this.here.slerp(this.next.set(b[i]!, b[i + 1]!, b[i + 2]!, b[i + 3]!), u).normalize();
      Object.assign(q, { x: this.here.x, y: this.here.y, z: this.here.z, w: this.here.w });
    });
    return this.drawn;
  }

  /// Where the body stands and looks at a time: x, y and the angle about the vertical.
  facing(seconds: number): { x: number; y: number; heading: number } {
    const { root_position, orientations } = this.at(seconds);
    const q = orientations[0]!;
    const forward = new Vector3(1, 0, 0).applyQuaternion(new Quaternion(q.x, q.y, q.z, q.w));
    return { x: root_position.x, y: root_position.y, heading: Math.atan2(forward.y, forward.x) };
  }
}

/// One of the bodies that are shown, and when it is where.
export interface Shown { performance: Performance; colour: string; opacity: number; when: (t: number) => number }

export class TakeStage {
  readonly element: HTMLElement;
  readonly canvas = el("canvas", { tabindex: 0, role: "img", "aria-label": texts.record.stage });
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(36, 1, 0.1, 60);
  private readonly renderer: WebGLRenderer;
  private readonly orbit: OrbitControls;
  private figures: { figure: Figure; shown: Shown }[] = [];
  private living: Figure | null = null;
  private dirty = true;
  private size = { width: 0, height: 0 };

  /// Throws when the browser has no WebGL.
  constructor() {
    this.renderer = new WebGLRenderer({ canvas: this.canvas });
    this.renderer.setClearColor(0x0d1117);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(DISTANCE, 0.6, 1.4);
    this.orbit = new OrbitControls(this.camera, this.canvas);
    this.orbit.enablePan = false;
    this.orbit.target.set(0, 0, 0.9);
    this.orbit.addEventListener("change", () => { this.dirty = true; });
    this.orbit.update();
    const light = new DirectionalLight(0xffffff, 2.2);
    light.position.set(3, 2, 5);
    const corners: number[] = [];
    for (let i = -8; i <= 8; i++) {
      for (let k = -8; k < 8; k++) corners.push(k / 2, i / 2, 0, (k + 1) / 2, i / 2, 0, i / 2, k / 2, 0, i / 2, (k + 1) / 2, 0);
    }
    const grid = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(corners), 3));
    this.scene.add(new AmbientLight(0xffffff, 1.1), light, new LineSegments(grid, new LineBasicMaterial({ color: 0x2b3541 })));
    this.element = el("div", { class: "stage-canvas" }, this.canvas);
    new ResizeObserver(() => this.resize()).observe(this.element);
  }

  /// Over each other: all stand and look at the start as the first does, who stands in the middle.
  show(list: Shown[]): void {
    for (const { figure } of this.figures) figure.dispose();
    this.figures = list.map((shown) => {
      const figure = new Figure(shown.performance.body, shown);
      const { x, y, heading } = shown.performance.facing(shown.when(0));
      figure.group.rotation.z = -heading;
      figure.group.position.set(x, y, 0).applyAxisAngle(new Vector3(0, 0, 1), -heading).negate();
      this.scene.add(figure.group);
      return { figure, shown };
    });
    this.canvas.dataset.bodies = String(list.length);
    this.dirty = true;
  }

  pose(t: number): void {
    for (const { figure, shown } of this.figures) figure.pose(shown.performance.at(shown.when(t)));
    this.dirty = true;
  }

  /// Who is measured now.
  live(definition: SkeletonDefinition | undefined, pose: SkeletonPose | undefined): void {
    if (definition == undefined || pose == undefined) {
      if (this.living) this.dirty = true;
      this.living?.dispose();
      this.living = null;
      return;
    }
    if (this.living?.body.definition !== definition) {
      this.living?.dispose();
      this.living = new Figure(new Body(definition), { colour: "#c3ccd6", opacity: 1 });
      this.scene.add(this.living.group);
    }
    this.living.pose(pose);
    const { x, y } = pose.root_position;
    this.living.group.position.set(-x, -y, 0);
    this.dirty = true;
  }

  /// A key on the view. @returns whether it means something here.
  key(key: string): boolean {
    const offset = this.camera.position.clone().sub(this.orbit.target);
    if (key === "ArrowLeft" || key === "ArrowRight") offset.applyAxisAngle(new Vector3(0, 0, 1), key === "ArrowLeft" ? -TURN : TURN);
    else if (key === "+" || key === "=") offset.multiplyScalar(0.9);
    else if (key === "-") offset.multiplyScalar(1 / 0.9);
    else return false;
    this.camera.position.copy(this.orbit.target).add(offset);
    this.orbit.update();
    this.dirty = true;
    return true;
  }

  frame(): void {
    if (!this.dirty || this.size.width === 0) return;
    this.dirty = false;
    this.renderer.render(this.scene, this.camera);
  }

  private resize(): void {
    const { width, height } = this.element.getBoundingClientRect();
    if (width === 0 || height === 0) return;
    this.size = { width, height };
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.dirty = true;
  }
}
