import { join } from "node:path";
import { existsSync, readdirSync } from "node:fs";
import AxeBuilder from "@axe-core/playwright";
import { expect, root, test } from "./bench";

interface State { state: { phase: string; paused: boolean; recorded: number }; takes: { parts: { start: number; end: number; chosen: boolean }[] }[] }

// Real squats, at double speed so that a take is short.
test("from two takes to a trained reference, by mouse", async ({ page, bench, errors }) => {
  bench.motion = "deep_squat/learner.bvh";
  await bench.start("board");
  await bench.start("tactors");
  await bench.start("coach");
  await bench.start("capture", "--speed", "2");
  await bench.start("dashboard");
  await bench.open(page, "record");
  const takes = async (): Promise<State> => await (await page.request.get(`${bench.url}api/takes`)).json() as State;
  await expect(page.locator(".record-source")).toContainText("Measured:");
  await page.locator("#record-countdown").selectOption("3");

  const main = page.locator("#record-main");
  for (const take of [1, 2]) {
    await main.click();
    await expect(page.locator(".record-overlay")).toHaveAttribute("data-phase", "countdown");
    await expect(page.locator(".record-overlay strong")).toHaveText(/[123]/);
    await expect(page.locator(".record-overlay")).toHaveAttribute("data-phase", "recording");
    // Nothing vibrates on the expert.
    await expect.poll(() => bench.boardSlots()).toBe(0);
    expect((await takes()).state.paused).toBe(true);
    await expect(page.locator(".record-overlay strong")).toHaveText(/^([5-9]|\d\d) s$/);
    await main.click();
    await expect(page.locator(".take")).toHaveCount(take);
  }

  await page.locator("#record-next").click();
  const boxes = page.locator(".take-part input[type=checkbox]");
  const found = await boxes.count();
  expect(found).toBeGreaterThanOrEqual(4);
  await expect(page.locator(".average")).toContainText(`Mean of ${found} repetitions`);
  // The first and the last may have begun in mid-movement: they are left out.
  await boxes.first().uncheck();
  await expect(page.locator(".average")).toContainText(`Mean of ${found - 1} repetitions`);
  await expect(page.locator(".record-stage canvas")).toHaveAttribute("data-bodies", String(found));
  await expect(page.locator(".joint-plot")).toHaveCount(4);
  // A cut is moved by a key and is kept by the bridge.
  const cut = page.getByLabel("Take 2, repetition 1: end");
  const before = Number(await cut.inputValue());
  await cut.focus();
  await page.keyboard.press("ArrowLeft");
  await expect.poll(async () => (await takes()).takes[1]!.parts[0]!.end).toBeLessThan(before);
  await expect.poll(async () => (await takes()).takes[0]!.parts[0]!.chosen).toBe(false);

  await page.locator("#record-next").click();
  const knee = page.locator("[data-joint=left_knee]");
  await expect(knee).toContainText(/moves \d+°, repetitions differ by/);
  await page.getByLabel("Left knee: tolerance").fill("12");
  await expect(knee).toContainText("12°");

  await page.locator("#record-next").click();
  await page.locator("#reference-name").fill("Anna's squat");
  await expect(page.getByText("It will be called anna_s_squat")).toBeVisible();
  await page.locator("#save-reference").click();
  await expect(page.locator(".saved")).toBeVisible();
  const folder = join(bench.folder, "secondskin/reference_motions");
  expect(readdirSync(folder)).toEqual(["anna_s_squat"]);
  const info = await (await page.request.get(`${bench.url}api/references/anna_s_squat`)).json() as { joints: { name: string; tolerance_deg: number }[] };
  expect(info.joints.find(({ name }) => name === "left_knee")!.tolerance_deg).toBeCloseTo(12, 6);
  for (const format of ["bvh", "c3d", "trc", "csv", "mcap"]) {
    const file = await page.request.get(`${bench.url}api/references/anna_s_squat/export?format=${format}`);
    expect(file.status(), format).toBe(200);
    expect((await file.body()).length, format).toBeGreaterThan(1000);
  }

  await page.locator("#train-now").click();
  await expect(page.locator("#reference")).toHaveValue("anna_s_squat");
  await expect(page.locator(".exercise")).toHaveText("Anna s squat");
  await expect(page.locator(".score-bars button")).not.toHaveCount(0);
  expect(existsSync(join(folder, ".anna_s_squat.part"))).toBe(false);
  expect(errors).toEqual([]);
});

test("a take by keyboard, a file by the chooser, both kept when the page is loaded anew", async ({ page, bench, errors }) => {
  await bench.start("capture", "--speed", "2");
  await bench.start("dashboard");
  await bench.open(page, "record");
  await expect(page.locator("#record-main")).toBeEnabled();
  await page.locator("#record-countdown").selectOption("3");
  await page.evaluate(() => (document.activeElement as HTMLElement).blur());
  await page.keyboard.press("Space");
  await expect(page.locator(".record-overlay")).toHaveAttribute("data-phase", "countdown");
  await page.keyboard.press("Space");
  await expect(page.locator(".record-overlay")).toBeHidden();
  await expect(page.locator(".take")).toHaveCount(0);
  await page.keyboard.press("Space");
  await expect(page.locator(".record-overlay strong")).toHaveText(/^([2-9]|\d\d) s$/);
  await expect(page.locator(".record-overlay")).toHaveAttribute("data-phase", "recording");
  await page.keyboard.press("Space");
  await expect(page.locator(".take")).toHaveCount(1);

  await page.locator("#record-file").setInputFiles(join(root, "reference_motions/deep_squat/learner.bvh"));
  await expect(page.locator(".take")).toHaveCount(2);
  await expect(page.locator(".take").nth(1)).toContainText("3 repetitions found");
  await page.locator("#record-file").setInputFiles(join(root, "README.md"));
  await expect(page.locator(".record-side .message")).toContainText("name: 'README.md': expected a file's name that ends in .bvh");

  // Each step, without a fault that axe finds, on a tablet and on a phone.
  for (const step of ["1 Record", "2 Choose", "3 Joints", "4 Save"]) {
    await page.getByRole("button", { name: step }).click();
    if (step !== "1 Record") await expect(page.locator(".average")).toBeVisible();
    for (const [width, height] of [[1024, 768], [390, 844]] as const) {
      await page.setViewportSize({ width, height });
      const { violations } = await new AxeBuilder({ page }).withTags(["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]).analyze();
      expect(violations.map(({ id, nodes }) => [id, nodes.map(({ html }) => html)]), `${step} ${width}`).toEqual([]);
      expect(await page.evaluate(() => document.documentElement.scrollWidth), `${step} ${width}`).toBeLessThanOrEqual(width);
    }
  }

  await page.reload();
  await expect(page.locator(".take")).toHaveCount(2);
  await page.getByRole("button", { name: "Delete take 1" }).click();
  await page.getByRole("dialog").getByRole("button", { name: "Yes, delete it" }).click();
  await expect(page.locator(".take")).toHaveCount(1);
  await expect(page.locator(".take")).toContainText("3 repetitions found");
  expect(errors).toEqual([]);
});
