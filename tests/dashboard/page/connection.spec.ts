import { expect, test } from "./bench";

test("a reload in mid-session finds the session as it is", async ({ page, bench, errors }) => {
  await bench.all();
  await bench.open(page);
  await expect(page.locator(".score-bars button")).toHaveCount(2);
  await page.locator("#main").click();
  await expect(page.locator(".phase")).toHaveText("Session paused");
  const before = {
    bars: await page.locator(".score-bars").innerText(), score: await page.locator("#score").innerText(),
    repetition: await page.locator("#repetition").innerText(), exercise: await page.locator("#reference").inputValue(),
  };
  await page.reload();
  await expect(page.locator(".phase")).toHaveText("Session paused");
  await expect(page.locator("#main")).toHaveText("Go on");
  await expect(page.locator("#score")).toHaveText(before.score);
  await expect(page.locator("#repetition")).toHaveText(before.repetition);
  expect(await page.locator(".score-bars").innerText()).toBe(before.bars);
  await expect(page.locator("#reference")).toHaveValue(before.exercise);
  expect(errors).toEqual([]);
});

test("a killed bridge is said largely, and the page comes back by itself", async ({ page, bench, errors }) => {
  await bench.all();
  await bench.open(page);
  await expect(page.locator(".session")).toHaveAttribute("data-live", "true");
  await bench.end("dashboard", "SIGKILL");
  await expect(page.getByRole("alert").filter({ hasText: "No connection to the session" })).toBeVisible();
  await expect(page.locator("#stop")).toHaveText("STOP (not connected)");
  await expect(page.locator(".session")).toHaveAttribute("data-live", "false");
  await expect(page.locator(".tactors-now")).toHaveText("Not known");
  await expect(page.locator("#main")).toBeDisabled();

  // A press in the meantime is not lost, and is not said to have worked.
  await page.keyboard.press("Escape");
  await expect(page.locator("#stop")).toContainText("NOT CONFIRMED");
  await bench.start("dashboard");
  await expect(page.locator("body")).toHaveAttribute("data-link", "connected");
  await expect(page.locator("#stop")).toHaveText("Vibration is OFF");
  await expect.poll(() => bench.boardSlots()).toBe(0);
  await expect(page.locator(".session")).toHaveAttribute("data-live", "true");
  await expect(page.getByText("No connection to the session")).toHaveCount(0);
  expect(errors).toEqual([]);
});

test("a silent capture is not shown as if it were live", async ({ page, bench }) => {
  await bench.all();
  await bench.open(page);
  await expect(page.locator(".session")).toHaveAttribute("data-live", "true");
  await bench.end("capture", "SIGKILL");
  await expect(page.locator(".session")).toHaveAttribute("data-live", "false");
  await expect(page.locator(".notice")).toContainText("No movement data");
  await bench.start("capture");
  await expect(page.locator(".session")).toHaveAttribute("data-live", "true");
  await expect(page.locator(".notice")).toBeHidden();
});
