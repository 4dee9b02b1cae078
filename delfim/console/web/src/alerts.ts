// Alerts: the gravest that nobody has seen stands at the top of the page, with how many there are; the list has all, and what was.
import { attribute, disable, make, text } from "./dom";
import type { Net } from "./net";
import type { Sound } from "./sound";
import type { State } from "./state";
import type { Alert, Ended } from "./wire";

const AGAIN_MS = 4000; // what sounds does so again, until it is acknowledged or silenced
const HISTORY_MOST = 200;
const UNSEEN = new Set(["unacknowledged", "silenced", "rectified"]);
const PRIORITIES = ["emergency", "alarm", "warning", "caution"] as const;
const STATES: Record<Alert["state"], (by: string) => string> = {
  unacknowledged: () => "not acknowledged",
  silenced: (by) => `silenced by ${by}`,
  rectified: () => "over, not acknowledged",
  acknowledged: (by) => (by ? `acknowledged by ${by}` : ""),
  transferred: (by) => `${by} answers for it`,
};

export class Alerts {
  private list: Alert[] = []; // the gravest that nobody has seen stands first, as the gateway sends them
  private history: Ended[] = []; // the newest stands first
  private readonly sign = make("i.sign");
  private readonly name = make("b");
  private readonly what = make("span");
  private readonly when = make("small");
  private readonly line = make("p", this.sign, make("span.told", this.name, this.what), this.when);
  private readonly counts = make("button.counts", ...PRIORITIES.map((each) => sign(each, "0")));
  private readonly buttons: HTMLButtonElement[];
  private readonly table = make("table");
  private readonly was = make("h2", "What was");
  private readonly past = make("table");
  private readonly box = make("div.card.log.alerts");

  constructor(
    private readonly bar: HTMLElement,
    private readonly state: State,
    private readonly net: Net,
    private readonly sound: Sound,
  ) {
    this.line.setAttribute("role", "alert");
    const short = make("span", "Ack", make("span.rest", "nowledge")); // on a phone, where the words of the alert need the room
    this.buttons = [button(short, "K", () => this.acknowledge()), button("Silence", "S", () => this.silence())];
    this.counts.append(make("kbd", "A"));
    this.counts.tabIndex = -1;
    this.counts.addEventListener("click", () => this.toggle());
    bar.prepend(this.line, ...this.buttons, this.counts);
    this.makeBox();
    setInterval(() => this.list.some(({ sounds }) => sounds) && sound.alarm(), AGAIN_MS);
    state.on(["boats"], () => this.draw()); // their names
    this.draw();
  }

  take(alerts: Alert[]): void {
    const known = new Set(this.list.map(({ id }) => id));
    const fresh = alerts.filter(({ id, state }) => UNSEEN.has(state) && !known.has(id));
    this.list = alerts;
    if (fresh.some(({ sounds }) => sounds)) this.sound.alarm();
    else if (fresh.length) this.sound.warn();
    this.draw();
  }

  takeEnded(ended: Ended[], all = false): void {
    this.history = [...ended.toReversed(), ...(all ? [] : this.history)].slice(0, HISTORY_MOST);
    this.draw();
  }

  /** One at a time, the one in the bar: nobody takes note of what is out of sight. */
  acknowledge(): void {
    const first = this.unseen[0];
    if (first) void this.net.ask({ t: "acknowledge", ids: [first.id] });
  }

  /** The sound alone, of all. */
  silence(): void {
    const ids = this.list.flatMap(({ id, sounds, priority }) => (sounds && priority !== "emergency" ? [id] : []));
    if (ids.length) void this.net.ask({ t: "quiet", ids: ids.slice(0, 100) });
  }

  toggle(): void {
    this.box.hidden = !this.box.hidden;
    this.draw();
  }

  close(): boolean {
    const was = !this.box.hidden;
    this.box.hidden = true;
    return was;
  }

  get states(): [text: string, state: string][] {
    return this.list.map((each) => [each.text, each.state]);
  }

  private get unseen(): Alert[] {
    return this.list.filter(({ state }) => UNSEEN.has(state));
  }

  private makeBox(): void {
    const close = make("button.plain", "Close");
    close.addEventListener("click", () => this.close());
    this.box.append(make("header", make("h2", "Alerts"), close), this.table, this.was, this.past);
    this.box.id = "alerts";
    this.box.setAttribute("role", "dialog");
    this.box.setAttribute("aria-label", "Alerts");
    this.box.hidden = true;
    document.body.append(this.box);
  }

  private called(boat: number | null): string {
    return boat === null ? "Console" : (this.state.byId(boat)?.name ?? `boat ${boat}`);
  }

  private draw(): void {
    const [first] = this.unseen;
    attribute(this.bar, "data-priority", first?.priority ?? "");
    attribute(this.bar, "data-state", first?.state ?? "");
    attribute(this.sign, "data-priority", first?.priority ?? "");
    text(this.name, first ? this.called(first.boat) : "");
    text(this.what, first ? first.text : this.list.length ? "All alerts are acknowledged" : "No alerts");
    text(this.when, first ? `${clock(first.at_s)}${first.state === "rectified" ? " · over" : first.state === "silenced" ? " · silent" : ""}` : "");
    const [acknowledge, silence] = this.buttons as [HTMLButtonElement, HTMLButtonElement];
    disable(acknowledge, !first);
    disable(silence, !this.list.some(({ sounds, priority }) => sounds && priority !== "emergency"));
    PRIORITIES.forEach((priority, i) => {
      const its = this.list.filter((each) => each.priority === priority);
      const count = this.counts.children[i] as HTMLElement;
      text(count.lastElementChild!, String(its.length));
      attribute(count, "data-some", String(its.length > 0));
      attribute(count, "aria-label", `${its.length} of priority ${priority}`);
    });
    if (!this.box.hidden) this.drawList();
  }

  private drawList(): void {
    const row = (alert: Alert, ...more: (string | HTMLElement)[]) => {
      const line = make("tr", ...[sign(alert.priority, alert.priority), this.called(alert.boat), clock(alert.at_s), alert.text, ...more].map((each) => make("td", each)));
      line.dataset["priority"] = alert.priority;
      line.dataset["state"] = alert.state;
      return line;
    };
    const heads = (...words: string[]) => make("tr", ...words.map((each) => make("th", each)));
    const note = ({ id, state, boat }: Alert) => {
      if (UNSEEN.has(state)) return [button("Acknowledge", "", () => void this.net.ask({ t: "acknowledge", ids: [id] }))];
      // Of a boat that went home before the console was started again nobody else will tell that it is over.
      return boat === null || this.state.byId(boat) ? [] : [button("Forget the boat", "", () => void this.net.ask({ t: "forget", boat }))];
    };
    for (const each of [this.was, this.past]) each.hidden = !this.history.length;
    this.table.replaceChildren(heads(this.list.length ? "" : "none", "boat", "since", "", "", ""), ...this.list.map((each) => row(each, STATES[each.state](each.by), ...note(each))));
    this.past.replaceChildren(heads("", "boat", "from", "", "until", "acknowledged by"), ...this.history.map((each) => row(each, clock(each.until_s), each.by)));
  }
}

const clock = (at_s: number): string => new Date(1000 * at_s).toLocaleTimeString("en-GB");

/** The priority by its shape, too: who cannot tell the colours reads the shapes. */
function sign(priority: string, words: string): HTMLElement {
  const shape = make("i.sign");
  shape.dataset["priority"] = priority;
  return make("span.of", shape, make("span", words));
}

function button(title: string | HTMLElement, key: string, act: () => void): HTMLButtonElement {
  const made = make("button.plain", make("span", title), key && make("kbd", key));
  made.tabIndex = -1;
  made.addEventListener("click", act);
  return made;
}
