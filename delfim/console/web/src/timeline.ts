// The last ten minutes of the selected boat: speed, what it measures, and the loss of its link, with a mark at each change of mode and at each message.
import { make } from "./dom";
import { GraphStrip } from "./graphs";
import { severityWord } from "./messages";
import type { State } from "./state";
import { age_s, freshness } from "./state";
import type { ValueTrack } from "./valuetrack";
import type { Boat, Graphs } from "./wire";

const SPAN_S = 600;
const EVERY_S = 1;
const MARKS_MOST = 200;
const KEPT = "delfim.timeline";

interface Kept {
  graphs: Graphs;
  marks: { at_s: number; severity: number; text: string }[];
  mode: string | null;
  last_s: number;
}

export class Timeline {
  private readonly kept = new Map<number, Kept>();
  private readonly marks = make("div.marks");
  private readonly strip = new GraphStrip(() => {});
  private drawn_s = 0;
  visible = localStorage.getItem(KEPT) === "on";

  constructor(
    private readonly box: HTMLElement,
    private readonly state: State,
    private readonly values: ValueTrack,
  ) {
    box.append(this.strip.root, this.marks);
    state.on(["boats"], () => this.take());
    state.on(["selection"], () => this.draw());
    state.on(["forgotten"], () => {
      for (const id of this.kept.keys()) if (!state.byId(id)) this.kept.delete(id);
    });
  }

  toggle(): void {
    this.visible = !this.visible;
    localStorage.setItem(KEPT, this.visible ? "on" : "off");
    this.draw();
  }

  /** A message of a boat. */
  say(boat: number | null, severity: number, words: string): void {
    if (boat === null || !this.state.at_s) return;
    const { marks } = this.of(boat);
    marks.push({ at_s: this.state.at_s, severity, text: words });
    if (marks.length > MARKS_MOST) marks.shift();
  }

  private of(boat: number): Kept {
    let its = this.kept.get(boat);
    if (!its) this.kept.set(boat, (its = { graphs: {}, marks: [], mode: null, last_s: -Infinity }));
    return its;
  }

  private take(): void {
    for (const boat of this.state.boats) this.add(boat, this.of(boat.id));
    if (this.visible && Math.abs(this.state.at_s - this.drawn_s) >= EVERY_S) this.draw();
  }

  private add(boat: Boat, its: Kept): void {
    const { at_s } = this.state;
    if (boat.mode !== its.mode && its.mode !== null && boat.mode !== null) this.say(boat.id, 6, boat.mode);
    its.mode = boat.mode ?? its.mode;
    if (at_s < its.last_s + EVERY_S || freshness(age_s(this.state, boat)) === "lost") return;
    its.last_s = at_s;
    const young = Object.entries(boat.measured ?? {}).map(([name, { value, age_s }]) => [name, age_s < 2 * EVERY_S ? value : null] as const);
    const values = { speed_mps: boat.speed_mps, "link lost_pct": boat.link.loss_pct, ...Object.fromEntries(young) };
    for (const [name, value] of Object.entries(values) as [string, number | null][]) if (value !== null) (its.graphs[name] ??= []).push([at_s, value]);
    for (const points of Object.values(its.graphs)) while (points.length && points[0]![0] < at_s - SPAN_S) points.shift();
    while (its.marks.length && its.marks[0]!.at_s < at_s - SPAN_S) its.marks.shift();
  }

  private draw(): void {
    const { at_s, selected } = this.state;
    this.drawn_s = at_s;
    const its = selected === null ? undefined : this.kept.get(selected);
    this.box.hidden = !this.visible || !its || this.state.replaying;
    document.documentElement.classList.toggle("timed", !this.box.hidden);
    if (this.box.hidden || !its) return;
    const range = { from_s: at_s - SPAN_S, to_s: at_s };
    this.strip.draw(Object.fromEntries(Object.entries(its.graphs).filter(([, points]) => points.length)), range, this.values.name);
    this.strip.tell(at_s, range);
    this.marks.replaceChildren(
      ...its.marks.map((each) => {
        const mark = make("i");
        mark.style.left = `${(100 * (each.at_s - range.from_s)) / SPAN_S}%`;
        mark.dataset["severity"] = severityWord(each.severity);
        mark.title = `${new Date(1000 * each.at_s).toISOString().slice(11, 19)} ${each.text}`;
        return mark;
      }),
    );
  }
}
