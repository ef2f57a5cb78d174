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
