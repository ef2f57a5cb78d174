// What was: learners, their sessions, progress over weeks, the report.
import { api, type Learner, type Progress, type SessionRow } from "../api";
import { ask, el, labelled, setText, table } from "../dom";
import { recordingHash, recordingOf } from "../model/session_recording";
import { jointText, readable, texts } from "../texts";
import { progressPlot, retentionPart, schedulePart } from "./progress";
import { sessionDetail } from "./session_detail";

const t = texts.history;
const AGAIN = 1000;  // until a recording is asked for again that was not read yet [ms]
const TRIES = 60;
const POLL = 200;  // [ms]

export function day(iso: string): string {
  return new Date(iso).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" });
}

export class HistoryView {
  readonly element = el("div", { class: "history" });
  available: boolean | null = null;
  private readonly learner = el("select", { id: "history-learner" });
  private readonly reference = el("select", { id: "history-reference" });
  private readonly measure = el("select", { id: "history-measure" });
  private readonly message = el("p", { class: "muted", role: "status" });
  private readonly person = el("div", {});
  private readonly progressRoom = el("div", {});
  private readonly sessionRoom = el("div", {});
  private learners: Learner[] = [];
  private progress: Progress | null = null;
  private personShown = "";
  private asked = 0;

  constructor() {
    this.element.append(
      el("section", { class: "card" },
        el("h2", {}, t.heading),
        el("div", { class: "row fields" }, labelled(t.learner, this.learner),
          el("button", { type: "button", id: "add-learner", onclick: () => void this.add() }, t.add)),
        this.message, this.person),
      el("section", { class: "card" },
        el("h2", {}, t.progress),
        el("div", { class: "row fields" }, labelled(t.reference, this.reference), labelled(t.measure, this.measure)),
        this.progressRoom),
      el("section", { class: "card" }, el("h2", {}, t.sessions), this.sessionRoom));
    this.learner.addEventListener("change", () => void this.showLearner());
    this.reference.addEventListener("change", () => void this.showProgress());
    this.measure.addEventListener("change", () => this.drawProgress());
  }

  /// Reads anew; what was chosen stays chosen.
  async load(): Promise<void> {
    if (this.available == null) return setText(this.message, t.loading);
    if (!this.available) return setText(this.message, t.off);
    await this.guard(async () => {
      this.learners = await api.learners();
      const before = this.learner.value;
      this.learner.replaceChildren(...this.learners.map(({ id, note }) => el("option", { value: id }, note ? `${id} · ${note}` : id)));
      if (this.learners.some(({ id }) => id === before)) this.learner.value = before;
      setText(this.message, this.learners.length === 0 ? t.none : "");
      await this.showLearner();
    });
  }

  private async guard(work: () => Promise<void>): Promise<void> {
    try {
      await work();
    } catch (error) {
      this.message.replaceChildren(t.failed((error as Error).message), " ",
        el("button", { type: "button", onclick: () => void this.load() }, t.again));
    }
  }

  private get chosen(): Learner | undefined { return this.learners.find(({ id }) => id === this.learner.value); }

  private async showLearner(): Promise<void> {
    const learner = this.chosen;
    if (learner == undefined) {
      this.personShown = "";
      for (const room of [this.person, this.progressRoom, this.sessionRoom]) room.replaceChildren();
      this.reference.replaceChildren();
      this.measure.replaceChildren();
      return;
    }
    // What is being typed stays, when nothing of the learner changed.
    const person = JSON.stringify([learner.id, learner.note]);
    if (person !== this.personShown) this.person.replaceChildren(this.personPart(learner));
    this.personShown = person;
    const mine = ++this.asked;
    await this.guard(async () => {
      const sessions = await api.sessions(learner.id);
      if (mine !== this.asked) return;
      sessions.sort((a, b) => b.start.localeCompare(a.start));
      const before = this.reference.value;
      const names = [...new Set(sessions.map(({ reference }) => reference))];
      this.reference.replaceChildren(...names.map((name) => el("option", { value: name }, readable(name))));
      if (names.includes(before)) this.reference.value = before;
      this.sessionRoom.replaceChildren(this.sessionPart(sessions));
      void this.offerRecordings(sessions);
      await this.showProgress();
    });
  }

  private personPart(learner: Learner): HTMLElement {
    const note = el("input", { type: "text", value: learner.note, maxlength: 200, "aria-describedby": "note-hint" });
    const save = el("button", { type: "button" }, t.save);
    save.addEventListener("click", () => void this.guard(async () => {
      await api.setNote(learner.id, note.value);
      for (const one of this.learners) if (one.id === learner.id) one.note = note.value;
      setText(this.message, t.saved);
    }));
    const link = (text: string, href: string, download: boolean): HTMLElement =>
      el("a", { class: "button", href, ...(download ? { download: true } : { target: "_blank", rel: "noopener" }) }, text);
    return el("div", {},
      el("div", { class: "row fields" }, labelled(t.note, note), save),
      el("p", { class: "muted", id: "note-hint" }, t.noteHint),
      el("div", { class: "row" },
        link(t.reportHtml, api.reportUrl(learner.id, "html"), false), link(t.reportPdf, api.reportUrl(learner.id, "pdf"), false),
        link(t.exportCsv, api.exportUrl(learner.id, "csv"), true), link(t.exportJson, api.exportUrl(learner.id, "json"), true),
        el("span", { class: "gap" }),
        el("button", { type: "button", class: "danger", id: "remove-learner", onclick: () => void this.remove(learner) }, t.remove)));
  }

  private async add(): Promise<void> {
    await this.guard(async () => {
      const { id } = await api.addLearner();
      this.learners = await api.learners();
      await this.load();
      this.learner.value = id;
      await this.showLearner();
    });
  }

  private async remove(learner: Learner): Promise<void> {
    const yes = await ask({
      title: t.removeTitle(learner.id), body: t.removeBody, yes: t.removeYes, no: texts.cancel, danger: true, typed: learner.id,
    });
    if (!yes) return;
    await this.guard(async () => {
      // First what the history leads to: if that fails, the learner is still there to try again.
      const { job } = await api.removeRecordings(learner.id);
      let removal = await api.removal(job);
      for (; removal.state === "waiting" || removal.state === "running"; removal = await api.removal(job)) {
        await new Promise((done) => setTimeout(done, POLL));
      }
      if (!removal.result) throw new Error(removal.error);
      const { removed, kept } = removal.result;
      await api.removeLearner(learner.id);
      await this.load();
      setText(this.message, t.removed(learner.id, removed.length, kept.map(({ name, why }) => `${name} (${why})`)));
    });
  }

  private async showProgress(): Promise<void> {
    const learner = this.chosen;
    if (learner == undefined || this.reference.value === "") return this.progressRoom.replaceChildren(el("p", { class: "muted" }, t.progressNone));
    const mine = this.asked;
    await this.guard(async () => {
      const progress = await api.progress(learner.id, this.reference.value);
      if (mine !== this.asked) return;
      this.progress = progress;
      const before = this.measure.value;
      const joints = [...new Set(progress.points.flatMap((point) => Object.keys(point.joints)))];
      this.measure.replaceChildren(el("option", { value: "" }, t.total),
        ...joints.map((joint) => el("option", { value: joint }, t.jointError(jointText(joint)))));
      if (joints.includes(before)) this.measure.value = before;
      this.drawProgress();
    });
  }

  private drawProgress(): void {
    const { progress } = this;
    if (progress == null || progress.points.length === 0) {
      this.progressRoom.replaceChildren(el("p", { class: "muted" }, t.progressNone));
      return;
    }
    this.progressRoom.replaceChildren(
      progressPlot(progress.points, this.measure.value), retentionPart(progress.retention) ?? "", schedulePart(progress.schedules) ?? "");
  }

  private sessionPart(sessions: SessionRow[]): HTMLElement {
    if (sessions.length === 0) return el("p", { class: "muted" }, t.sessionsNone);
    const s = t.sessionTable;
    return table(t.sessions, [s.start, s.reference, s.open, s.plan, s.repetitions, s.mean, s.cues],
      sessions.map((session) => [
        day(session.start), readable(session.reference),
        // On a phone only the first columns are in sight.
        el("span", { class: "row" },
          el("button", { type: "button", "aria-label": t.details(day(session.start)),
            onclick: () => void this.guard(async () => sessionDetail(await api.session(session.id))) }, t.open),
          el("span", { class: "muted", "data-recording": session.id }, t.looking)),
        session.plan ? readable(session.plan) : t.practice,
        String(session.repetitions), session.mean_total == null ? "–" : session.mean_total.toFixed(0), String(session.cues),
      ]), [4, 5, 6]);
  }

  // After the sessions: a folder of many recordings takes its time.
  private async offerRecordings(sessions: SessionRow[], tries = TRIES): Promise<void> {
    const mine = this.asked;
    const offered = await api.recordings().catch((error: Error) => error);
    if (mine !== this.asked) return;
    // The bridge reads one that is not finished beside the requests: until then it may be anybody's.
    const unread = !(offered instanceof Error) && offered.some(({ state, start }) => state !== "damaged" && start == undefined);
    for (const session of sessions) {
      const place = this.sessionRoom.querySelector(`[data-recording="${session.id}"]`);
      const found = offered instanceof Error ? null : recordingOf(session, offered);
      if (found == null && unread && tries > 0) continue;
      place?.replaceChildren(found == null
        ? el("span", { title: offered instanceof Error ? offered.message : t.noRecordingWhy }, offered instanceof Error ? t.recordingsFailed : t.noRecording)
        : el("a", { class: "button", href: recordingHash(found.name, found.at), "aria-label": t.playOf(day(session.start)) }, t.play));
    }
    if (unread && tries > 0) setTimeout(() => { if (mine === this.asked) void this.offerRecordings(sessions, tries - 1); }, AGAIN);
  }
}
