// A session is recorded by the real services, and opened in the page.
import AxeBuilder from "@axe-core/playwright";
import { mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import type { Page } from "@playwright/test";
import { expect, test, type Bench } from "./bench";
import { lengthen } from "./long";

const REPETITIONS = 2;
const LONG = 20 * 1024 * 1024;  // [bytes]
const BLOCK = 512 * 1024;       // that the page asks for at once [bytes]

async function record(bench: Bench, page: Page): Promise<void> {
  bench.tolerance = "0.5";
  mkdirSync(dirname(bench.recording));
  await bench.start("record");
  await bench.start("board");
  await bench.start("tactors");
  await bench.start("coach");
  await bench.start("capture");
  await bench.start("dashboard");
  await bench.open(page);
  await expect(page.locator(".score-bars button")).toHaveCount(REPETITIONS);
  for (const part of ["capture", "coach", "record"] as const) await bench.end(part);
}

/// What the clock says [s].
async function head(page: Page): Promise<number> {
  const text = (await page.locator("#clock").textContent()) ?? "";
  const [minutes, seconds] = text.split(" ")[0]!.split(":");
  return Number(minutes) * 60 + Number(seconds);
}

/// Readable for everybody, and nothing runs out of the page, at each size.
async function looks(page: Page): Promise<void> {
  for (const [width, height] of [[390, 844], [1024, 768], [1440, 900]] as const) {
    await page.setViewportSize({ width, height });
    // Plots follow the window's width in the next frame.
    await expect.poll(() => page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth), { message: `${width}` }).toBeLessThanOrEqual(0);
    const { violations } = await new AxeBuilder({ page }).withTags(["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]).analyze();
    expect(violations.map(({ id, nodes }) => [id, nodes.map(({ html, failureSummary }) => [html, failureSummary])]), `${width}`).toEqual([]);
  }
}

async function cues(page: Page, column: number): Promise<number> {
  const cells = await page.locator(`#compare-scores tbody tr td:nth-of-type(${column})`).allTextContents();
  return cells.reduce((sum, text) => sum + (Number(text) || 0), 0);
}

test("a recorded session is played, looped, re-run and compared", async ({ page, bench, errors }) => {
  await record(bench, page);
  const bytes = readFileSync(bench.recording);
  writeFileSync(join(dirname(bench.recording), "torn.mcap"), bytes.subarray(0, Math.floor(bytes.length * 0.6)));
  writeFileSync(join(dirname(bench.recording), "broken.mcap"), "this is no recording");
  await page.getByRole("link", { name: "Recordings" }).click();
  const row = page.getByRole("row", { name: /monday\.mcap/ });
  await expect(row).toContainText("finished");
  await expect(row).toContainText("Low block");
  await expect(page.getByRole("row", { name: /broken\.mcap/ })).toContainText("DAMAGED: broken.mcap");
  await looks(page);
  await row.getByRole("link").click();

  // The same views as a live session: the body is drawn, the ghost comes.
  const canvas = page.locator(".pane canvas").first();
  await expect(page.locator("#play")).toBeVisible();
  await expect(page.locator("#ghost-note")).toHaveText("");
  await expect.poll(async () => Number(await canvas.getAttribute("data-drawn"))).toBeGreaterThan(0);

  // Seek to the end and back: the scores follow.
  await page.keyboard.press("End");
  await expect(page.locator(".pane .score-bars button")).toHaveCount(REPETITIONS);
  await expect(page.locator(".pane #score")).toHaveText(/^\d+$/);
  await page.keyboard.press("Home");
  await expect.poll(() => head(page)).toBe(0);
  await expect(page.locator(".pane .score-bars button")).toHaveCount(0);

  // By keyboard: play, pause, seconds, frames.
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("ArrowRight");
  await expect.poll(() => head(page)).toBe(2);
  await page.keyboard.press("ArrowLeft");
  await expect.poll(() => head(page)).toBe(1);
  const drawn = Number(await canvas.getAttribute("data-drawn"));
  await page.keyboard.press(".");
  await expect.poll(async () => Number(await canvas.getAttribute("data-drawn"))).toBeGreaterThan(drawn);
  await page.keyboard.press("Space");
  await expect(page.locator("#play")).toHaveText("Pause");
  await expect.poll(() => head(page)).toBeGreaterThan(1.5);
  await expect(page.locator(".pane .phase")).toHaveText("Moving");
  await page.keyboard.press("Space");
  await expect(page.locator("#play")).toHaveText("Play");

  // A loop of one repetition is not left, at four times the speed.
  await page.locator("#speed").selectOption("4");
  await page.locator("#loop").selectOption("1");
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  const begin = await head(page);  // before it moves: the choice of a loop goes to its beginning
  await page.locator("#play").click();
  let jumps = 0;
  let last = begin;
  await expect.poll(async () => {
    const now = await head(page);
    if (now < last) jumps++;
    last = now;
    expect(now).toBeGreaterThanOrEqual(begin - 0.11);
    return jumps;
  }, { intervals: [40] }).toBeGreaterThan(1);
  await page.locator("#play").click();
  await page.locator("#loop").selectOption("");

  // The slider.
  await page.locator("#seek").fill("2.5");
  await expect.poll(() => head(page)).toBe(2.5);

  // Twice the tolerance: the same scores, fewer cues.
  await page.locator("#rerun-tolerance").selectOption("1");
  await page.locator("#rerun").click();
  await expect(page.locator("#rerun-message")).toHaveText(/^Cues: \d+ recorded, \d+ in the re-run/);
  const scores = page.locator("#compare-scores tbody tr").first().locator("td");
  await expect(scores.nth(1)).toHaveText((await scores.nth(0).textContent())!);
  expect(await cues(page, 4)).toBeLessThan(await cues(page, 3));
  await expect(page.locator(".pane")).toHaveCount(2);
  const both = page.locator(".pane canvas");
  await expect(both).toHaveCount(2);
  await looks(page);
  await page.keyboard.press("End");
  await expect(page.locator(".pane").nth(1).locator(".score-bars button")).toHaveCount(REPETITIONS);
  // With eight tactors on one arm.
  await page.locator("#rerun-body-map").selectOption("right_arm");
  await page.locator("#rerun").click();
  await expect(page.locator("#rerun-message")).toHaveText(/running|runs: \d+ %/);
  await expect(page.locator("#rerun-message")).toHaveText(/^Cues: \d+ recorded, \d+ in the re-run/);
  const worn = async (pane: number): Promise<number> => page.locator(".pane").nth(pane).locator(".body-map .tactor").count();
  await expect.poll(() => worn(1)).toBeGreaterThan(0);
  expect(await worn(1)).toBeLessThan(await worn(0));
  await page.getByRole("button", { name: "Re-run", exact: true }).click();
  await expect(page.locator(".pane").first()).toBeHidden();

  // Of a long one the bridge gathers the states that are spread over it, and the page reads little else.
  await lengthen(bench.recording, join(dirname(bench.recording), "long.mcap"), LONG);
  const asked: string[] = [];
  page.on("request", (request) => asked.push(new URL(request.url()).pathname));
  await page.locator("#back").click();
  await page.getByRole("link", { name: "Open long.mcap" }).click();
  await expect(page.locator("#play")).toBeVisible();
  expect(asked).toContain("/api/recordings/long.mcap/states");
  await page.keyboard.press("End");
  await expect(page.locator(".pane .score-bars button")).toHaveCount(REPETITIONS);
  await expect(page.locator(".pane .exercise")).toHaveText("Low block");
  expect(asked.filter((path) => path === "/api/recordings/monday.mcap/states")).toEqual([]);
  expect(asked.filter((path) => path === "/api/recordings/long.mcap/file").length).toBeLessThan(LONG / BLOCK / 4);
  rmSync(join(dirname(bench.recording), "long.mcap"));

  // A file without its end.
  await page.locator("#back").click();
  await page.getByRole("link", { name: "Open torn.mcap" }).click();
  await expect(page.locator(".player")).toContainText(/not finished|still being made/);
  await expect(page.locator("#play")).toBeVisible();
  expect(errors).toEqual([]);

  // The user's own files stay here, whole or torn; another kind of file is named.
  await page.locator("#back").click();
  const chooser = page.locator("input[type=file]");
  await chooser.setInputFiles(join(dirname(bench.recording), "broken.mcap"));
  await expect(page.locator(".recordings")).toContainText("broken.mcap cannot be opened: it is no MCAP recording");
  await chooser.setInputFiles(join(dirname(bench.recording), "torn.mcap"));
  await expect(page.locator(".player")).toContainText("This recording was not finished");
  await page.keyboard.press("End");
  await expect.poll(() => head(page)).toBeGreaterThan(1);
  expect(errors).toEqual([]);

  // From its row in the history, by mouse and by keyboard; the address keeps it. Gone with the file.
  rmSync(join(dirname(bench.recording), "torn.mcap"));
  await bench.open(page, "history");
  const play = page.getByRole("link", { name: /^Play the recording of/ });
  await expect(play).toHaveCount(1);
  await looks(page);
  await play.click();
  for (const arrived of ["by mouse", "by its address"]) {
    await expect(page.locator(".player h2").first(), arrived).toHaveText("monday.mcap");
    await expect(page.locator(".pane .exercise"), arrived).toHaveText("Low block");
    expect(page.url(), arrived).toContain("#recordings/monday.mcap");
    await page.reload();
  }
  await bench.open(page, "history");
  await play.press("Enter");
  await expect(page.locator(".player h2").first()).toHaveText("monday.mcap");
  rmSync(bench.recording);
  await bench.open(page, "history");
  await expect(page.getByRole("row", { name: /Low block/ })).toContainText("no recording");
  await expect(play).toHaveCount(0);
  expect(errors).toEqual([]);
});
