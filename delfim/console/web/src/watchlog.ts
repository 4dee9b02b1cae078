// The log of the watch, as the gateway keeps it: what was said, ordered, refused and acknowledged, and by whom.
import { make } from "./dom";
import type { WatchLine } from "./wire";

const KEPT_MOST = 500;

export class WatchLog {
  private lines: WatchLine[] = []; // the newest stands first
  private readonly table = make("table");
  private readonly box = make("div.card.log");

  constructor(parent: HTMLElement) {
    const save = make("a.main", "Save as a table");
    save.href = "watch.csv";
    save.download = "watch.csv";
    const close = make("button.plain", "Close");
    close.addEventListener("click", () => this.close());
    this.box.append(make("header", make("h2", "Log of the watch"), save, close), this.table);
    this.box.id = "log";
    this.box.setAttribute("role", "dialog");
    this.box.setAttribute("aria-label", "Log of the watch");
    this.box.hidden = true;
    parent.append(this.box);
  }

  /** `all`: of those before, as a page is told when it opens. */
  take(lines: WatchLine[], all = false): void {
    this.lines = [...lines.toReversed(), ...(all ? [] : this.lines)].slice(0, KEPT_MOST);
    if (!this.box.hidden) this.draw();
  }

  open(): void {
    this.box.hidden = false;
    this.draw();
  }

  close(): boolean {
    const was = !this.box.hidden;
    this.box.hidden = true;
    return was;
  }

  private draw(): void {
    const heads = make("tr", ...["time", "boat", "who", "what", ""].map((each) => make("th", each)));
    this.table.replaceChildren(heads, ...this.lines.map(row));
  }
}

function row({ at_s, boat, name, who, what, text }: WatchLine): HTMLElement {
  const time = new Date(1000 * at_s).toLocaleTimeString("en-GB");
  const line = make("tr", ...[time, name || (boat === null ? "" : `boat ${boat}`), who, what, text].map((each) => make("td", each)));
  line.dataset["what"] = what;
  return line;
}
