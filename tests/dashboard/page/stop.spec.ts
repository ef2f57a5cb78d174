import { expect, test } from "./bench";

test("stop from a second page turns the board off, and both pages say so", async ({ page, context, bench, errors }, info) => {
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
  const pressed = await second.evaluate(() => {
    document.getElementById("stop")!.click();
    return 0;
  }).then(() => process.hrtime.bigint());
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
  const off = bench.boardRows().findLast(({ slots }) => slots > 0);
  const last = bench.boardRows().find(({ at, slots }) => slots === 0 && at >= (off?.at ?? 0n))!.at;
  const took = Number(last - pressed) / 1e6;
  info.annotations.push({ type: "after the click's answer [ms]", description: took.toFixed(1) });
  console.log(`board off ${took.toFixed(1)} ms after the click had returned`);

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
  for (const view of ["session", "history", "signals"]) {
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
