// The parts of a session as processes, on a DDS domain and subject of this test's own, and the page in a
// browser. Real bridge, coach, tactor driver and virtual board.
import { spawn, type ChildProcess } from "node:child_process";
import { mkdtempSync, openSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { test as base, expect, type Page } from "@playwright/test";

export const root = fileURLToPath(new URL("../../../", import.meta.url));
export const program = process.env.SECONDSKIN_PROGRAM ?? join(root, "build/release/bin/secondskin");
export type Part = "board" | "tactors" | "coach" | "capture" | "dashboard" | "record";

export class Bench {
  readonly folder = mkdtempSync(join(tmpdir(), "secondskin-page-"));
  private readonly parts = new Map<Part, ChildProcess>();
  readonly bus: string[];
  port = 0;
  /// Narrow tolerances: something is cued nearly all the time.
  tolerance = "0.2";
  /// What is performed, under reference_motions/.
  motion = "low_block/learner.bvh";
  /// Another SOURCE instead.
  source = "";

  constructor(worker: number) {
    const own = process.pid * 8 + worker;
    this.bus = ["--domain", String(10 + (own % 90)), "--subject", `page_${own}`];
  }

  get url(): string { return `http://127.0.0.1:${this.port}/`; }

  async start(part: Part, ...more: string[]): Promise<void> {
    const board = join(this.folder, "board");
    const commands: Record<Part, string[]> = {
      board: ["virtual-board", "--link", board, "--waveform", this.waveform],
      tactors: ["tactors", "--port", board, ...this.bus],
      coach: ["coach", "--reference", "low_block", "--tolerance-scale", this.tolerance, ...this.bus],
      capture: ["capture", this.source || join(root, "reference_motions", this.motion), "--loop", ...this.bus],
      record: ["record", this.recording, ...this.bus],
      dashboard: ["dashboard", "--port", String(this.port), "--page", join(root, "clients/dashboard/web/dist"), ...this.bus],
    };
    const log = join(this.folder, `${part}.log`);
    const out = openSync(log, "a");
    const child = spawn(program, [...commands[part], ...more], {
      stdio: ["ignore", out, out], env: { ...process.env, XDG_DATA_HOME: this.folder, SECONDSKIN_DATA: process.env.SECONDSKIN_DATA ?? root }, cwd: this.folder,
    });
    this.parts.set(part, child);
    const ready: Partial<Record<Part, RegExp>> = { board: /port /, dashboard: /dashboard: http:\/\/127\.0\.0\.1:(\d+)/ };
    const wanted = ready[part];
    if (wanted == undefined) return;
    await expect.poll(() => readFileSync(log, "utf8"), { message: `${part} to be ready` }).toMatch(wanted);
    if (part === "dashboard") this.port = Number(wanted.exec(readFileSync(log, "utf8"))![1]);
  }

  async all(): Promise<void> {
    for (const part of ["board", "tactors", "coach", "capture", "dashboard"] as const) await this.start(part);
  }

  async end(part: Part, signal: NodeJS.Signals = "SIGTERM"): Promise<void> {
    const child = this.parts.get(part);
    this.parts.delete(part);
    if (child == undefined || child.exitCode != null || child.signalCode != null) return;
    const gone = new Promise((done) => child.once("exit", done));
    child.kill(signal);
    await gone;
  }

  async close(): Promise<void> {
    for (const part of ["record", "capture", "coach", "tactors", "board", "dashboard"] as const) await this.end(part);
    rmSync(this.folder, { recursive: true, force: true });
  }

  get recording(): string { return join(this.folder, "recordings", "monday.mcap"); }

  get waveform(): string { return join(this.folder, "waveform.csv"); }

  /// When the board changed and how many slots were in force: CLOCK_MONOTONIC [ns], as process.hrtime.
  boardRows(): { at: bigint; slots: number }[] {
    return readFileSync(this.waveform, "utf8").split("\n").slice(1).filter((line) => line.split(",").length === 18)
      .map((line) => {
        const [at, slots] = line.split(",");
        return { at: BigInt(at!), slots: Number(slots) };
      });
  }
  boardSlots(): number { return this.boardRows().at(-1)?.slots ?? 0; }

  async open(page: Page, view = "session"): Promise<void> {
    await page.goto(`${this.url}#${view}`);
    await expect(page.locator("body")).toHaveAttribute("data-link", "connected");
  }
}

export const test = base.extend<{ bench: Bench; errors: string[] }>({
  // eslint-disable-next-line no-empty-pattern
  bench: async ({}, use, info) => {
    const bench = new Bench(info.workerIndex);
    await use(bench);
    await bench.close();
  },
  // What the page's scripts complained of.
  errors: async ({ page }, use) => {
    const errors: string[] = [];
    page.on("pageerror", (error) => errors.push(String(error)));
    await use(errors);
    expect(errors).toEqual([]);
  },
});
export { expect };
