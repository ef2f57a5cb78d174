// Elements without ceremony.

type Child = Node | string | null | undefined | false;
type Attributes = Record<string, string | number | boolean | undefined | ((event: never) => void)>;

function fill<E extends Element>(element: E, attributes: Attributes, children: Child[]): E {
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") {
      element.addEventListener(name.replace(/^on/, ""), value as unknown as EventListener);
    } else if (value === true) {
      element.setAttribute(name, "");
    } else if (value !== false && value !== undefined) {
      element.setAttribute(name, String(value));
    }
  }
  for (const child of children) if (child) element.append(child);
  return element;
}

export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K, attributes: Attributes = {}, ...children: Child[]
): HTMLElementTagNameMap[K] {
  return fill(document.createElement(tag), attributes, children);
}

export function svg<K extends keyof SVGElementTagNameMap>(
  tag: K, attributes: Attributes = {}, ...children: Child[]
): SVGElementTagNameMap[K] {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

/// Writes only what changed: the layout is left alone.
export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

export function setData(element: HTMLElement | SVGElement, name: string, value: string): void {
  if (element.dataset[name] !== value) element.dataset[name] = value;
}

export function labelled(label: string, control: HTMLElement, extra?: HTMLElement): HTMLLabelElement {
  return el("label", { class: "field" }, el("span", { class: "field-name" }, label), control, extra);
}

/// A table whose cells are texts or nodes; the first column names the row.
export function table(caption: string, head: string[], rows: (string | Node)[][], numeric: number[] = []): HTMLElement {
  const numbers = new Set(numeric);
  const kind = (i: number): string => (numbers.has(i) ? "number" : "");
  return el("div", { class: "table-scroll", tabindex: 0, role: "region", "aria-label": caption },
    el("table", {},
      el("caption", { class: "visually-hidden" }, caption),
      el("thead", {}, el("tr", {}, ...head.map((text, i) => el("th", { scope: "col", class: kind(i) }, text)))),
      el("tbody", {}, ...rows.map((row) => el("tr", {}, ...row.map((cell, i) =>
        i === 0 ? el("th", { scope: "row" }, cell) : el("td", { class: kind(i) }, cell)))))));
}

/// Opens a dialog over the view. Only the view behind it rests: STOP stays in reach. Closing removes it;
/// Esc closes, and stops (main.ts).
export function openDialog(dialog: HTMLDialogElement): void {
  const main = document.querySelector("main");
  const before = document.activeElement as HTMLElement | null;
  if (main) main.inert = true;
  dialog.addEventListener("keydown", (event) => { if (event.key === "Escape") dialog.close(); });
  dialog.addEventListener("close", () => {
    dialog.remove();
    if (main) main.inert = document.querySelector("dialog[open]") != null;
    before?.focus();
  });
  document.body.append(dialog);
  dialog.show();
}

/// Asks, in the middle of the page. `safe` has the focus and is what closing means.
export function ask(options: {
  title: string; body: string; yes: string; no: string; danger?: boolean; typed?: string;
}): Promise<boolean> {
  return new Promise((resolve) => {
    const typed = options.typed == undefined ? null : el("input", { type: "text", autocomplete: "off", "aria-label": options.body });
    const yes = el("button", { type: "submit", value: "yes", class: options.danger ? "danger big" : "primary big" }, options.yes);
    const no = el("button", { type: "submit", value: "no", class: "big", formnovalidate: true, autofocus: typed == null }, options.no);
    const title = el("h2", { id: "ask-title" }, options.title);
    const dialog = el("dialog", { "aria-labelledby": "ask-title" },
      el("form", { method: "dialog" }, title, el("p", {}, options.body), typed, el("div", { class: "row" }, no, yes)));
    if (typed) {
      yes.disabled = true;
      typed.addEventListener("input", () => { yes.disabled = typed.value.trim() !== options.typed; });
    }
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"));
    openDialog(dialog);
  });
}

export function say(text: string, urgent = false): void {
  const region = document.getElementById(urgent ? "announce-now" : "announce");
  if (region) region.textContent = text;
}
