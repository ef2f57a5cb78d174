import { readFileSync, readdirSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { expect, test } from "vitest";
import { FIGURE, LIMBS, placesOf, sideOf } from "../src/model/places";

const quarter = Math.PI / 2;
const at = (segment: string, angle: number): ReturnType<typeof placesOf> => placesOf({ channel: 0, segment, along: 0.9, angle });

test("the front is seen from the front, the back from the back, sides from both", () => {
  expect(at("left_elbow", 0).map(({ side }) => side)).toEqual(["front"]);
  expect(at("left_elbow", 2 * quarter).map(({ side }) => side)).toEqual(["back"]);
  expect(at("left_elbow", quarter).map(({ side }) => side)).toEqual(["front", "back"]);
});

test("a person who faces us has the left on our right", () => {
  expect(at("left_elbow", 0)[0]!.x).toBeGreaterThan(FIGURE.width / 2);
  expect(at("spine_upper", quarter)[0]!.x).toBeGreaterThan(FIGURE.width / 2);
  expect(at("spine_upper", quarter)[1]!.x).toBeLessThan(FIGURE.width / 2);
  expect(at("right_hip", 0)[0]!.x).toBeLessThan(FIGURE.width / 2);
});

test("the two sides mirror each other", () => {
  const [left] = at("left_hip", quarter);
  const [right] = at("right_hip", 3 * quarter);
  expect(left!.x + right!.x).toBeCloseTo(FIGURE.width);
  expect(left!.y).toBeCloseTo(right!.y);
});

test("every tactor of every body map that ships has a place, apart from the others", () => {
  const folder = fileURLToPath(new URL("../../../../body_maps/", import.meta.url));
  const maps = readdirSync(folder).filter((name) => name.endsWith(".toml"));
  expect(maps.length).toBeGreaterThan(0);
  for (const name of maps) {
    const text = readFileSync(folder + name, "utf8");
    const sites = [...text.matchAll(/channel =\s*(\d+), segment = "(\w+)", along = ([\d.]+), angle_deg =\s*([\d.]+)/g)]
      .map(([, channel, segment, along, angle]) =>
        ({ channel: Number(channel), segment: segment!, along: Number(along), angle: (Number(angle) * Math.PI) / 180 }));
    expect(sites.length, name).toBeGreaterThan(0);
    const places = sites.flatMap((site) => placesOf(site).map((place) => ({ ...place, channel: site.channel })));
    for (const site of sites) expect(LIMBS.has(site.segment), `${name}: ${site.segment}`).toBe(true);
    places.forEach((a, i) => places.slice(i + 1).forEach((b) => {
      if (a.side === b.side) expect(Math.hypot(a.x - b.x, a.y - b.y), `${name}: ${a.channel} and ${b.channel}`).toBeGreaterThan(10);
    }));
  }
});

test("sides are named by eighths", () => {
  expect([0, quarter / 2, quarter, 2 * quarter, 3 * quarter, 4 * quarter, -quarter].map(sideOf))
    .toEqual(["front", "front-left", "left", "back", "right", "front", "right"]);
});
