import { expect, test } from "./bench";

test("learners, their sessions, progress, report, export and deletion", async ({ page, bench, errors }) => {
  test.setTimeout(240_000);
  bench.tolerance = "0.5";
  await bench.start("board");
  await bench.start("tactors");
  await bench.start("coach", "--wait");
  await bench.start("capture");
  await bench.start("dashboard");
  const info = await (await page.request.get(`${bench.url}api/info`)).json() as { history: boolean };
  await bench.open(page, "history");
  if (!info.history) {
    await expect(page.getByText("This bridge keeps no history.")).toBeVisible();
    test.skip(true, "this program keeps no history");
  }
  await expect(page.getByText("No learners yet.")).toBeVisible();
  await page.locator("#add-learner").click();
  await expect(page.locator("#history-learner option")).toHaveCount(1);
  const id = await page.locator("#history-learner").inputValue();
  expect(id).not.toBe("");
  await page.getByLabel("Note").fill("left knee");
  await page.getByRole("button", { name: "Save note" }).click();
  await expect(page.getByText("Saved")).toBeVisible();

  // A session of this learner's.
  await bench.open(page);
  await page.reload();
  await expect(page.locator(`#learner option[value="${id}"]`)).toHaveText(`${id} · left knee`);
  await page.locator("#learner").selectOption(id);
  await page.locator("#main").click();
  await expect(page.locator(".who")).toHaveText(`Learner: ${id}`);
  await expect(page.locator(".score-bars button")).toHaveCount(2);
  const score = await page.locator(".score-bars button").first().innerText();
  await page.locator("#end").click();
  await page.getByRole("dialog").getByRole("button", { name: "End session" }).click();
  await expect(page.locator(".phase")).toHaveText("Session ended");

  await bench.open(page, "history");
  await expect(async () => {
    await page.reload();
    await expect(page.getByRole("button", { name: /Session of/ })).toHaveCount(1, { timeout: 5000 });
  }).toPass();
  await expect(page.locator("#history-learner")).toHaveValue(id);
  await expect(page.locator("#history-reference")).toHaveValue("low_block");
  await expect(page.getByRole("img", { name: "Progress" })).toBeVisible();
  await page.getByRole("button", { name: /Session of/ }).click();
  await expect(page.getByRole("dialog").locator("tbody tr").first()).toContainText(score);
  await page.getByRole("button", { name: "Close" }).click();

  for (const [name, type] of [["Report to print", "text/html"], ["Report as PDF", "application/pdf"], ["Data as CSV", "text/csv"], ["Data as JSON", "application/json"]] as const) {
    const href = await page.getByRole("link", { name }).getAttribute("href");
    const answer = await page.request.get(bench.url + href);
    expect(answer.status(), name).toBe(200);
    expect(answer.headers()["content-type"], name).toContain(type);
    expect((await answer.body()).length, name).toBeGreaterThan(200);
  }

  await page.locator("#remove-learner").click();
  const yes = page.getByRole("button", { name: "Delete everything" });
  await expect(yes).toBeDisabled();
  await page.getByRole("dialog").getByRole("textbox").fill(id);
  await yes.click();
  await expect(page.getByText(`${id} was deleted, with 0 recordings.`)).toBeVisible();
  expect(await (await page.request.get(`${bench.url}api/history/learners`)).json()).toEqual([]);
  expect(errors).toEqual([]);
});
