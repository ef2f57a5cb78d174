// The pictures of docs/therapists.md, from the running product: tools/screenshots calls this.
import { mkdirSync } from "node:fs";
import { dirname, join } from "node:path";
import { expect, test } from "./bench";

const folder = process.env.SECONDSKIN_SCREENSHOTS ?? "";
test.skip(folder === "", "makes pictures, tests nothing");

test("pictures", async ({ page, bench }) => {
  test.setTimeout(300_000);
  const shoot = (name: string): Promise<unknown> => page.screenshot({ path: join(folder, `dashboard-${name}.png`) });
  const cued = async (): Promise<void> => {
    // A moment that shows something: a limb outside its tolerance, and a tactor on.
    await page.waitForFunction(() => document.querySelector(".stage-label:not([hidden])") != null
      && document.querySelector(".body-map[data-on='0']") == null, undefined, { polling: "raf" });
  };
  bench.tolerance = "0.6";
  await bench.start("board");
  await bench.start("tactors");
  await bench.start("coach", "--wait", "--plan", "fading");
  await bench.start("capture");
  await bench.start("dashboard");
  await bench.open(page);
  const learners = page.locator("#learner option");
  const history = (await (await page.request.get(`${bench.url}api/info`)).json() as { history: boolean }).history;
  if (history) {
    await page.request.post(`${bench.url}api/history/learners`, { data: { note: "left shoulder" }, headers: { origin: bench.url.slice(0, -1) } });
    await page.reload();
    await expect(learners).toHaveCount(3);
    await page.locator("#learner").selectOption({ index: 1 });
  }
  await page.locator("#main").click();
  await expect(page.locator(".score-bars button")).toHaveCount(2);
  await cued();
  await shoot("session");
  await page.getByRole("button", { name: "Side by side" }).click();
  await page.setViewportSize({ width: 1024, height: 768 });
  await cued();
  await shoot("tablet");
  await page.setViewportSize({ width: 390, height: 844 });
  await page.getByRole("button", { name: "Side by side" }).click();
  await cued();
  await shoot("phone");
  await page.setViewportSize({ width: 1440, height: 900 });
  await page.keyboard.press("Escape");
  await expect(page.locator("#stop")).toHaveText("Vibration is OFF");
  await shoot("stopped");
  await page.locator("#lift").click();
  await page.getByRole("button", { name: "Yes, allow vibration" }).click();
  await page.goto(`${bench.url}#signals`);
  await expect(page.locator(".badge").first()).toBeVisible();
  await page.waitForTimeout(10_000);  // so that the plots have something to show
  await shoot("signals");
  if (history) {
    await page.goto(`${bench.url}#session`);
    await page.locator("#end").click();
    await page.getByRole("dialog").getByRole("button", { name: "End session" }).click();
    await expect(page.locator(".phase")).toHaveText("Session ended");
    await page.goto(`${bench.url}#history`);
    await expect(page.getByRole("img", { name: "Progress" })).toBeVisible();
    await shoot("history");
  }
  await page.goto(`${bench.url}#session`);
  await bench.end("dashboard", "SIGKILL");
  await expect(page.getByRole("alert").first()).toBeVisible();
  await shoot("lost");
});

test("pictures of a new reference", async ({ page, bench }) => {
  test.setTimeout(300_000);
  bench.motion = "deep_squat/learner.bvh";
  await bench.start("capture");
  await bench.start("dashboard");
  await bench.open(page, "record");
  await page.locator("#record-countdown").selectOption("3");
  for (const take of [1, 2]) {
    await page.locator("#record-main").click();
    await expect(page.locator(".record-overlay")).toHaveAttribute("data-phase", "recording");
    await page.waitForTimeout(9000);
    await page.locator("#record-main").click();
    await expect(page.locator(".take")).toHaveCount(take);
  }
  await page.locator("#record-next").click();
  await expect(page.locator(".average")).toContainText("Mean of");
  await expect(page.locator(".joint-plot")).toHaveCount(4);
  // The first of each may have begun in mid-movement.
  for (const take of [0, 1]) await page.locator(".take").nth(take).locator("input[type=checkbox]").first().uncheck();
  await page.waitForTimeout(2000);  // some of the way through the movement
  await page.screenshot({ path: join(folder, "dashboard-choose.png") });
});

test("picture of a recording", async ({ page, bench }) => {
  test.setTimeout(300_000);
  bench.tolerance = "0.5";
  mkdirSync(dirname(bench.recording));
  for (const part of ["record", "board", "tactors", "coach", "capture", "dashboard"] as const) await bench.start(part);
  await bench.open(page);
  await expect(page.locator(".score-bars button")).toHaveCount(2);
  await bench.end("record");
  await page.goto(`${bench.url}#recordings`);
  await page.getByRole("row", { name: /monday\.mcap/ }).getByRole("link").click();
  await expect(page.locator("#ghost-note")).toHaveText("");
  for (let second = 0; second < 3; second++) await page.keyboard.press("ArrowRight");
  await expect(page.locator(".pane .body-map")).toBeVisible();
  await page.waitForTimeout(1500);
  await page.screenshot({ path: join(folder, "dashboard-player.png") });
});
