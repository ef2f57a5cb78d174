import AxeBuilder from "@axe-core/playwright";
import { expect, test } from "./bench";

const SIZES = { desktop: [1440, 900], tablet: [1024, 768], phone: [390, 844] } as const;
const VIEWS = ["session", "record", "history", "signals"] as const;

test("no view has an accessibility fault that axe finds, at any size", async ({ page, bench }) => {
  await bench.all();
  for (const [width, height] of Object.values(SIZES)) {
    await page.setViewportSize({ width, height });
    for (const view of VIEWS) {
      await bench.open(page, view);
      if (view === "session") await expect(page.locator(".score-bars button").first()).toBeVisible();
      if (view === "signals") await expect(page.locator(".badge").first()).toBeVisible();
      const { violations } = await new AxeBuilder({ page }).withTags(["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]).analyze();
      expect(violations.map(({ id, nodes }) => [id, nodes.map(({ html, failureSummary }) => [html, failureSummary])]), `${view} ${width}`).toEqual([]);
    }
  }
  await page.getByRole("button", { name: "Help" }).click();
  expect((await new AxeBuilder({ page }).analyze()).violations.map(({ id }) => id)).toEqual([]);
  await page.getByRole("button", { name: "Close" }).click();
  await page.locator("#stop").click();
  await page.locator("#lift").click();
  expect((await new AxeBuilder({ page }).analyze()).violations.map(({ id }) => id)).toEqual([]);
});

test("STOP is in sight in every view at every size, and nothing runs out of the page", async ({ page, bench }, info) => {
  await bench.all();
  for (const [name, [width, height]] of Object.entries(SIZES)) {
    await page.setViewportSize({ width, height });
    for (const view of VIEWS) {
      await bench.open(page, view);
      await page.reload();
      if (view === "session") await expect(page.locator(".session")).toHaveAttribute("data-live", "true");
      await page.mouse.wheel(0, 5000);
      await expect(page.locator("#stop")).toBeInViewport({ ratio: 1 });
      const box = (await page.locator("#stop").boundingBox())!;
      expect(box.width).toBeGreaterThanOrEqual(240);
      expect(box.height).toBeGreaterThanOrEqual(56);
      expect(await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth), `${view} ${name}`).toBeLessThanOrEqual(0);
      await page.mouse.wheel(0, -5000);
      await page.screenshot({ path: info.outputPath(`${view}-${name}.png`) });
    }
  }
});

test("on desktop and tablet the whole session is seen without scrolling", async ({ page, bench }) => {
  await bench.all();
  for (const [width, height] of [SIZES.desktop, SIZES.tablet]) {
    await page.setViewportSize({ width, height });
    await bench.open(page);
    for (const part of [".stage", ".status", ".body-map", ".timeline", ".controls", "#main"]) {
      await expect(page.locator(part)).toBeInViewport({ ratio: 1 });
    }
  }
});

test("the view fits after a tablet is turned as it does when the page is opened so", async ({ page, bench }) => {
  await bench.all();
  const canvas = page.locator(".stage canvas");
  const distance = async (): Promise<number> => Number(await canvas.getAttribute("data-distance"));
  const [wide, high] = SIZES.tablet;
  await page.setViewportSize({ width: high, height: wide });
  await bench.open(page);
  const upright = await distance();
  await page.setViewportSize({ width: wide, height: high });
  await page.reload();
  const flat = await distance();
  expect(Math.abs(upright - flat)).toBeGreaterThan(0.05);
  await page.setViewportSize({ width: high, height: wide });
  await expect.poll(distance).toBeCloseTo(upright, 1);
  // Whoever went nearer stays nearer.
  await canvas.press("+");
  await page.setViewportSize({ width: wide, height: high });
  await expect.poll(distance).toBeCloseTo(0.9 * flat, 1);
});

test("each error's label is beside the body, apart from the others, and a line leads to its joint", async ({ page, bench }) => {
  await bench.all();
  for (const [width, height] of Object.values(SIZES)) {
    await page.setViewportSize({ width, height });
    await bench.open(page);
    // All of one drawn frame, in which some are shown.
    const labels = await (await page.waitForFunction(() => {
      const stage = document.querySelector(".stage-canvas")!.getBoundingClientRect();
      const paths = [...document.querySelectorAll(".stage-leads path")];
      const shown = [...document.querySelectorAll<HTMLElement>(".stage-label")].flatMap((label, i) => {
        if (label.hidden) return [];
        const box = label.getBoundingClientRect();
        const [fromX, fromY, toX, toY] = paths[i]!.getAttribute("d")!.match(/-?[\d.e-]+/g)!.map(Number);
        return [{ right: label.dataset.right === "true", left: box.left - stage.left, end: box.right - stage.left,
          top: box.top - stage.top, bottom: box.bottom - stage.top, fromX, fromY, toX, toY, width: stage.width, height: stage.height }];
      });
      return shown.length > 1 && shown;
    })).jsonValue() || [];
    for (const [i, label] of labels.entries()) {
      const where = JSON.stringify({ width, label });
      expect(Math.abs(label.toX! - (label.right ? label.left : label.end)), where).toBeLessThan(2);
      expect(label.toY!, where).toBeGreaterThanOrEqual(label.top - 2);
      expect(label.toY!, where).toBeLessThanOrEqual(label.bottom + 2);
      expect(label.fromX! > 0 && label.fromX! < label.width && label.fromY! > 0 && label.fromY! < label.height, where).toBe(true);
      expect(label.left, where).toBeGreaterThanOrEqual(0);
      expect(label.end, where).toBeLessThanOrEqual(label.width + 1);
      for (const other of labels.slice(i + 1)) {
        expect(other.right !== label.right || other.top >= label.bottom - 1 || label.top >= other.bottom - 1, where).toBe(true);
      }
    }
  }
});
