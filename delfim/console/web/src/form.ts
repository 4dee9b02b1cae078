// A form of numbers: typed, or changed by buttons and arrows.
import { make, text } from "./dom";

const AGAIN_MS = 400;
const AGAIN_EVERY_MS = 60;
const SPAN_TYPED = 1; // a field of two words is not typed
const TOUCH = matchMedia("(pointer: coarse)").matches; // there a field that has the focus opens a keyboard over the map

export interface Field {
  title: string;
  unit: string;
  value: number;
  step: number;
  least: number;
  most: number;
  around?: boolean; // a compass goes around
  zero?: string; // a word to show for 0
  show?: (value: number) => string;
  read?: (words: string) => number | null; // where it is written in more ways than as a number
}

/** What a form says of its numbers, or why they cannot be. */
export type Said = string | { refuse: string };

/** What the keyboard does in a menu or a form that is open. */
export interface Open {
  move(by: number): void;
  change(by: number): void;
  enter(): void;
  back(): void;
}

export class FormView implements Open {
  private readonly values: number[];
  private readonly inputs: HTMLInputElement[] = [];
  private readonly rows: HTMLElement[] = [];
  private readonly words = make("p.words");
  private readonly ok: HTMLButtonElement;
  private readonly faults: string[] = []; // of what is typed in each field
  private focus = 0;
  private refused = "";

  constructor(
    box: HTMLElement,
    title: string,
    private readonly fields: Field[],
    private readonly live: (values: number[]) => Said,
    private readonly done: (ok: boolean) => void,
  ) {
    this.values = fields.map((each) => each.value);
    const button = (words: string, kind: string, act: () => void) => {
      const made = make(`button.${kind}`, words) as HTMLButtonElement;
      made.tabIndex = -1;
      made.addEventListener("click", act);
      return made;
    };
    this.ok = button("OK", "main", () => this.enter());
    box.replaceChildren(
      make("header", make("b", title)),
      ...fields.map((_, i) => this.row(i)),
      make("footer", this.words, make("div.choice", button("Cancel", "plain", () => done(false)), this.ok)),
    );
    fields.forEach((_, i) => this.tell(i));
    this.say();
    this.rows[0]?.classList.add("focus");
    if (!TOUCH) requestAnimationFrame(() => this.inputs[this.focus]?.select());
  }

  cancelled(): void {
    this.done(false);
  }

  move(by: number): void {
    this.inputs[this.focus]!.blur();
    this.enterField((this.focus + by + this.rows.length) % this.rows.length);
    if (!TOUCH) this.inputs[this.focus]!.select();
  }

  change(by: number): void {
    this.step(this.focus, by);
    if (!TOUCH) this.inputs[this.focus]!.select();
  }

  enter(): void {
    if (!this.refused) this.done(true);
  }

  back(): void {
    this.done(false);
  }

  private enterField(index: number): void {
    this.focus = index;
    this.rows.forEach((row, i) => row.classList.toggle("focus", i === index));
  }

  private row(index: number): HTMLElement {
    const { title, least, most, read } = this.fields[index]!;
    const input = make("input");
    Object.assign(input, { type: "text", inputMode: read ? "text" : "decimal", readOnly: most - least <= SPAN_TYPED, tabIndex: -1, autocomplete: "off", spellcheck: false });
    input.setAttribute("aria-label", title);
    input.addEventListener("focus", () => this.enterField(index));
    input.addEventListener("click", () => input.select());
    input.addEventListener("input", () => this.typed(index));
    input.addEventListener("blur", () => this.faults[index] || this.tell(index));
    this.inputs.push(input);
    const row = make("div.field", make("span.title", title), this.stepper(index, -1), input, this.stepper(index, 1));
    this.rows.push(row);
    return row;
  }

  /** A number counts as soon as it is one that may be. */
  private typed(index: number): void {
    const { title, least, most, unit, around, read } = this.fields[index]!;
    const { value: words } = this.inputs[index]!;
    const found = read ? read(words) : (/^\s*([-+]?\d*[.,]?\d+)\D*$/.exec(words)?.[1]?.replace(",", ".") ?? null);
    const value = found === null ? NaN : Number(found);
    const good = value >= least && value <= most;
    if (good) this.values[index] = around ? Math.round(value) : value;
    this.faults[index] = good ? "" : `${title}: ${least} to ${most} ${unit}`;
    this.say();
  }

  /** A button that repeats while it is held, in larger steps after a while. */
  private stepper(index: number, by: number): HTMLElement {
    const button = make("button.stepper", by < 0 ? "−" : "+");
    button.tabIndex = -1;
    button.setAttribute("aria-label", `${this.fields[index]!.title}: ${by < 0 ? "less" : "more"}`);
    let timer = 0;
    const stop = () => clearTimeout(timer);
    button.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      button.setPointerCapture(event.pointerId);
      let count = 0;
      const again = () => {
        this.step(index, by * (++count > 30 ? 10 : 1));
        timer = window.setTimeout(again, count === 1 ? AGAIN_MS : AGAIN_EVERY_MS);
      };
      again();
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(end, stop);
    return button;
  }

  private step(index: number, by: number): void {
    const { step, least, most, around } = this.fields[index]!;
    const wanted = Math.round((this.values[index]! + by * step) / step) * step;
    const span = most - least;
    this.values[index] = around ? ((((wanted - least) % span) + span) % span) + least : Math.max(least, Math.min(most, wanted));
    this.faults[index] = "";
    this.enterField(index);
    this.tell(index);
    this.say();
  }

  private tell(index: number): void {
    const { unit, zero, step, show } = this.fields[index]!;
    const value = this.values[index]!;
    const [short, typed] = [value.toFixed(step < 1 ? 1 : 0), String(Number(value.toFixed(3)))];
    this.inputs[index]!.value = value === 0 && zero ? zero : show ? show(value) : `${Number(short) === Number(typed) ? short : typed} ${unit}`.trim();
  }

  /** What is said of the numbers, anew. */
  say(): void {
    const fault = this.faults.find(Boolean);
    const said = fault ? { refuse: fault } : this.live(this.values);
    this.refused = typeof said === "string" ? "" : said.refuse;
    text(this.words, typeof said === "string" ? said : said.refuse);
    this.words.classList.toggle("bad", Boolean(this.refused));
    this.ok.disabled = Boolean(this.refused);
  }
}
