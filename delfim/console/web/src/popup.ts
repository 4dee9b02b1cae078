// Pop-up menus and forms: one pointing button, or arrows, Enter and Esc. Numbers and the name of a mission can be typed.
import { make, text } from "./dom";
import { FormView } from "./form";
import type { Field, Open, Said } from "./form";

const MARGIN_PX = 8;
const NAME_MOST = 60;
const WORDS_MOST = 100;
const MEANT_MS = 300; // a click that comes sooner hits a menu that nobody can have read

export interface Item {
  title: string;
  key?: string; // the key that does the same
  note?: string;
  colour?: string;
  tick?: boolean;
  refuse?: string | false | undefined; // why it cannot be chosen now
  do?: () => void;
  sub?: () => Entry[];
}
export type Entry = Item | "line";

export class Popup {
  private open: Open | null = null;
  private at: [number, number] = [0, 0];
  private readonly box = make("div.popup");
  private shownAt = 0;
  opened = () => {}; // called each time that a menu or form is shown
  closed = () => {};
  private meant = false; // the pointer came down after the menu was shown

  constructor(
    parent: HTMLElement,
    private readonly stop: HTMLElement,
  ) {
    this.box.setAttribute("role", "dialog");
    this.box.hidden = true;
    parent.append(this.box);
    this.box.addEventListener("contextmenu", (event) => event.preventDefault());
    // The keyboard of a touch screen also resizes the window.
    window.addEventListener("resize", () => (this.open && document.activeElement instanceof HTMLInputElement ? this.place() : this.close()));
    this.box.addEventListener("pointerdown", () => (this.meant = performance.now() - this.shownAt > MEANT_MS), { capture: true });
    // A finger that opened the menu by a long press is lifted over it: that is no click. Clicks without a pointer have no detail.
    this.box.addEventListener("click", (event) => event.detail && !this.meant && event.stopPropagation(), { capture: true });
  }

  get isOpen(): boolean {
    return this.open !== null;
  }

  /** What the open menu or form covers of the window. */
  get covers(): DOMRect {
    return this.box.getBoundingClientRect();
  }

  close(): void {
    if (!this.open) return;
    const open = this.open;
    this.open = null;
    this.box.hidden = true;
    this.box.replaceChildren();
    if (open instanceof FormView) open.cancelled();
    this.closed();
  }

  /** True when an open menu or form has taken the key. */
  takes(key: string): boolean {
    const open = this.open;
    if (!open) return false;
    if (key === "ArrowDown" || key === "Tab") open.move(1);
    else if (key === "ArrowUp" || key === "Shift Tab") open.move(-1);
    else if (key === "ArrowRight" || key === "ArrowLeft") open.change(key === "ArrowRight" ? 1 : -1);
    else if (key === "Enter") open.enter();
    else if (key === "Escape") open.back();
    else return open instanceof FormView && /^[\d.,]$/.test(key); // a number that misses its field is no speed
    return true;
  }

  menu(at: [number, number], heading: { title: string; colour?: string; note?: string }, entries: Entry[]): void {
    this.close();
    this.at = at;
    this.show(heading, entries, []);
  }

  /** Returns what asks `live` again, when what it says has changed. */
  form(at: [number, number], title: string, fields: Field[], live: (values: number[]) => Said, done: (ok: boolean) => void): () => void {
    this.close();
    const view = new FormView(this.box, title, fields, live, (ok) => {
      this.open = null;
      this.box.hidden = true;
      this.box.replaceChildren();
      done(ok);
    });
    this.open = view;
    this.at = at;
    this.place();
    return () => {
      if (this.open !== view) return;
      view.say();
      this.fit(); // its words may be longer now
    };
  }

  /** Ask for a name; `note` comments on the name typed so far. */
  name(title: string, value: string, note: (name: string) => string, done: (name: string) => void): void {
    this.close();
    this.open = new NameView(this.box, title, value, note, (name) => {
      this.close();
      if (name) done(name);
    });
    this.place();
  }

  /** Ask for words. */
  words(title: string, note: string, done: (words: string) => void): void {
    this.close();
    this.open = new NameView(this.box, title, "", () => note, (words) => {
      this.close();
      if (words.trim()) done(words.trim());
    }, WORDS_MOST);
    this.place();
  }

  private show(heading: { title: string; colour?: string; note?: string }, entries: Entry[], path: Entry[][]): void {
    const view = new MenuView(this.box, heading, entries, path.length > 0, {
      chosen: (item) => {
        if (item.sub) return this.show({ ...heading, note: item.title }, item.sub(), [...path, entries]);
        this.close();
        return item.do?.();
      },
      back: () => (path.length ? this.show({ ...heading, note: "" }, path.at(-1)!, path.slice(0, -1)) : this.close()),
    });
    this.open = view;
    this.place();
  }

  /** Beside the pointer, within the window, and never on the stop corner. */
  private place(): void {
    this.box.hidden = false;
    this.box.setAttribute("aria-label", this.box.querySelector("header b")?.textContent || "menu");
    this.opened();
    [this.shownAt, this.meant] = [performance.now(), false];
    this.fit();
  }

  private fit(): void {
    this.box.style.maxHeight = "";
    [this.box.style.left, this.box.style.top] = ["0px", "0px"]; // at the edge it would be narrower
    const { width, height } = this.box.getBoundingClientRect();
    const stop = this.stop.getBoundingClientRect();
    const clamp = (wanted: number, size: number, room: number) => Math.max(MARGIN_PX, Math.min(wanted, room - size - MARGIN_PX));
    let [left, top] = [clamp(this.at[0] + 6, width, innerWidth), clamp(this.at[1] + 6, height, innerHeight)];
    if (stop.width && left + width + MARGIN_PX > stop.left && top + height + MARGIN_PX > stop.top) {
      if (width + 2 * MARGIN_PX <= stop.left) left = clamp(left, width, stop.left);
      else {
        top = clamp(top, height, stop.top);
        if (height > stop.top - 2 * MARGIN_PX) this.box.style.maxHeight = `${stop.top - 2 * MARGIN_PX}px`;
      }
    }
    this.box.style.left = `${left}px`;
    this.box.style.top = `${top}px`;
  }
}

class MenuView implements Open {
  private readonly rows: { item: Item; row: HTMLElement }[] = [];
  private focus = -1;

  constructor(
    box: HTMLElement,
    heading: { title: string; colour?: string; note?: string },
    entries: Entry[],
    nested: boolean,
    private readonly tell: { chosen: (item: Item) => void; back: () => void },
  ) {
    const head = make("header", dot(heading.colour), make("b", heading.title), make("span", heading.note ?? ""));
    if (nested) {
      head.prepend(make("span.back", "‹"));
      head.classList.add("pressable");
      head.addEventListener("click", () => tell.back());
    }
    const rows = make("div", ...entries.map((entry) => (entry === "line" ? make("hr") : this.row(entry))));
    rows.setAttribute("role", "menu");
    box.replaceChildren(head, rows);
  }

  move(by: number): void {
    if (!this.rows.length) return;
    this.focus = this.focus < 0 && by < 0 ? this.rows.length - 1 : (this.focus + by + this.rows.length) % this.rows.length;
    this.rows.forEach(({ row }, i) => row.classList.toggle("focus", i === this.focus));
    this.rows[this.focus]!.row.scrollIntoView({ block: "nearest" });
  }

  change(by: number): void {
    if (by < 0) this.tell.back();
    else if (this.rows[this.focus]?.item.sub) this.enter();
  }

  enter(): void {
    const item = this.rows[this.focus]?.item;
    if (item && !item.refuse) this.tell.chosen(item);
  }

  back(): void {
    this.tell.back();
  }

  private row(item: Item): HTMLElement {
    const row = make(
      "button.item",
      make("span.tick", item.tick ? "✓" : ""),
      dot(item.colour),
      make("span.title", item.title, item.note ? make("small", item.note) : null, item.refuse ? make("small", item.refuse) : null),
      item.sub ? make("span.more", "›") : item.key ? make("kbd", item.key) : null,
    );
    row.tabIndex = -1;
    row.setAttribute("role", "menuitem");
    if (item.refuse) row.setAttribute("aria-disabled", "true");
    else row.addEventListener("click", () => this.tell.chosen(item));
    this.rows.push({ item, row });
    return row;
  }
}

/** A text field. Space is stop here, too: where a touch screen's keyboard sends one, a dash takes its place. */
class NameView implements Open {
  private readonly input = make("input.name");

  constructor(
    box: HTMLElement,
    title: string,
    value: string,
    note: (name: string) => string,
    private readonly done: (name: string) => void,
    most = NAME_MOST,
  ) {
    const words = make("p.words");
    const tell = () => {
      if (most === NAME_MOST) this.input.value = this.input.value.replace(/[^\w.-]/g, "-").replace(/^[.-]+/, "");
      text(words, note(this.input.value) || "Letters, digits, dots and dashes. Space is stop.");
    };
    Object.assign(this.input, { type: "text", value: value.replaceAll(" ", "-"), maxLength: most, autocomplete: "off", spellcheck: false });
    this.input.setAttribute("aria-label", title);
    this.input.addEventListener("input", tell);
    const button = (name: string, kind: string, act: () => void) => {
      const made = make(`button.${kind}`, name);
      made.addEventListener("click", act);
      return made;
    };
    const choice = make("div.choice", button("Cancel", "plain", () => this.back()), button("Save", "main", () => this.enter()));
    box.replaceChildren(make("header", make("b", title)), this.input, words, choice);
    tell();
    requestAnimationFrame(() => this.input.select());
  }

  move(): void {}

  change(): void {}

  enter(): void {
    this.done(this.input.value);
  }

  back(): void {
    this.done("");
  }
}

function dot(colour: string | undefined): HTMLElement | null {
  if (!colour) return null;
  const made = make("i.dot");
  made.style.background = colour;
  return made;
}
