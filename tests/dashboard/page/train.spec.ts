// First use: one command, and from then on the page only. The command runs at a terminal, as a person's does.
import { spawn } from "node:child_process";
import { readdirSync, readFileSync } from "node:fs";
import { createServer, type AddressInfo } from "node:net";
import { join } from "node:path";
import { expect, program, test } from "./bench";

async function freePort(): Promise<number> {
  const server = createServer();
  await new Promise<void>((done) => server.listen(0, "127.0.0.1", done));
  const { port } = server.address() as AddressInfo;
  await new Promise((done) => server.close(done));
  return port;
}

/// What runs in a terminal, by its session's id: the command and all that it started.
function inTerminal(session: number): string[] {
  return readdirSync("/proc").filter((entry) => /^\d+$/.test(entry)).flatMap((pid) => {
    try {
      const stat = readFileSync(`/proc/${pid}/stat`, "utf8");
      return Number(stat.slice(stat.lastIndexOf(")") + 2).split(" ")[3]) === session ? [stat] : [];
    } catch {
      return [];  // it just ended
    }
  });
}

const quoted = (words: string[]): string => words.map((word) => `'${word.replaceAll("'", "'\\''")}'`).join(" ");

test("from one command to a session with a reference recorded on the page", async ({ page, bench, errors }) => {
  const train = [program, "train", "--speed", "2", "--dashboard-port", String(await freePort()), ...bench.bus];
  const terminal = spawn("script", ["-qfec", `echo "terminal $$"; exec ${quoted(train)}`, "/dev/null"], {
    stdio: ["pipe", "pipe", "inherit"], cwd: bench.folder, env: { ...process.env, XDG_DATA_HOME: bench.folder, SHELL: "/bin/sh" },
  });
  let shown = "";
  terminal.stdout.on("data", (text: Buffer) => { shown += text.toString(); });
  const ended = new Promise<number | null>((done) => terminal.once("exit", done));
  const pid = async (): Promise<number> => {
    await expect.poll(() => shown).toMatch(/terminal \d+/);
    return Number(/terminal (\d+)/.exec(shown)![1]);
  };
  try {
    await expect.poll(() => shown).toMatch(/Dashboard: http\S+/);
    const address = /Dashboard: (http\S+)/.exec(shown)![1]!;
    await page.goto(address);

    // A session of a new learner's: the body moves, a repetition is scored.
    await expect(page.locator(".session")).toHaveAttribute("data-live", "true");
    await page.locator("#learner").selectOption({ label: "New learner …" });
    await expect(page.locator("#learner")).toHaveValue(/^L-/);
    const learner = await page.locator("#learner").inputValue();
    await page.getByRole("button", { name: "Start anew" }).click();
    await expect(page.locator(".who")).toHaveText(`Learner: ${learner}`);
    await expect(page.locator(".phase")).toHaveText("Moving");
    const drawn = async (): Promise<number> => Number(await page.locator("canvas").first().getAttribute("data-drawn"));
    const before = await drawn();
    await expect.poll(drawn).toBeGreaterThan(before);
    await expect(page.locator(".score-bars button")).toHaveCount(1);
    const score = await page.locator("#score").innerText();
    expect(Number(score)).toBeGreaterThan(0);

    // A reference of the running source.
    await page.getByRole("link", { name: "New reference" }).click();
    await expect(page.locator(".record-source")).toContainText("Measured: learner.bvh");
    await page.locator("#record-countdown").selectOption("3");
    await page.locator("#record-main").click();
    await expect(page.locator(".record-overlay")).toHaveAttribute("data-phase", "recording");
    await expect(page.locator(".record-overlay strong")).toHaveText(/^([5-9]|\d\d) s$/);
    await page.locator("#record-main").click();
    await expect(page.locator(".take")).toHaveCount(1);
    await expect(page.locator(".take")).toContainText(/[1-9] repetitions? found/);
    for (const step of ["2 Choose", "3 Joints", "4 Save"]) {
      await page.locator("#record-next").click();
      await expect(page.locator(".record-steps [aria-current=step]")).toHaveText(step);
      await expect(page.locator(".average")).toBeVisible();
    }
    await page.locator("#reference-name").fill("My squat");
    await page.locator("#save-reference").click();
    await expect(page.locator(".saved")).toContainText("My squat");

    // Trained at once: it is another session of the same learner's.
    await page.locator("#train-now").click();
    await expect(page.locator("#reference")).toHaveValue("my_squat");
    await expect(page.locator(".exercise")).toHaveText("My squat");
    await expect(page.locator(".score-bars button").first()).toBeVisible();
    await page.locator("#end").click();
    await page.getByRole("dialog").getByRole("button", { name: "End session" }).click();
    await expect(page.locator(".phase")).toHaveText("Session ended");
    await expect(page.locator(".body-map")).toHaveAttribute("data-on", "0");

    await page.getByRole("link", { name: "History" }).click();
    await page.locator("#history-learner").selectOption(learner);
    const sessions = page.getByRole("row").filter({ has: page.getByRole("button", { name: /Session of/ }) });
    await expect(sessions).toHaveCount(2);
    for (const [i, name] of ["My squat", "Deep squat"].entries()) {
      await expect(sessions.nth(i)).toContainText(name);
      await expect(sessions.nth(i).locator("td").nth(3)).toHaveText(/^[1-9]\d*$/);
    }
    await sessions.nth(1).getByRole("button", { name: /Session of/ }).click();
    await expect(page.getByRole("dialog").locator("tbody tr").first()).toContainText(score);
    await page.getByRole("button", { name: "Close" }).click();

    // Its recording, which is still being made, is played from there on.
    await sessions.nth(1).getByRole("link", { name: /^Play the recording of/ }).press("Enter");
    await expect(page.locator(".player h2").first()).toHaveText(/_deep_squat\.mcap$/);
    await expect(page.locator(".player .exercise").first()).toHaveText("Deep squat");
    await expect(page.locator("#ghost-note")).toHaveText("");
    await expect(page.locator(".player .who").first()).toHaveText(`Learner: ${learner}`);
    expect(errors).toEqual([]);
  } finally {
    process.kill(await pid(), "SIGTERM");
    const code = await ended;
    expect(code).toBe(0);
  }
  // It says what was kept, and leaves nobody behind who could drive a tactor.
  expect(shown).toMatch(/Recording: \S+\.mcap \(\d+ messages\)/);
  expect(readdirSync(join(bench.folder, "recordings")).filter((name) => name.endsWith(".mcap"))).toHaveLength(1);
  expect(inTerminal(await pid())).toEqual([]);
});
