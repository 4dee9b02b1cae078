// Messages of the boats and the gateway: on the screen for a while, with a sound when it matters. The gateway keeps them (watchlog.ts).
// They let every click and tap through: one that comes or moves under a finger must not take a tap on the sea.
import { make, text } from "./dom";
import type { Sound } from "./sound";
import type { State } from "./state";

const SHOWN_MOST = 4;
const KEPT_MOST = 20;
const SHOWN_MS = 7000;
const GRAVE_MS = 25_000;
const SAME_MS = 3000;

export interface Message {
  boat: number | null;
  severity: number; // MAVLink's: 0 emergency .. 7 debug
  text: string;
  at: Date;
  words?: HTMLElement; // shows it while it is on the screen
}

export const severityWord = (severity: number): string => (severity <= 3 ? "grave" : severity === 4 ? "warning" : "notice");

export class Messages {
  private readonly kept: Message[] = []; // to know what comes again

  constructor(
    private readonly parent: HTMLElement,
    private readonly state: State,
    private readonly sound: Sound,
  ) {}

  /** A message repeated within SAME_MS is shown once, also when it comes again as the reason of a refusal. */
  say(boat: number | null, severity: number, words: string): void {
    const recent = this.kept.find((each) => each.boat === boat && meant(each.text) === meant(words) && Date.now() - each.at.getTime() < SAME_MS);
    if (recent) return fuller(recent, words);
    const line = make("span", words);
    this.kept.unshift({ boat, severity, text: words, at: new Date(), words: line });
    this.kept.length = Math.min(this.kept.length, KEPT_MOST);
    delete this.kept[SHOWN_MOST]?.words;
    if (severity <= 3) this.sound.alarm();
    else if (severity === 4) this.sound.warn();
    if (severity < 7) this.show(boat, severity, line);
  }

  private show(id: number | null, severity: number, words: HTMLElement): void {
    const boat = id === null ? undefined : this.state.byId(id);
    const dot = make("i.dot");
    dot.style.background = boat?.colour ?? "transparent";
    const name = boat?.name ?? (id === null ? null : `boat ${id}`); // its name is not known yet
    const line = make("p.message", boat ? dot : null, name && make("b", name), words);
    line.dataset["severity"] = severityWord(severity);
    this.parent.append(line);
    while (this.parent.children.length > SHOWN_MOST) this.parent.firstElementChild!.remove();
    setTimeout(() => line.remove(), severity <= 3 ? GRAVE_MS : SHOWN_MS);
  }
}

/** A refusal comes twice, from the boat and as the answer to the request: they have the same reason. */
function meant(words: string): string {
  return words.replace(/^.*refused: /, "");
}

/** Show the longer text: it also names the refused command. */
function fuller(message: Message, words: string): void {
  if (words.length <= message.text.length) return;
  message.text = words;
  if (message.words) text(message.words, words);
}
