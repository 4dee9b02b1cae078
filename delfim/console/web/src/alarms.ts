// Alarms: each stands on the screen while its cause lasts and until somebody has taken note of it, on any page of the console.
import { attribute, make, text } from "./dom";
import type { Net } from "./net";
import type { Sound } from "./sound";
import type { State } from "./state";
import type { Alarm } from "./wire";

const shownMost = (): number => (innerWidth <= 700 ? 3 : 5); // a phone's map has room for fewer
const GRAVE = 3;
const AGAIN_MS = 4000; // a grave one sounds again, until it is acknowledged

export class Alarms {
  private list: Alarm[] = [];
  private readonly lines = make("div");
  private readonly rest = make("span");
  private readonly note = make("button.plain", "Acknowledge");

  constructor(
    private readonly box: HTMLElement,
    private readonly state: State,
    private readonly net: Net,
    private readonly sound: Sound,
  ) {
    this.note.append(make("kbd", "K"));
    this.note.tabIndex = -1;
    this.note.addEventListener("click", () => this.acknowledge());
    box.append(this.lines, make("footer", this.rest, this.note));
    box.hidden = true;
    setInterval(() => this.unseen.some(({ severity }) => severity <= GRAVE) && sound.alarm(), AGAIN_MS);
    state.on(["boats"], () => this.draw()); // names, and how long ago
  }

  take(alarms: Alarm[]): void {
    const known = new Set(this.list.map(({ id }) => id));
    const fresh = alarms.filter(({ id, seen }) => !seen && !known.has(id));
    this.list = alarms;
    if (fresh.some(({ severity }) => severity <= GRAVE)) this.sound.alarm();
    else if (fresh.length) this.sound.warn();
    this.draw();
  }

  /** All that are on the screen: what is hidden below them comes up. */
  acknowledge(): void {
    const ids = this.list.slice(0, shownMost()).flatMap(({ id, seen }) => (seen ? [] : [id]));
    if (ids.length) void this.net.ask({ t: "acknowledge", ids });
  }

  private get unseen(): Alarm[] {
    return this.list.filter(({ seen }) => !seen);
  }

  private draw(): void {
    const shown = this.list.slice(0, shownMost());
    while (this.lines.children.length > shown.length) this.lines.lastElementChild!.remove();
    while (this.lines.children.length < shown.length) this.lines.append(make("p", make("i.dot"), make("b"), make("span"), make("small")));
    shown.forEach((alarm, i) => this.drawLine(this.lines.children[i] as HTMLElement, alarm));
    const more = this.list.length - shown.length;
    text(this.rest, more ? `and ${more} more` : "");
    this.note.hidden = !this.unseen.length;
    this.box.hidden = !shown.length;
  }

  private drawLine(line: HTMLElement, { boat, severity, text: words, at_s, lasts, seen }: Alarm): void {
    const its = boat === null ? undefined : this.state.byId(boat);
    const [dot, name, what, when] = [...line.children] as [HTMLElement, HTMLElement, HTMLElement, HTMLElement];
    attribute(line, "data-severity", severity <= GRAVE ? "grave" : "warning");
    attribute(line, "data-state", seen ? "seen" : lasts ? "lasts" : "over");
    dot.style.background = its?.colour ?? "transparent";
    text(name, its?.name ?? (boat === null ? "Console" : `boat ${boat}`));
    text(what, words);
    text(when, `${new Date(1000 * at_s).toLocaleTimeString("en-GB")}${seen ? " · seen" : lasts ? "" : " · once"}`);
  }
}
