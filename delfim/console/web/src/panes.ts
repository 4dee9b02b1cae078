// What a boat tells of itself: the keys of its file that may change under way, as a form, and the checks before the start, as a list.
import { make, text } from "./dom";
import type { Net } from "./net";
import type { AboardRow, Boat } from "./wire";

type Kind = "settings" | "checks";
const TITLES: Record<Kind, string> = { settings: "Settings", checks: "Before the start" };
const CHANGED = "Changes last for this voyage.";

export class Panes {
  private boat: Boat | null = null;
  private kind: Kind = "settings";
  private rows: AboardRow[] = [];
  private readonly title = make("h2");
  private readonly said = make("p");
  private readonly keep = make("a.main", "Keep in a file");
  private readonly table = make("table");
  private readonly box = make("div.card.log.panes");

  constructor(
    parent: HTMLElement,
    private readonly net: Net,
  ) {
    const close = make("button.plain", "Close");
    close.addEventListener("click", () => this.close());
    const again = make("button.plain", "Read again");
    again.addEventListener("click", () => this.read());
    this.keep.download = "kept.toml";
    this.box.append(make("header", this.title, this.keep, again, close), this.said, this.table);
    this.box.id = "panes";
    this.box.setAttribute("role", "dialog");
    this.box.hidden = true;
    this.said.setAttribute("role", "status");
    parent.append(this.box);
  }

  open(boat: Boat, kind: Kind): void {
    [this.boat, this.kind, this.rows] = [boat, kind, []];
    this.box.hidden = false;
    const title = `${boat.name}: ${TITLES[kind].toLowerCase()}`;
    text(this.title, title);
    this.box.setAttribute("aria-label", title);
    this.read();
  }

  close(): boolean {
    const was = !this.box.hidden;
    this.box.hidden = true;
    return was;
  }

  /** Enter gives the value of a field. While the form is open, no arrow steers a boat, and a number that misses its field is no speed. */
  takes(key: string): boolean {
    if (this.box.hidden || this.kind !== "settings" || !/^(Enter|Arrow.*|\d)$/.test(key)) return false;
    if (key === "Enter" && document.activeElement instanceof HTMLInputElement) document.activeElement.blur();
    return true;
  }

  take({ boat, of, rows }: { boat: number; of: Kind | "change"; rows: AboardRow[] }): void {
    if (boat !== this.boat?.id || this.box.hidden) return;
    if (of === "change") this.rows = this.rows.map((each) => (each.key === rows[0]!.key ? rows[0]! : each));
    else if (of === this.kind) this.rows = rows;
    this.draw();
  }

  private read(): void {
    const [boat, kind] = [this.boat!.id, this.kind];
    text(this.said, "The boat is asked, a line at a time…");
    this.draw();
    void this.net.ask({ t: "itself", boat, do: kind }).then(({ ok, reason }) => {
      if (boat !== this.boat?.id || kind !== this.kind) return;
      if (!ok) text(this.said, reason);
      else this.draw();
    });
  }

  private draw(): void {
    this.box.dataset["kind"] = this.kind;
    const other = this.rows.filter(differs);
    const failing = this.rows.filter(({ refused }) => refused).length;
    this.keep.hidden = this.kind !== "settings" || !other.length;
    this.keep.href = `kept.toml?boat=${this.boat!.id}&name=${encodeURIComponent(this.boat!.name)}`;
    const heads = this.kind === "settings" ? ["", "in force", "", "may be", "the file says"] : ["", "", ""];
    this.table.replaceChildren(...(this.rows.length ? [make("tr", ...heads.map((each) => make("th", each)))] : []), ...this.rows.map((each) => (this.kind === "settings" ? this.setting(each) : check(each))));
    if (!this.rows.length) return;
    text(this.said, this.kind === "settings" ? `${CHANGED} ${other.length ? `${other.length} of ${this.rows.length} differ from the boat’s file.` : "All are as the boat’s file says."}` : failing ? `${failing} of ${this.rows.length} are not fulfilled.` : "All are fulfilled.");
  }

  private setting(row: AboardRow): HTMLElement {
    const { key, value, file, unit, allowed, meaning, refused } = row;
    const field = make("input");
    Object.assign(field, { type: "text", value: words(value), tabIndex: -1, autocomplete: "off", spellcheck: false, disabled: value === null });
    field.setAttribute("aria-label", key);
    const why = make("small.bad", refused);
    field.addEventListener("change", () => field.value.trim() !== words(value) && void this.change(key, field.value.trim(), value, why));
    const revert = make("button.plain", "Revert");
    revert.tabIndex = -1;
    revert.addEventListener("click", () => void this.change(key, words(file), file, why));
    const line = make("tr", ...[make("span", make("b", key), make("small", meaning)), make("span", field, why, differs(row) && revert), unit, allowed, words(file)].map((each) => make("td", each)));
    line.dataset["key"] = key;
    line.classList.toggle("differs", differs(row));
    return line;
  }

  /** The boat refuses what may not be, with the reason. */
  private async change(key: string, said: string, like: AboardRow["value"], why: HTMLElement): Promise<void> {
    const number = Number(said.replace(",", "."));
    const value = typeof like === "boolean" ? (said === "true" || said === "yes" ? true : said === "false" || said === "no" ? false : said) : typeof like === "number" && said && Number.isFinite(number) ? number : said;
    text(why, "…");
    const { ok, reason } = await this.net.ask({ t: "itself", boat: this.boat!.id, do: "change", key, value });
    const shown = [...this.table.querySelectorAll("tr")].find((each) => each.dataset["key"] === key)?.querySelector("small.bad");
    text(shown ?? why, ok ? "" : reason);
  }
}

const differs = ({ value, file }: AboardRow): boolean => value !== file;
const words = (value: AboardRow["value"]): string => (value === null ? "reckoned" : typeof value === "boolean" ? (value ? "yes" : "no") : typeof value === "number" ? String(Number(value.toPrecision(6))) : value);

/** A check by its sign, its name and its reason: what fails first. */
function check({ key, words: why, refused }: AboardRow): HTMLElement {
  const line = make("tr", ...[refused ? "✗" : "✓", key, refused || why].map((each) => make("td", each)));
  line.dataset["what"] = refused ? "alarm" : "";
  return line;
}
