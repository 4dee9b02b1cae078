// What the boats and the gateway say in words: on the screen for a while, in the list for the session, and heard when it matters.
import { make } from "./dom";
import type { Sound } from "./sound";
import type { State } from "./state";

const SHOWN_MOST = 4;
const KEPT_MOST = 200;
const SHOWN_MS = 7000;
const GRAVE_MS = 25_000;
const SAME_MS = 3000;

export interface Message {
  boat: number | null;
  severity: number; // MAVLink's: 0 emergency .. 7 debug
  text: string;
  at: Date;
}

export class Messages {
  readonly kept: Message[] = [];

  constructor(
    private readonly parent: HTMLElement,
    private readonly state: State,
    private readonly sound: Sound,
  ) {}

  say(boat: number | null, severity: number, words: string): void {
    const last = this.kept[0];
    if (last && last.boat === boat && last.text === words && Date.now() - last.at.getTime() < SAME_MS) return;
    this.kept.unshift({ boat, severity, text: words, at: new Date() });
    this.kept.length = Math.min(this.kept.length, KEPT_MOST);
    if (severity <= 3) this.sound.alarm();
    else if (severity === 4) this.sound.warn();
    if (severity < 7) this.show(boat, severity, words);
  }

  private show(id: number | null, severity: number, words: string): void {
    const boat = id === null ? undefined : this.state.byId(id);
    const dot = make("i.dot");
    dot.style.background = boat?.colour ?? "transparent";
    const line = make("p.message", boat ? dot : null, boat ? make("b", boat.name) : null, make("span", words));
    line.dataset["severity"] = severity <= 3 ? "grave" : severity === 4 ? "warning" : "notice";
    line.addEventListener("click", () => line.remove());
    this.parent.append(line);
    while (this.parent.children.length > SHOWN_MOST) this.parent.firstElementChild!.remove();
    setTimeout(() => line.remove(), severity <= 3 ? GRAVE_MS : SHOWN_MS);
  }
}
