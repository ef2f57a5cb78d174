import { defineConfig } from "vitest/config";

// `npm run dev` serves the sources; BRIDGE says where the data comes from.
const bridge = process.env.BRIDGE ?? "http://127.0.0.1:8765";

export default defineConfig({
  base: "./",
  build: { target: "es2022", chunkSizeWarningLimit: 1200, assetsInlineLimit: 0 },
  server: {
    host: "127.0.0.1",
    proxy: { "/api": bridge, "/live": { target: bridge, ws: true } },
  },
  test: { include: ["test/**/*.test.ts"] },
});
