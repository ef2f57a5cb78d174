import { expect, test } from "./bench";

test("stop from a second page turns the board off, and both pages say so", async ({ page, context, bench, errors }) => {
  await bench.all();
  await bench.open(page);
  const second = await context.newPage();
  await bench.open(second, "signals");
  await expect.poll(() => bench.boardSlots()).toBeGreaterThan(0);
  await page.bringToFront();
  await expect(page.locator(".body-map")).not.toHaveAttribute("data-on", "0");

  // Pressed at a moment when something is on, so that there is something to turn off.
  await second.bringToFront();
  await expect.poll(() => bench.boardSlots(), { intervals: [5] }).toBeGreaterThan(0);
  const pressed = process.hrtime.bigint();
  await second.evaluate(() => document.getElementById("stop")!.click());
  for (const one of [page, second]) await expect(one.locator("#stop")).toHaveText("Vibration is OFF");
  await expect.poll(() => bench.boardSlots()).toBe(0);

  // It stays off while the session goes on.
  const rows = bench.boardRows().length;
  await page.bringToFront();
  await expect(page.locator(".body-map")).toHaveAttribute("data-on", "0");
  await expect(page.locator(".tactors-now")).toHaveText("Off: stopped");
  const score = await page.locator(".score-bars button").count();
  await expect.poll(() => page.locator(".score-bars button").count()).toBeGreaterThan(score);
  expect(bench.boardRows().slice(rows).every(({ slots }) => slots === 0)).toBe(true);
  // How long it took, from before the click was sent to the browser. A figure, no bound: this machine
  // draws three dimensions on the processor meanwhile.
  const all = bench.boardRows();
  const off = all[all.findLastIndex(({ slots }) => slots > 0) + 1]!;
  const took = Number(off.at - pressed) / 1e6;
  console.log(took > 0 ? `board off ${took.toFixed(1)} ms after the click` : "the board was off when the click came");

  // Lifting from the first page asks once more.
  await page.locator("#lift").click();
  await page.getByRole("button", { name: "No, keep it off" }).click();
  await expect(page.locator("#stop")).toHaveText("Vibration is OFF");
  await page.locator("#lift").click();
  await page.getByRole("button", { name: "Yes, allow vibration" }).click();
  for (const one of [page, second]) await expect(one.locator("#stop")).toHaveText("STOP vibration");
  await expect.poll(() => bench.boardSlots()).toBeGreaterThan(0);
  expect(errors).toEqual([]);
});

test("a page that comes later knows of the stop", async ({ page, context, bench }) => {
  await bench.all();
  await bench.open(page);
  await page.locator("#stop").click();
  await expect(page.locator("#stop")).toHaveText("Vibration is OFF");
  const later = await context.newPage();
  await bench.open(later, "history");
  await expect(later.locator("#stop")).toHaveText("Vibration is OFF");
});

test("Esc stops in every view, also in a dialog", async ({ page, bench }) => {
  await bench.all();
  for (const view of ["session", "record", "history", "signals"]) {
    await bench.open(page, view);
    await page.reload();
    await expect(page.locator("#stop")).toHaveText("STOP vibration");
    if (view === "history") {
      await page.getByRole("button", { name: "Help" }).click();
      await expect(page.getByRole("dialog")).toBeVisible();
    }
    await page.keyboard.press("Escape");
    await expect(page.locator("#stop")).toHaveText("Vibration is OFF");
    await page.locator("#lift").click();
    await page.getByRole("button", { name: "Yes, allow vibration" }).click();
    await expect(page.locator("#stop")).toHaveText("STOP vibration");
  }
});
