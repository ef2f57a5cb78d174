// The tactors on a flat figure, front and back, with what each is doing.
import { el, setData, setText, svg } from "../dom";
import type { Live } from "../live";
import type { TactorSite } from "../messages";
import { FIGURE, LIMBS, placesOf, sideOf } from "../model/places";
import { decodeSlots, type Drive } from "../model/slots";
import { segmentText, texts } from "../texts";

// A command holds 60 ms; a little more, for the way to this page.
const FRESH = 0.3;

interface Dot { channel: number; ring: SVGCircleElement; fill: SVGCircleElement; mark: SVGTextElement }

export class BodyMap {
  readonly element: HTMLElement;
  private readonly figures = { front: this.figure("front"), back: this.figure("back") };
  private readonly limbs = [...this.figures.front.querySelectorAll<SVGPathElement>(".limb"),
    ...this.figures.back.querySelectorAll<SVGPathElement>(".limb")];
  private readonly now = el("p", { class: "tactors-now" });
  private sites: TactorSite[] = [];
  private dots: Dot[] = [];
  private last = "";

  constructor() {
    this.element = el("section", { class: "card body-map", "aria-labelledby": "body-map-title" },
      el("h2", { id: "body-map-title" }, texts.body.heading),
      el("div", { class: "figures" }, ...(["front", "back"] as const).map((side) =>
        el("figure", {}, this.figures[side], el("figcaption", {}, texts.body[side])))),
      this.now);
  }

  setSites(sites: TactorSite[]): void {
    const key = JSON.stringify(sites.map((s) => [s.channel, s.segment, s.along, s.angle]));
    if (key === this.last) return;
    this.last = key;
    this.sites = sites;
    this.dots = [];
    for (const side of ["front", "back"] as const) {
      this.figures[side].querySelector(".dots")!.replaceChildren();
    }
    for (const site of sites) {
      for (const { side, x, y } of placesOf(site)) {
        const ring = svg("circle", { cx: x, cy: y, r: 6, class: "tactor" });
        const fill = svg("circle", { cx: x, cy: y, r: 0, class: "tactor-drive" });
        const mark = svg("text", { x, y: y + 3, class: "tactor-mark" });
        this.figures[side].querySelector(".dots")!.append(svg("g", {}, ring, fill, mark));
        this.dots.push({ channel: site.channel, ring, fill, mark });
      }
    }
  }

  frame(live: Live, now: number, stopped: boolean): void {
    const message = live.newest.tactors;
    const known = live.isLive("tactors", now, FRESH) && message != undefined;
    // Without a newer command the driver has switched everything off; without a connection nobody knows.
    const drives = known && !stopped ? decodeSlots(message.intensities) : null;
    setData(this.element, "state", !live.connected ? "unknown" : stopped ? "stopped" : "known");
    for (const dot of this.dots) this.show(dot, drives?.[dot.channel]);
    const lit = new Set(this.sites.filter(({ channel }) => (drives?.[channel]?.level ?? 0) > 0).map(({ segment }) => segment));
    for (const limb of this.limbs) setData(limb, "on", String(lit.has(limb.dataset.segment!)));
    setText(this.now, !live.connected ? texts.body.unknown : stopped ? texts.body.off : this.words(drives));
    const on = drives?.filter((drive) => drive.level > 0).length ?? 0;
    setData(this.element, "on", String(on));
    for (const side of ["front", "back"] as const) {
      const label = texts.body.figure(texts.body[side].toLowerCase(), on);
      if (this.figures[side].getAttribute("aria-label") !== label) this.figures[side].setAttribute("aria-label", label);
    }
  }

  private show(dot: Dot, drive: Drive | undefined): void {
    const level = drive?.level ?? 0;
    const state = level === 0 ? "off" : drive!.mode!;
    setData(dot.ring, "mode", state);
    const radius = level === 0 ? "0" : (4 + 8 * level).toFixed(1);
    if (dot.fill.getAttribute("r") !== radius) dot.fill.setAttribute("r", radius);
    setText(dot.mark, state === "saltation" ? "↻" : state === "saltation-reverse" ? "↺" : "");
  }

  private words(drives: Drive[] | null): string {
    if (drives == null) return texts.body.quiet;
    // The strongest two; a ring counts once.
    const on = this.sites.flatMap((site) => {
      const drive = drives[site.channel];
      return drive && drive.level > 0 && drive.mode ? [{ site, level: drive.level, mode: drive.mode }] : [];
    }).sort((a, b) => b.level - a.level);
    const rings = new Set<string>();
    const parts = on.flatMap(({ site, level, mode }) => {
      const ring = mode.startsWith("saltation");
      if (ring && rings.has(site.segment)) return [];
      if (ring) rings.add(site.segment);
      return [texts.body.now(segmentText(site.segment), ring ? texts.body.ring : texts.body.side[sideOf(site.angle)],
        Math.round(level * 100), texts.body.mode[mode])];
    });
    return parts.length === 0 ? texts.body.quiet : parts.slice(0, 2).join("\n");
  }

  private figure(side: "front" | "back"): SVGSVGElement {
    const limbs = [...LIMBS].map(([name, limb]) => {
      // A limb's outline: two half circles and their tangents, good enough for a map.
      const length = Math.hypot(limb.x2 - limb.x, limb.y2 - limb.y) || 1;
      const nx = -(limb.y2 - limb.y) / length;
      const ny = (limb.x2 - limb.x) / length;
      const at = (x: number, y: number, r: number): string => `${(x + nx * r).toFixed(1)} ${(y + ny * r).toFixed(1)}`;
      const d = `M${at(limb.x, limb.y, limb.r)} L${at(limb.x2, limb.y2, limb.r2)}`
        + ` A${limb.r2} ${limb.r2} 0 0 0 ${at(limb.x2, limb.y2, -limb.r2)} L${at(limb.x, limb.y, -limb.r)}`
        + ` A${limb.r} ${limb.r} 0 0 0 ${at(limb.x, limb.y, limb.r)} Z`;
      return svg("path", { d, class: "limb", "data-segment": name });
    });
    const shape = svg("g", {}, ...limbs);
    if (side === "back") shape.setAttribute("transform", `translate(${FIGURE.width} 0) scale(-1 1)`);
    return svg("svg", { viewBox: `8 2 ${FIGURE.width - 16} ${FIGURE.height - 8}`, role: "img" }, shape, svg("g", { class: "dots" }));
  }
}
