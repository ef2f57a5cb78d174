// The page: header with STOP, four views, keys, one animation frame for all.
import "./style.css";
import { api } from "./api";
import { Connection } from "./connection";
import { el, say, setData, setText } from "./dom";
import { Live } from "./live";
import { texts } from "./texts";
import { Controls } from "./view/controls";
import { showHelp, shortcuts } from "./view/help";
import { HistoryView } from "./view/history";
import { RecordView } from "./view/record";
import { RecordingsView } from "./view/recordings";
import { SessionView } from "./view/session";
import { SignalsView } from "./view/signals";
import { StopBar } from "./view/stop_bar";

const NAMES = ["session", "record", "recordings", "history", "signals"] as const;
type Name = (typeof NAMES)[number];

const url = new URL("live", location.href);
url.protocol = url.protocol.replace("http", "ws");
url.hash = url.search = "";

const live = new Live();
const connection = new Connection(live, url.href);
const stop = new StopBar(live, connection);
const session = new SessionView(live, new Controls(live, connection), stop);
const recordings = new RecordingsView();
const history = new HistoryView();
const signals = new SignalsView(live);
const record = new RecordView(live, connection, () => void listOwn());
const views = { session, record, recordings, history, signals };

const link = el("span", { class: "link", id: "connection", role: "status" });
const banner = el("div", { class: "lost", role: "alert", hidden: true });
const message = el("p", { class: "message", role: "alert", hidden: true });
const tabs = Object.fromEntries(NAMES.map((name) =>
  [name, el("a", { href: `#${name}` }, texts.views[name])])) as Record<Name, HTMLAnchorElement>;
const help = el("button", { type: "button", class: "help-button", "aria-label": texts.help, "aria-keyshortcuts": "?", onclick: () => showHelp() }, "?");
const main = el("main", { id: "main-view", tabindex: -1 });

document.body.append(
  el("a", { class: "skip", href: "#main-view", onclick: (event: Event) => { event.preventDefault(); main.focus(); } }, texts.skip),
  el("header", { class: "top" },
    el("span", { class: "brand" }, texts.title),
    el("nav", { "aria-label": texts.nav }, ...NAMES.map((name) => tabs[name])),
    link, help, stop.element),
  banner, message, main,
  el("div", { id: "announce", class: "visually-hidden", "aria-live": "polite" }),
  el("div", { id: "announce-now", class: "visually-hidden", "aria-live": "assertive" }));

let shown: Name = "session";
function show(): void {
  const wanted = location.hash.slice(1).split("/")[0] as Name;
  shown = NAMES.includes(wanted) ? wanted : "session";
  document.title = `${texts.views[shown]} – ${texts.title}`;
  main.replaceChildren(el("h1", { class: "visually-hidden" }, texts.views[shown]), views[shown].element);
  setData(document.body, "view", shown);
  for (const name of NAMES) {
    if (name === shown) tabs[name].setAttribute("aria-current", "page");
    else tabs[name].removeAttribute("aria-current");
  }
  if (shown === "history") void history.load();
  if (shown === "recordings") void recordings.show();
}
window.addEventListener("hashchange", show);
show();

function tell(text: string): void {
  message.hidden = text === "";
  setText(message, text);
}

async function listOwn(): Promise<void> {
  const known = await api.references().catch(() => []);
  session.controls.setOwnReferences(known.filter(({ own }) => own).map(({ name }) => name));
}

// The page's version as the bridge had it when the page was loaded.
let ours: string | undefined;

async function meetBridge(): Promise<void> {
  try {
    const info = await api.info();
    history.available = info.history;
    ours ??= info.page_version;
    tell(info.page_version === ours ? "" : texts.connection.newer);
    const plans = await api.plans().catch(() => []);
    session.setPlans(plans);
    session.controls.setPlans(plans);
    await session.controls.loadLearners(info.history);
    await listOwn();
    if (shown === "history") void history.load();
  } catch {
    // An older bridge, or only Foxglove's protocol: the live data is all there is.
  }
}

connection.onChange = () => {
  if (live.connected) void meetBridge();
  else if (live.everConnected) say(texts.connection.lostTitle, true);
};
connection.onRefused = (why) => {
  tell(texts.connection.refused(why));
  session.controls.refused(why);
};

// A button that was clicked gives the focus back, so that Space is free again.
document.addEventListener("click", (event) => {
  const button = (event.target as Element).closest("button");
  if (button && event.detail > 0 && !button.closest("dialog")) button.blur();
});

document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") return stop.press();
  if (!shortcuts.on || event.ctrlKey || event.altKey || event.metaKey) return;
  const target = event.target as HTMLElement;
  if (document.querySelector("dialog[open]") || target.closest("input, textarea, select")) return;
  if (event.key === "?") {
    event.preventDefault();
    return showHelp();
  }
  if (shown === "record" && !target.closest("button, summary, [role=region]") && record.key(event.key)) return event.preventDefault();
  if (shown === "recordings" && recordings.key(event.key, target)) return event.preventDefault();
  if (shown !== "session" || target.closest("button, summary, [role=region]")) return;
  const preset = session.stage?.canvas === target ? ({ 1: "front", 2: "side", 3: "top" } as const)[event.key] : undefined;
  if (event.key === " ") session.controls.toggle();
  else if (preset) session.stage?.view(preset);
  else if (!session.stage?.key(event.key)) return;
  event.preventDefault();
}, { capture: true });

function showConnection(): void {
  const state = live.connected ? "connected" : live.everConnected ? "lost" : "connecting";
  setData(document.body, "link", state);
  setText(link, texts.connection[state]);
  if (banner.hidden === (state !== "lost")) return;
  banner.hidden = state !== "lost";
  banner.replaceChildren(...(banner.hidden ? [] : [
    el("strong", {}, texts.connection.lostTitle), el("p", {}, texts.connection.lostBody), el("p", {}, texts.connection.lostSafety)]));
}

function frame(): void {
  live.frame();
  showConnection();
  stop.frame();
  if (shown === "session") session.frame();
  record.frame(shown === "record");
  if (shown === "recordings") recordings.frame();
  signals.frame(shown === "signals");
  requestAnimationFrame(frame);
}
requestAnimationFrame(frame);
