// What an optical suit sends, as the page shows it. The bytes are of virtual tags; the test reads them itself
// (docs/optical-hardware.md: a start byte, then for each of 18 detectors the values of 16 projectors).
import { execFileSync } from "node:child_process";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { expect, program, root, test } from "./bench";

const TAGS = 5;
const INPUTS = 18;
const PROJECTORS = 16;
const SET = 1 + INPUTS * PROJECTORS;
const DARK = 2;
const COLOURS = ["#56b4e9", "#e69f00", "#3fbf93", "#cc79a7", "#f0e442", "#e8662a", "#7aa8ff", "#c9d1d9"];

/// value(cycle, detector, projector) of what the tags sent.
function sent(files: string[]): { cycles: number; value(cycle: number, detector: number, projector: number): number } {
  const tags = files.map((file) => readFileSync(file));
  for (const tag of tags) for (let at = 0; at < tag.length; at += SET) expect(tag[at]).toBe(255);
  return {
    cycles: Math.min(...tags.map(({ length }) => length)) / SET,
    value: (cycle, detector, projector) =>
      tags[Math.floor(detector / INPUTS)]![cycle * SET + 1 + (detector % INPUTS) * PROJECTORS + projector]!,
  };
}

test("the raw values and detector points of an optical suit are those that its tags sent", async ({ page, bench, errors }) => {
  const suit = join(bench.folder, "suit");
  execFileSync(program, ["virtual-tags", join(root, "reference_motions/low_block/learner.bvh"), "--files", suit, "--seconds", "6",
    "--calibration", `${suit}.txt`, "--true-body", `${suit}.toml`, "--dark", String(DARK)], { cwd: bench.folder });
  const files = Array.from({ length: TAGS }, (_, tag) => `${suit}${tag}.tag`);
  const { cycles, value } = sent(files);
  const all = Array.from({ length: cycles }, (_, cycle) => cycle);
  const detectors = Array.from({ length: TAGS * INPUTS }, (_, d) => d);
  bench.source = `optical:${files.join(",")}`;
  await bench.start("capture", "--projectors", `${suit}.txt`, "--body", `${suit}.toml`);
  await bench.start("dashboard");
  await bench.open(page, "signals");

  // How many of all detectors receive a projector, and between which values: as in one of the cycles.
  const now = page.locator("#raw-now");
  const projector = page.getByRole("combobox", { name: "Projector", exact: true });
  const group = page.getByRole("combobox", { name: "Detectors" });
  await expect(projector.locator("option")).toHaveCount(PROJECTORS);
  await expect(group.locator("option")).toHaveCount(1 + Math.ceil(detectors.length / 8));
  const overviews = (p: number): Set<string> => new Set(all.map((cycle) => {
    const seen = detectors.map((d) => value(cycle, d, p)).filter((v) => v > 0);
    return `${seen.length} of ${detectors.length} detectors receive this projector, values ${Math.min(...seen)} to ${Math.max(...seen)}.`;
  }));
  // The eight detectors and the projector that sees most of them, all the time.
  const count = (p: number, g: number): number =>
    all.reduce((sum, cycle) => sum + detectors.slice(g * 8, g * 8 + 8).filter((d) => value(cycle, d, p) > 0).length, 0);
  const pairs = Array.from({ length: PROJECTORS }, (_, p) => Array.from({ length: Math.floor(detectors.length / 8) }, (_, g) => ({ p, g, seen: count(p, g) }))).flat();
  expect(pairs.filter(({ p, seen }) => p === DARK && seen > 0)).toEqual([]);
  const { p: bright, g: best } = pairs.reduce((a, b) => (b.seen > a.seen ? b : a));
  await projector.selectOption(String(bright));
  const known = overviews(bright);
  await expect.poll(async () => known.has(await now.innerText())).toBe(true);
  await projector.selectOption(String(DARK));
  await expect(now).toHaveText(`0 of ${detectors.length} detectors receive this projector.`);
  await projector.selectOption(String(bright));

  // Eight detectors by name, the plot held: the numbers are those of one cycle, and each line ends at its number.
  const first = best * 8;
  await group.selectOption(String(best + 1));
  await expect(now).toContainText(`Now: detector ${first} `);
  await page.waitForTimeout(1500);  // a line of some length
  await page.getByRole("button", { name: "Hold plots" }).click();
  const words = await now.innerText();
  const shown = [...words.matchAll(/detector \d+ (nothing|\d+)/g)].map(([, text]) => (text === "nothing" ? 0 : Number(text)));
  expect(shown).toHaveLength(8);
  expect(all.some((cycle) => shown.every((v, i) => v === value(cycle, first + i, bright))), words).toBe(true);
  const ends = await page.evaluate(({ colours }) => {
    const plot = [...document.querySelectorAll<HTMLElement>(".signals .plot")].at(-1)!;
    const canvas = plot.querySelector("canvas")!;
    const area = plot.querySelector(".u-over")!.getBoundingClientRect();
    const box = canvas.getBoundingClientRect();
    const scale = canvas.width / box.width;
    const left = Math.round((area.right - box.left - 5) * scale);
    const top = Math.round((area.top - box.top) * scale);
    const height = Math.round(area.height * scale);
    const pixels = canvas.getContext("2d")!.getImageData(left, top, 4, height).data;
    // At which values, of the axis's 256, a colour stands in the last columns.
    return colours.map((colour) => {
      const wanted = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
      const values: number[] = [];
      for (let y = 0; y < height; y++) {
        for (let x = 0; x < 4; x++) {
          const at = (y * 4 + x) * 4;
          if (wanted.every((c, k) => Math.abs(c - pixels[at + k]!) < 12) && pixels[at + 3]! > 200) values.push(256 * (1 - (y + 0.5) / height));
        }
      }
      return values;
    });
  }, { colours: COLOURS });
  const seen = shown.filter((v) => v > 0).length;
  expect(seen).toBeGreaterThan(2);
  const drawn = shown.filter((v, i) => v > 0 && ends[i]!.some((at) => Math.abs(at - v) < 8)).length;
  // One line may lie under another, or have come into sight with its last value.
  expect(drawn, `${words} drawn at ${JSON.stringify(ends.map((at) => at.map(Math.round)))}`).toBeGreaterThanOrEqual(seen - 1);

  // Points of the detectors that enough projectors see.
  await page.getByRole("link", { name: "Session" }).click();
  const most = Math.max(...all.map((cycle) => detectors.filter((d) => Array.from({ length: PROJECTORS }, (_, p) => value(cycle, d, p)).filter((v) => v > 0).length >= 2).length));
  const points = async (): Promise<number> => Number(await page.locator("canvas").first().getAttribute("data-points"));
  await page.getByRole("button", { name: "Detector points" }).click();
  await expect.poll(points).toBeGreaterThan(most / 2);
  expect(await points()).toBeLessThanOrEqual(most);
  expect(errors).toEqual([]);
});
