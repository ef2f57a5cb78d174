// The 3D view: learner and expert on a floor, errors on the limbs.
import {
  AmbientLight, AxesHelper, BufferAttribute, BufferGeometry, DirectionalLight, LineBasicMaterial, LineSegments,
  PerspectiveCamera, Points, PointsMaterial, Scene, Spherical, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { el, setText, svg } from "../dom";
import type { Live } from "../live";
import type { Correction } from "../messages";
import { degrees, gradeOf, norm, worst, COLOURS, type Grade } from "../model/error";
import { Body } from "../model/kinematics";
import { Resolution } from "../model/resolution";
import { jointText, texts } from "../texts";
import { Figure } from "./figure";

const BACKGROUND = 0x0d1117;
const LEARNER = { colour: COLOURS.none, opacity: 1 };
const GHOST = { colour: "#dfe6ee", opacity: 0.3 };
const BESIDE = { colour: "#c3ccd6", opacity: 1 };
const APART = 1.25;         // between learner and expert, side by side [m]
const NEAR = 2.9;           // of the camera, so that a body fills the height [m]
const TOOLS = 100;          // of the height is buttons and legend [px]
const NARROW = 620;         // labels are short below [px]
const FLOOR = 12;           // half metres each way
const STILL = 0.12;         // the camera lets so much be [m]
const FOLLOW = 0.3;         // its time constant [s]
const LABELS = 3;
const TURN = 0.12;          // a press of an arrow key [rad]
export type View = "front" | "side" | "top";
const VIEWS: Record<View, { theta: number; phi: number }> = {
  front: { theta: 0, phi: 1.42 }, side: { theta: Math.PI / 2, phi: 1.42 }, top: { theta: 0, phi: 0.02 },
};

// Without a graphics card smooth edges cost most of the time (multisampling: 25 frames a second, or 49
// without).
function software(): boolean {
  const probe = document.createElement("canvas").getContext("webgl");
  const info = probe?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? String(probe!.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  probe?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

export class Stage {
  readonly element: HTMLElement;
  readonly canvas = el("canvas", { tabindex: 0, role: "img", "aria-label": texts.stage.label });
  weights: ReadonlyMap<string, number> = new Map();

  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(36, 1, 0.1, 60);
  private readonly renderer: WebGLRenderer;
  private readonly orbit: OrbitControls;
  private readonly labels: { text: HTMLElement; lead: SVGElement }[] = [];
  private readonly names = { learner: this.nameTag("learner"), expert: this.nameTag("expert") };
  private readonly overlay = el("div", { class: "stage-labels", "aria-hidden": "true" });
  private points: Points | null = null;
  private learner: Figure | null = null;
  private expert: Figure | null = null;
  private apart = false;
  private axes = false;
  private detectors = false;
  private dirty = true;
  private followed = 0;
  private drawn = 0;  // so many times: for measuring
  private size = { width: 0, height: 0 };
  private readonly resolution = new Resolution(Math.min(window.devicePixelRatio, 1.5));
  private readonly above = new Vector3();

  /// Throws when the browser has no WebGL.
  constructor() {
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: !software(), powerPreference: "high-performance" });
    this.renderer.setPixelRatio(this.resolution.ratio);
    this.renderer.setClearColor(BACKGROUND);
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, this.canvas);
    this.orbit.enablePan = false;
    this.orbit.minDistance = 1.5;
    this.orbit.maxDistance = 12;
    this.orbit.addEventListener("change", () => this.sayWhere());
    const light = new DirectionalLight(0xffffff, 2.2);
    light.position.set(3, 2, 5);
    this.scene.add(new AmbientLight(0xffffff, 1.1), light);
    this.addFloor();
    const leads = svg("svg", { class: "stage-leads" });
    this.overlay.append(leads);
    for (let i = 0; i < LABELS; i++) {
      const text = el("span", { class: "stage-label", hidden: true });
      const lead = svg("path");
      this.labels.push({ text, lead });
      this.overlay.append(text);
      leads.append(lead);
    }
    this.overlay.append(this.names.learner, this.names.expert);
    this.element = el("div", { class: "stage-canvas" }, this.canvas, this.overlay);
    new ResizeObserver(() => this.resize()).observe(this.element);
    this.orbit.target.set(0, 0, 0.9);
    this.view("front");
  }

  view(view: View): void {
    const { theta, phi } = VIEWS[view];
    this.place(new Spherical(this.distance(), phi, theta));
  }

  /// A key on the view. @returns whether it means something here.
  key(key: string): boolean {
    const turn: Record<string, [number, number]> = {
      ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, -TURN], ArrowDown: [0, TURN],
    };
    const place = this.spherical();
    const by = turn[key];
    if (by) place.set(place.radius, place.phi + by[1], place.theta + by[0]);
    else if (key === "+" || key === "=") place.radius *= 0.9;
    else if (key === "-" || key === "−") place.radius /= 0.9;
    else return false;
    this.place(place);
    return true;
  }

  set sideBySide(apart: boolean) {
    this.apart = apart;
    this.forget("expert");
    const place = this.spherical();
    place.radius = this.distance();
    this.place(place);
  }
  get sideBySide(): boolean { return this.apart; }
  set showAxes(shown: boolean) {
    this.axes = shown;
    this.learner?.showAxes(shown);
    this.dirty = true;
  }
  set showPoints(shown: boolean) {
    this.detectors = shown;
    if (this.points) this.points.visible = shown;
    this.dirty = true;
  }

  /// Once an animation frame. Draws only when something moved.
  frame(live: Live, judged: boolean): void {
    if (this.resolution.frame(performance.now() / 1000)) this.refine();
    this.meet(live);
    const { pose, expert, correction, points } = live.newest;
    if (live.isFresh("pose") && pose && this.learner?.pose(pose)) {
      this.follow(this.learner.placed.position[0]!);
      this.dirty = true;
    }
    if (live.isFresh("expert") && expert && this.expert?.pose(expert)) this.dirty = true;
    if (this.learner && (live.isFresh("correction") || !judged)) this.paint(judged ? correction : undefined);
    if (this.detectors && live.isFresh("points") && points) this.showMarkers(points.markers);
    if (this.apart && this.expert) this.setApart();
    if (!this.dirty || this.size.width === 0) return;
    this.dirty = false;
    this.canvas.dataset.drawn = String(++this.drawn);
    this.renderer.render(this.scene, this.camera);
    this.label(judged ? correction : undefined);
  }

  private meet(live: Live): void {
    const skeleton = live.states.skeleton;
    if (skeleton == undefined) return;
    if (this.learner?.body.definition !== skeleton) {
      this.forget("learner");
      this.forget("expert");
      this.learner = new Figure(new Body(skeleton), LEARNER);
      if (this.axes) this.learner.showAxes(true);
      this.scene.add(this.learner.group);
    }
    if (this.expert == null && live.newest.expert != undefined) {
      this.expert = new Figure(this.learner!.body, this.apart ? BESIDE : GHOST);
      this.expert.pose(live.newest.expert);
      this.scene.add(this.expert.group);
    }
  }

  private forget(which: "learner" | "expert"): void {
    this[which]?.dispose();
    this[which] = null;
    this.dirty = true;
  }

  private paint(correction: Correction | undefined): void {
    const figure = this.learner!;
    figure.body.names.forEach((name, i) => {
      const joint = correction?.joints[i];
      const before = figure.grade(i);
      const grade: Grade = joint == undefined || joint.joint !== name
        ? "none" : gradeOf(norm(joint.error), joint.tolerance, before);
      if (grade === before) return;
      figure.paint(i, grade);
      this.dirty = true;
    });
  }

  private label(correction: Correction | undefined): void {
    const shown = correction ? worst(correction, this.weights, LABELS) : [];
    const taken: { y: number; right: boolean }[] = [];
    // Outwards from the body; from the middle where another one stands beside it.
    const middle = this.apart || !this.learner ? this.size.width / 2 : this.project(this.learner.placed.position[0]!).x;
    this.labels.forEach(({ text: label, lead }, n) => {
      const joint = shown[n];
      const i = joint ? this.learner!.body.names.indexOf(joint.joint) : -1;
      label.hidden = i < 0;
      lead.toggleAttribute("hidden", label.hidden);
      if (joint == undefined || i < 0) return;
      setText(label, texts.stage.label3d(
        jointText(joint.joint), Math.round(degrees(joint.error)),
        this.size.width < NARROW ? null : Math.round(degrees(joint.tolerance))));
      const at = this.project(this.learner!.placed.position[i]!);
      const from = { ...at };
      const right = at.x > middle;
      // Not over another one.
      while (taken.some((other) => other.right === right && Math.abs(other.y - at.y) < 34)) at.y += 34;
      taken.push({ y: at.y, right });
      const room = this.size.width - label.offsetWidth - 44;
      at.x = right ? Math.min(at.x, room) : Math.max(at.x, label.offsetWidth + 44);
      label.dataset.right = String(right);
      const edge = at.x + (right ? 34 : -34);
      label.style.transform = `translate(${edge}px, ${at.y}px)`;
      lead.setAttribute("d", `M${from.x} ${from.y}L${edge} ${at.y}`);
    });
    this.nameFigure(this.names.learner, this.learner, true);
    this.nameFigure(this.names.expert, this.expert, this.apart);
  }

  private nameFigure(tag: HTMLElement, figure: Figure | null, shown: boolean): void {
    tag.hidden = !this.apart || !shown || figure == null || !figure.group.visible;
    if (tag.hidden) return;
    // Over the head, which is the highest joint of a standing body.
    const { position } = figure!.placed;
    this.above.copy(position[0]!).add(figure!.group.position);
    this.above.z = Math.max(...position.map(({ z }) => z)) + 0.3;
    const at = this.project(this.above);
    tag.style.transform = `translate(${at.x}px, ${Math.max(at.y, TOOLS * 0.66)}px)`;
  }

  private project(point: Vector3): { x: number; y: number } {
    const p = point.clone().project(this.camera);
    return { x: (p.x + 1) * this.size.width / 2, y: (1 - p.y) * this.size.height / 2 };
  }

  private nameTag(who: "learner" | "expert"): HTMLElement {
    return el("span", { class: "stage-name", hidden: true }, texts.stage[who]);
  }

  private showMarkers(markers: { position: { x: number; y: number; z: number }; valid: boolean }[]): void {
    if (this.points == null) {
      this.points = new Points(new BufferGeometry(), new PointsMaterial({ color: 0xcc79a7, size: 7, sizeAttenuation: false, depthTest: false }));
      this.points.frustumCulled = false;
      this.scene.add(this.points);
    }
    const valid = markers.filter((marker) => marker.valid);
    this.canvas.dataset.points = String(valid.length);
    const places = new Float32Array(valid.flatMap(({ position }) => [position.x, position.y, position.z]));
    this.points.geometry.dispose();
    this.points.geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(places, 3));
    this.dirty = true;
  }

  // The camera goes where the learner goes, on the floor, and lets small movements be.
  private follow(root: Vector3): void {
    const { target } = this.orbit;
    const centre = this.apart ? this.aside().multiplyScalar(0.5).add(root) : root;
    const dx = centre.x - target.x;
    const dy = centre.y - target.y;
    const far = Math.hypot(dx, dy);
    const now = performance.now() / 1000;
    const passed = Math.min(now - this.followed, 1);
    this.followed = now;
    if (far < STILL) return;
    // Who jumps, as a recording does that begins anew, is met at once.
    const share = far > 2 ? 1 : (1 - STILL / far) * (1 - Math.exp(-passed / FOLLOW));
    target.x += dx * share;
    target.y += dy * share;
    this.camera.position.x += dx * share;
    this.camera.position.y += dy * share;
    this.orbit.update();
  }

  // The expert stands to the right as we see it, whatever the view.
  private aside(): Vector3 {
    const right = new Vector3(1, 0, 0).applyQuaternion(this.camera.quaternion).setZ(0);
    return right.normalize().multiplyScalar(APART);
  }

  private setApart(): void {
    const aside = this.aside();
    if (this.expert!.group.position.distanceTo(aside) > 1e-3) {
      this.expert!.group.position.copy(aside);
      this.dirty = true;
    }
  }

  private distance(): number {
    const { width, height } = this.size;
    if (width === 0) return NEAR;
    const narrow = Math.max(1, (this.apart ? 1.5 : 1) * height / width);
    return Math.min(NEAR * narrow * height / Math.max(height - TOOLS, 160), 9);
  }

  // theta from +x around z, phi from +z, as seen from the target.
  private spherical(): Spherical {
    const from = this.camera.position.clone().sub(this.orbit.target);
    return new Spherical(from.length(), Math.acos(from.z / (from.length() || 1)), Math.atan2(from.y, from.x));
  }

  private place(place: Spherical): void {
    const phi = Math.min(1.62, Math.max(0.02, place.phi));
    const radius = Math.min(this.orbit.maxDistance, Math.max(this.orbit.minDistance, place.radius));
    this.camera.position.set(
      radius * Math.sin(phi) * Math.cos(place.theta), radius * Math.sin(phi) * Math.sin(place.theta),
      radius * Math.cos(phi)).add(this.orbit.target);
    this.orbit.update();
    this.sayWhere();
  }

  // From where we look: for whoever can not see it, and for tests.
  private sayWhere(): void {
    const { phi, radius, theta } = this.spherical();
    this.canvas.dataset.distance = radius.toFixed(2);
    this.canvas.dataset.azimuth = degrees(theta).toFixed(0);
    this.canvas.dataset.elevation = (90 - degrees(phi)).toFixed(0);
    this.dirty = true;
  }

  private addFloor(): void {
    // Half metres, in short pieces: software renderers drop lines that reach behind the camera.
    const corners: number[] = [];
    for (let i = -FLOOR; i <= FLOOR; i++) {
      for (let k = -FLOOR; k < FLOOR; k++) {
        const [at, from, to] = [i / 2, k / 2, (k + 1) / 2];
        corners.push(from, at, 0, to, at, 0, at, from, 0, at, to, 0);
      }
    }
    const places = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(corners), 3));
    const grid = new LineSegments(places, new LineBasicMaterial({ color: 0x2b3541 }));
    const axes = new AxesHelper(0.5);
    axes.position.z = 0.002;
    this.scene.add(grid, axes);
  }

  private refine(): void {
    this.renderer.setPixelRatio(this.resolution.ratio);
    this.renderer.setSize(this.size.width, this.size.height, false);
    this.canvas.dataset.ratio = this.resolution.ratio.toFixed(2);
    this.dirty = true;
  }

  private resize(): void {
    const { width, height } = this.element.getBoundingClientRect();
    if (width === 0 || height === 0) return;
    const before = this.size.width === 0 ? undefined : this.distance();
    this.size = { width, height };
    this.resolution.reset();
    this.refine();
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (before === undefined) this.view("front");
    else {  // as near as it was, by the size that the body fills
      const place = this.spherical();
      place.radius *= this.distance() / before;
      this.place(place);
    }
    this.dirty = true;
  }
}
