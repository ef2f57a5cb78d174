import { expect, test } from "./bench";

test("a whole session by mouse", async ({ page, bench, errors }) => {
  await bench.start("board");
  await bench.start("tactors");
  await bench.start("coach", "--wait");
  await bench.start("capture");
  await bench.start("dashboard");
  await bench.open(page);
  const phase = page.locator(".phase");
  const main = page.locator("#main");
  await expect(page.locator("#reference option")).toHaveText(["Low block"]);
  await expect(main).toHaveText("Start");
  for (let i = 0; i < 2; i++) await page.getByRole("button", { name: "Tolerance: less" }).click();
  await expect(page.locator("#tolerance")).toHaveText("0.5 ×");
  await page.getByRole("button", { name: "Cues at once: less" }).click();
  await expect(page.locator("#cues")).toHaveText("1");
  await main.click();
  await expect(main).toHaveText("Pause");
  await expect(phase).toHaveText("Moving");
  await expect(page.locator("#repetition")).toHaveText("1");
  await expect(page.locator("#score")).toHaveText(/^\d+$/);
  await expect(page.locator(".score-bars button")).toHaveCount(1);
  await expect(page.locator(".body-map")).not.toHaveAttribute("data-on", "0");

  await page.locator(".score-bars button").first().click();
  await expect(page.getByRole("dialog")).toContainText("Left elbow");
  await page.getByRole("button", { name: "Close" }).click();

  await main.click();
  await expect(phase).toHaveText("Session paused");
  await expect(main).toHaveText("Go on");
  await expect.poll(() => bench.boardSlots()).toBe(0);
  await main.click();
  await expect(main).toHaveText("Pause");

  await page.locator("#end").click();
  await page.getByRole("dialog").getByRole("button", { name: "End session" }).click();
  await expect(phase).toHaveText("Session ended");
  await expect(main).toHaveText("Start");
  await expect.poll(() => bench.boardSlots()).toBe(0);
  expect(errors).toEqual([]);
});

test("a whole session by keyboard", async ({ page, bench, errors }) => {
  await bench.start("board");
  await bench.start("tactors");
  await bench.start("coach", "--wait");
  await bench.start("capture");
  await bench.start("dashboard");
  await bench.open(page);
  const phase = page.locator(".phase");
  await expect(page.locator("#main")).toBeEnabled();

  await page.keyboard.press("Shift+?");
  await expect(page.getByRole("dialog", { name: "Help" })).toBeVisible();
  await page.keyboard.press("Enter");
  await expect(page.getByRole("dialog")).toHaveCount(0);

  // Every control is reached by Tab, and what has the focus can be seen.
  const reached = new Set<string>();
  for (let i = 0; i < 40; i++) {
    await page.keyboard.press("Tab");
    reached.add(await page.evaluate(() => {
      const at = document.activeElement as HTMLElement;
      if (at === document.body) return "";
      const style = getComputedStyle(at);
      return `${at.id || at.textContent}:${style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 3}`;
    }));
  }
  for (const id of ["stop", "learner", "reference", "plan", "main"]) expect([...reached]).toContain(`${id}:true`);
  await page.evaluate(() => (document.activeElement as HTMLElement).blur());

  await page.keyboard.press("Space");
  await expect(phase).toHaveText("Moving");
  const canvas = page.locator("canvas");
  const azimuth = Number(await canvas.getAttribute("data-azimuth"));
  await page.keyboard.press("ArrowRight");
  await expect.poll(async () => Number(await canvas.getAttribute("data-azimuth"))).toBeGreaterThan(azimuth + 4);
  await canvas.focus();
  await page.keyboard.press("2");
  await expect(canvas).toHaveAttribute("data-azimuth", "90");
  await page.keyboard.press("3");
  await expect.poll(async () => Number(await canvas.getAttribute("data-elevation"))).toBeGreaterThan(85);
  await page.keyboard.press("Space");
  await expect(phase).toHaveText("Session paused");
  await page.keyboard.press("Space");
  await expect(page.locator("#main")).toHaveText("Pause");

  // Esc stops; lifting asks, and the safe answer has the focus.
  await page.keyboard.press("Escape");
  await expect(page.locator("#stop")).toHaveText("Vibration is OFF");
  await page.locator("#lift").focus();
  await page.keyboard.press("Enter");
  await expect(page.getByRole("button", { name: "No, keep it off" })).toBeFocused();
  await page.keyboard.press("Enter");
  await expect(page.getByRole("dialog")).toHaveCount(0);
  await expect(page.locator("#stop")).toHaveText("Vibration is OFF");
  await page.locator("#lift").focus();
  await page.keyboard.press("Enter");
  await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
  await expect(page.locator("#stop")).toHaveText("STOP vibration");

  await page.locator("#end").focus();
  await page.keyboard.press("Enter");
  await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
  await expect(phase).toHaveText("Session ended");
  expect(errors).toEqual([]);
});

test("a plan's blocks, its tempo and its schedule are shown", async ({ page, bench }) => {
  await bench.start("board");
  await bench.start("tactors");
  await bench.start("coach", "--plan", "slow_first");
  await bench.start("capture");
  await bench.start("dashboard");
  await bench.open(page);
  const now = page.locator(".blocks li[data-state=now]");
  await expect(page.locator(".blocks li")).not.toHaveCount(1);
  await expect(now).toContainText("Half tempo");
  await expect(now).toContainText("tempo 0.5 ×, always cued");
  await expect(page.locator("#plan")).toHaveValue("slow_first");
  await expect(page.locator(".seconds")).toContainText("of 7.4 s");
});
