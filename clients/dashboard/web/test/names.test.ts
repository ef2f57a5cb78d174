import { expect, test } from "vitest";
import { plainName } from "../src/model/names";

test("what people type becomes a name that a session command may carry", () => {
  expect(plainName("Anna's squat")).toBe("anna_s_squat");
  expect(plainName("  Übung Nr. 3 ")).toBe("ubung_nr_3");
  expect(plainName("low_block-2")).toBe("low_block-2");
  expect(plainName("../../etc/passwd")).toBe("etc_passwd");
  expect(plainName("_-hidden_")).toBe("hidden");
  expect(plainName("!?")).toBe("");
  expect(plainName("x".repeat(100))).toHaveLength(64);
});
