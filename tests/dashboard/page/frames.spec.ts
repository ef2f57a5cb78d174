// How many frames a second the page draws of a pair of 22 joints on the software renderer, and what holds
// it up. Figures, no bound: they say something of the machine. Runs only when asked for:
//   SECONDSKIN_FRAMES=1 npx playwright test frames.spec.ts
import { expect, test } from "./bench";

test.skip(process.env.SECONDSKIN_FRAMES == undefined, "a measurement, not a test");

const SECONDS = 6;
const SETTLED = 10;  // until the page has found how finely to draw (model/resolution.ts) [s]

test("frames a second of a pair of 22 joints", async ({ page, bench }) => {
  bench.tolerance = "1";
  await bench.all();
  const client = await page.context().newCDPSession(page);
  await client.send("Performance.enable");
  const metric = async (name: string): Promise<number> =>
    (await client.send("Performance.getMetrics")).metrics.find((one) => one.name === name)!.value;
  const ratio = (): Promise<string> => page.evaluate(() => document.querySelector("canvas")?.dataset.ratio ?? "");
  const measure = async (label: string, forSeconds = SECONDS): Promise<void> => {
    const before = { task: await metric("TaskDuration"), script: await metric("ScriptDuration"), layout: await metric("LayoutDuration") + await metric("RecalcStyleDuration") };
    const { frames, draws } = await page.evaluate((seconds) => new Promise<{ frames: number; draws: number }>((done) => {
      const canvas = document.querySelector("canvas");
      const drawn = (): number => Number(canvas?.dataset.drawn ?? 0);
      const [start, first] = [performance.now(), drawn()];
      let frames = 0;
      const count = (): void => {
        frames++;
        if (performance.now() - start < seconds * 1000) requestAnimationFrame(count);
        else done({ frames, draws: drawn() - first });
      };
      requestAnimationFrame(count);
    }), forSeconds);
    const each = (after: number, was: number): string => ((1000 * (after - was)) / frames).toFixed(1);
    console.log(`${label.padEnd(44)} x${await ratio()} ${(frames / forSeconds).toFixed(1)} frames/s, ${(draws / forSeconds).toFixed(1)} drawings/s; a frame: task ${each(await metric("TaskDuration"), before.task)} ms, script ${each(await metric("ScriptDuration"), before.script)} ms, layout ${each(await metric("LayoutDuration") + await metric("RecalcStyleDuration"), before.layout)} ms`);
  };
  for (const [width, height] of [[1440, 900], [1024, 768], [390, 844]] as const) {
    await page.setViewportSize({ width, height });
    await bench.open(page);
    await expect(page.locator(".phase")).toHaveText("Moving");
    await measure(`session ${width}x${height}, at first`, 3);
    await page.waitForTimeout(SETTLED * 1000);
    await measure(`session ${width}x${height}`);
  }
  await page.setViewportSize({ width: 1440, height: 900 });
  await page.getByRole("button", { name: "Side by side" }).click();
  await page.waitForTimeout(SETTLED * 1000);
  await measure("session 1440x900, side by side (no blending)");
  await page.evaluate(() => { document.querySelector<HTMLElement>(".stage-canvas")!.style.display = "none"; });
  await measure("the same without the 3D view");
});
